"""Change the code in small ways, one at a time, and count how many of the changes the tests notice.

python .ci/mutants.py [--count 200] [--seed 0] [--workers 2] [--room soil ...]

Each mutant is one operator, comparison, constant or condition changed in a copy of the package. The tests of its room
run on it until one fails. Survivors are printed with their place: each is an equivalent change, to be explained, or a
missing test.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Seconds after which the tests of a mutant are taken to hang, which counts as noticed.
PATIENCE = 900
# Rooms whose mutants are tried, with the tests that belong to them.
TESTS = {
    "soil": ["tests/test_geometry.py", "tests/test_soil.py", "tests/test_plastic.py", "tests/test_plastic_field.py",
             "tests/test_density_profile.py", "tests/test_forces.py", "tests/elastic", "tests/test_strength_record.py"],
    "laws": ["tests/test_forces.py", "tests/test_cone_index.py", "tests/test_printed.py", "tests/crosscheck",
             "tests/test_density_profile.py"],
    "motion": ["tests/motion", "tests/hard_cases", "tests/test_batch.py", "tests/test_batch_series.py",
               "tests/test_scene.py"],
    "design": ["tests/design", "tests/hard_cases"],
    "studies": ["tests/tradeoff", "tests/uncertainty", "tests/calibration", "tests/study", "tests/crosscheck",
                "tests/test_accuracy_study.py", "tests/test_accuracy_reference.py"],
}  # fmt: skip
SWAPS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.LtE, ast.LtE: ast.Lt,
    ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.And: ast.Or, ast.Or: ast.And,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A module with one change.

    Attributes:
        path: of the module, from the package's parent folder.
        line: of the change.
        what: the expression before and after.
        text: the whole module with the change.
    """

    path: Path
    line: int
    what: str
    text: str

    @property
    def room(self) -> str:
        """The room it stands in."""
        return self.path.parts[1]


def places(tree: ast.Module) -> list[ast.AST]:
    """Return the nodes that can be changed, outside annotations and docstrings."""
    hidden = {id(inner) for node in ast.walk(tree) if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation
              for inner in ast.walk(node.annotation)}  # fmt: skip
    return [node for node in ast.walk(tree) if id(node) not in hidden and _changeable(node)]


def _changeable(node: ast.AST) -> bool:
    match node:
        case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.Compare(ops=[op]):
            return type(op) in SWAPS
        case ast.Constant(value=value):
            return isinstance(value, int | float)
        case ast.UnaryOp(op=ast.Not()) | ast.If():
            return True
    return False


def changed(node: ast.AST) -> None:
    """Change a node in place."""
    match node:
        case ast.BinOp(op=op) | ast.BoolOp(op=op):
            node.op = SWAPS[type(op)]()
        case ast.Compare(ops=[op]):
            node.ops = [SWAPS[type(op)]()]
        case ast.Constant(value=bool() as value):
            node.value = not value
        case ast.Constant(value=value):
            node.value = value + 1 if value in (0, 1) else value * 1.5 if isinstance(value, float) else value + 1
        case ast.UnaryOp():
            node.op = ast.UAdd() if isinstance(node.op, ast.USub) else node.op
            node.operand = ast.UnaryOp(ast.Not(), node.operand)
        case ast.If():
            node.test = ast.UnaryOp(ast.Not(), node.test)


def mutants(rooms: list[str], count: int, seed: int) -> list[Mutant]:
    """Return a seeded sample of mutants, each room in the measure of its places."""
    every = []
    for room in rooms:
        for path in sorted((ROOT / "plough_opt" / room).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            every += [(path, source, k) for k in range(len(places(ast.parse(source))))]
    return [_mutant(*one) for one in random.Random(seed).sample(every, min(count, len(every)))]


def _mutant(path: Path, source: str, k: int) -> Mutant:
    tree = ast.parse(source)
    node = places(tree)[k]
    shown = node.test if isinstance(node, ast.If) else node
    before = ast.unparse(shown)
    changed(node)
    after = ast.unparse(node.test if isinstance(node, ast.If) else node)
    text = ast.unparse(ast.fix_missing_locations(tree))
    return Mutant(path.relative_to(ROOT), node.lineno, f"{before}  ->  {after}", text)


def noticed(mutant: Mutant) -> bool:
    """Return True if a test of the room fails on a mutant."""
    return fails(mutant.room, mutant)


def fails(room: str, mutant: Mutant | None = None) -> bool:
    """Return True if a test of a room fails, on a mutant or on the package as it is."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("plough_opt", "tests", "problems", "docs"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "README.md", "plough_opt_command.py"):
            shutil.copy(ROOT / name, copy / name)
        if mutant is not None:
            (copy / mutant.path).write_text(mutant.text, encoding="utf-8")
        # Machine code of a mutant must not be found in the cache later.
        environment = os.environ | {"PYTHONPATH": folder, "XDG_CACHE_HOME": str(copy / "cache")}
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *TESTS[room]]
        try:
            done = subprocess.run(
                command, cwd=copy, env=environment, capture_output=True, timeout=PATIENCE, check=False
            )
        except subprocess.TimeoutExpired:
            return True
        return done.returncode != 0


def main() -> None:
    """Try the mutants and print the survivors and the score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="number of mutants (default: 200)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default: 0)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="mutants at a time (default: all cores)")
    parser.add_argument("--room", action="append", choices=TESTS, help="repeatable (default: every room here)")
    options = parser.parse_args()
    sample = mutants(options.room or [*TESTS], options.count, options.seed)
    survivors = 0
    with ThreadPoolExecutor(options.workers) as pool:
        rooms = sorted({mutant.room for mutant in sample})
        if broken := [room for room, wrong in zip(rooms, pool.map(fails, rooms), strict=True) if wrong]:
            sys.exit(f"tests fail on the package as it is, in {', '.join(broken)}: mend that first")
        for number, (mutant, dead) in enumerate(zip(sample, pool.map(noticed, sample), strict=True), start=1):
            survivors += not dead
            word = "noticed " if dead else "SURVIVED"
            print(f"{number:4d} {word} {mutant.path}:{mutant.line}  {mutant.what}", flush=True)
    print(f"{len(sample) - survivors} of {len(sample)} mutants noticed (seed {options.seed})")


if __name__ == "__main__":
    main()
