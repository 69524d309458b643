"""Mutation testing: make small changes to the code, one at a time, and count how many the tests detect.

python .ci/mutants.py [--count 200] [--seed 0] [--workers 2] [--room soil ...] [--budget 90] [--map FILE]

First every test file runs once, alone, while `entered.py` records which functions it enters. Each mutant is a copy of
the package with one operator, comparison, constant or condition changed. The test files that enter the changed function
run on it until a test fails or the budget of processor time is used up; quick files mostly about the module run
first. Survivors are printed with their location: each is an equivalent change, to be explained, or a missing test.
"""

import argparse
import ast
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import entered
import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("soil", "laws", "motion", "design", "studies")
# Folders with tests of other rooms, or of speed.
ASIDE = {"bad_input", "benchmarks", "cli", "problem_file"}
# A session that runs longer than this [s] counts as hung, even if a busy machine gave it little processor time.
PATIENCE = 1800
# Sessions are forked from a process that has imported the slow libraries, but nothing of the package.
SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(
    [
        "casadi",
        "matplotlib.figure",
        "mpmath",
        "pint",
        "pydantic",
        "rich",
        "scipy.integrate",
        "scipy.optimize",
        "scipy.stats",
    ]
)
SWAPS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.LtE, ast.LtE: ast.Lt,
    ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.And: ast.Or, ast.Or: ast.And,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A module with one change.

    Attributes:
        module: path of the module in the package.
        line: line of the change.
        function: first line of the innermost function that contains it; 0 outside functions.
        what: the expression before and after.
        text: source of the changed module.
    """

    module: str
    line: int
    function: int
    what: str
    text: str


@dataclass(frozen=True)
class Tested:
    """A test file: its processor time when run alone [s], and the functions it enters, by module."""

    file: str
    seconds: float
    entered: dict[str, list[int]]

    def cost(self, module: str) -> float:
        """Return the seconds divided by the share of the entered functions that are the module's; low costs first."""
        return self.seconds * sum(map(len, self.entered.values())) / len(self.entered[module])


# --- mutants ----------------------------------------------------------------------------------------------------------


def places(tree: ast.Module) -> list[ast.AST]:
    """Return the nodes to change, without annotations and the keywords `strict` and `frozen`, which only guard."""
    hidden = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation:
            hidden |= {id(inner) for inner in ast.walk(node.annotation)}
        elif isinstance(node, ast.keyword) and node.arg in ("strict", "frozen"):
            hidden.add(id(node.value))
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
            node.value = value * 1.5 if isinstance(value, float) and value not in (0.0, 1.0) else value + 1
        case ast.UnaryOp(operand=operand):
            node.operand = ast.UnaryOp(ast.Not(), operand)
        case ast.If(test=test):
            node.test = ast.UnaryOp(ast.Not(), test)


def mutants(rooms: list[str], count: int, seed: int) -> list[Mutant]:
    """Return a seeded random sample of mutants from all nodes of the rooms."""
    every = []
    for room in rooms:
        for path in sorted((ROOT / "plough_opt" / room).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            every += [(path, source, k) for k in range(len(places(ast.parse(source))))]
    return [_mutant(*one) for one in random.Random(seed).sample(every, min(count, len(every)))]


def _mutant(path: Path, source: str, k: int) -> Mutant:
    tree = ast.parse(source)
    node = places(tree)[k]
    around = [f for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) and f.lineno <= node.lineno <= f.end_lineno]
    shown = node.test if isinstance(node, ast.If) else node
    before = ast.unparse(shown)
    changed(node)
    after = ast.unparse(node.test if isinstance(node, ast.If) else node)
    text = ast.unparse(ast.fix_missing_locations(tree))
    module = path.relative_to(ROOT / "plough_opt").as_posix()
    return Mutant(module, node.lineno, max(map(entered.first_line, around), default=0), f"{before}  ->  {after}", text)


# --- tests ------------------------------------------------------------------------------------------------------------


def copied(source: Path, to: Path) -> Path:
    """Copy everything the tests read, with compiled bytecode."""
    for name in ("plough_opt", "tests", "problems", "docs", "notebooks", ".ci"):
        shutil.copytree(source / name, to / name)
    for name in ("pyproject.toml", "README.md", "CONTRIBUTING.md", "ARCHITECTURE.md"):
        shutil.copy(source / name, to / name)
    return to


def run(copy: Path, files: list[str], seconds: float, record: str = "") -> bool:
    """Return True if test files pass in a copy within the given processor time [s]."""
    process = SERVER.Process(target=_session, args=(copy, files, seconds, record))
    process.start()
    process.join(PATIENCE)
    if process.is_alive():
        os.killpg(process.pid, signal.SIGKILL)
        process.join()
    return process.exitcode == 0


def _session(copy: Path, files: list[str], seconds: float, record: str) -> None:
    """Run pytest in this forked process and exit with its status."""
    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1,) * 2)
    os.chdir(copy)
    sys.path[:0] = [str(copy), str(copy / ".ci")]
    # Compiled code of a mutant must not enter the user's cache.
    os.environ |= {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache"), "ENTERED": record}
    with Path(os.environ.get("OUTP", os.devnull)).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    os._exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *files], plugins=[entered] if record else []))


def tested(copy: Path, file: str) -> Tested | None:
    """Return the functions a test file enters, or None if a test fails on the unchanged package."""
    record = copy / (file.replace("/", "-") + ".json")
    if not run(copy, [file], PATIENCE, str(record)):
        return None
    return Tested(file, **json.loads(record.read_text(encoding="utf-8")))


def survey(copy: Path, pool: ThreadPoolExecutor) -> list[Tested]:
    """Run every test file once; a file that fails on the unchanged package detects nothing and is left out."""
    paths = sorted(path for path in (copy / "tests").rglob("test_*.py") if not ASIDE & set(path.parts))
    files = [path.relative_to(copy).as_posix() for path in paths]
    found = list(pool.map(lambda file: tested(copy, file), files))
    if broken := [file for file, one in zip(files, found, strict=True) if one is None]:
        print(f"left out because they fail on the unchanged package: {', '.join(broken)}", flush=True)
    return [one for one in found if one is not None]


def chosen(mutant: Mutant, files: list[Tested], budget: float) -> list[Tested]:
    """Return the test files that enter a mutant's function, cheapest first, as many as the budget allows."""
    inside = [one for one in files if mutant.function in one.entered.get(mutant.module, [])]
    # Code of modules and classes serves all functions; some functions run only in child processes.
    inside = inside or [one for one in files if mutant.module in one.entered]
    found, spent = [], 0.0
    for one in sorted(inside, key=lambda one: one.cost(mutant.module)):
        if not found or spent + one.seconds <= budget:
            found.append(one)
            spent += one.seconds
    return found


def survives(source: Path, mutant: Mutant, files: list[Tested]) -> bool:
    """Return True if all test files pass on a mutant; three times the usual processor time counts as failure."""
    with tempfile.TemporaryDirectory() as folder:
        copy = copied(source, Path(folder))
        module = copy / "plough_opt" / mutant.module
        module.write_text(mutant.text, encoding="utf-8")
        seconds = 60.0 + 3.0 * sum(one.seconds for one in files)
        return not files or run(copy, [one.file for one in files], seconds)


def main() -> None:
    """Try the mutants and print the survivors and the score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="number of mutants (default: 200)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample (default: 0)")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count(), help="mutants tested at a time (default: all cores)"
    )
    parser.add_argument(
        "--room", action="append", choices=ROOMS, help="room to change, repeatable (default: all of these)"
    )
    parser.add_argument(
        "--budget", type=float, default=90.0, help="processor time of tests for a mutant [s] (default: 90)"
    )
    parser.add_argument("--map", type=Path, help="file that keeps the first step's record for further samples")
    options = parser.parse_args()
    sample = mutants(options.room or [*ROOMS], options.count, options.seed)
    survivors = 0
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.workers) as pool:
        copy = copied(ROOT, Path(folder))
        if options.map and options.map.exists():
            files = [Tested(**one) for one in json.loads(options.map.read_text(encoding="utf-8"))]
        else:
            files = survey(copy, pool)
        if options.map:
            options.map.write_text(json.dumps([vars(one) for one in files]), encoding="utf-8")
        trials = [chosen(mutant, files, options.budget) for mutant in sample]
        results = pool.map(lambda mutant, tests: survives(copy, mutant, tests), sample, trials)
        for number, (mutant, tests, alive) in enumerate(zip(sample, trials, results, strict=True), start=1):
            survivors += alive
            word = f"SURVIVED {len(tests)} files" if alive else "detected"
            print(f"{number:4d} {word} {mutant.module}:{mutant.line}  {mutant.what}", flush=True)
    print(f"{len(sample) - survivors} of {len(sample)} mutants detected (seed {options.seed})")


if __name__ == "__main__":
    main()
