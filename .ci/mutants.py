"""Change the code in small ways, one at a time, and count how many of the changes the tests notice.

python .ci/mutants.py [--count 200] [--seed 0] [--workers 2] [--room soil ...] [--budget 90] [--map FILE]

First every file of tests runs once, alone, while `entered.py` notes which functions it enters. Each mutant is one
operator, comparison, constant or condition changed in a copy of the package. On it run the files that enter the changed
function, those first that are quick and mostly about its module, for as much processor time as the budget allows, until
a test fails. Survivors are printed with their place: each is an equivalent change, to be explained, or a missing test.
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
# Folders of tests that are about other rooms, or about speed.
ASIDE = {"bad_input", "benchmarks", "cli", "problem_file"}
# Seconds after which a session is taken to hang, however little processor time it has had on a busy machine.
PATIENCE = 1800
# Sessions are forked from a process that has read what takes long to read, but nothing of the package.
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
        module: its path in the package.
        line: of the change.
        function: first line of the innermost function around it; 0 if the module itself runs it.
        what: the expression before and after.
        text: the whole module with the change.
    """

    module: str
    line: int
    function: int
    what: str
    text: str


@dataclass(frozen=True)
class Tested:
    """A file of tests: its processor time alone [s], and the functions that it enters, by module."""

    file: str
    seconds: float
    entered: dict[str, list[int]]

    def dearness(self, module: str) -> float:
        """Return the seconds over the part of what is entered that is the module's: how late to try the file."""
        return self.seconds * sum(map(len, self.entered.values())) / len(self.entered[module])


# --- mutants ----------------------------------------------------------------------------------------------------------


def places(tree: ast.Module) -> list[ast.AST]:
    """Return the nodes that can be changed, outside annotations and keywords that only guard against slips."""
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
    """Copy what tests read, with the machine code of Python that is beside it."""
    for name in ("plough_opt", "tests", "problems", "docs", "notebooks", ".ci"):
        shutil.copytree(source / name, to / name)
    for name in ("pyproject.toml", "README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "plough_opt_command.py"):
        shutil.copy(source / name, to / name)
    return to


def run(copy: Path, files: list[str], seconds: float, told: str = "") -> bool:
    """Return True if files of tests pass in a copy, in as much processor time as is given."""
    process = SERVER.Process(target=_session, args=(copy, files, seconds, told))
    process.start()
    process.join(PATIENCE)
    if process.is_alive():
        os.killpg(process.pid, signal.SIGKILL)
        process.join()
    return process.exitcode == 0


def _session(copy: Path, files: list[str], seconds: float, told: str) -> None:
    """Run pytest in a process that has the libraries already, and end it with pytest's status."""
    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1,) * 2)
    os.chdir(copy)
    sys.path[:0] = [str(copy), str(copy / ".ci")]
    # Machine code of a mutant must not be found in the cache later.
    os.environ |= {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache"), "ENTERED": told}
    with Path(os.environ.get("OUTP", os.devnull)).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    os._exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *files], plugins=[entered] if told else []))


def tested(copy: Path, file: str) -> Tested | None:
    """Return what a file of tests enters, or None if a test fails in the copy of the package as it is."""
    told = copy / (file.replace("/", "-") + ".json")
    if not run(copy, [file], PATIENCE, str(told)):
        return None
    return Tested(file, **json.loads(told.read_text(encoding="utf-8")))


def survey(copy: Path, pool: ThreadPoolExecutor) -> list[Tested]:
    """Run every file of tests once; a file that fails without any mutant can notice none, and is left out."""
    paths = sorted(path for path in (copy / "tests").rglob("test_*.py") if not ASIDE & set(path.parts))
    files = [path.relative_to(copy).as_posix() for path in paths]
    found = list(pool.map(lambda file: tested(copy, file), files))
    if broken := [file for file, one in zip(files, found, strict=True) if one is None]:
        print(f"left out, for they fail on the package as it is: {', '.join(broken)}", flush=True)
    return [one for one in found if one is not None]


def chosen(mutant: Mutant, files: list[Tested], budget: float) -> list[Tested]:
    """Return the files of tests that enter a mutant's function, most telling first, as many as the budget allows."""
    inside = [one for one in files if mutant.function in one.entered.get(mutant.module, [])]
    # What modules and classes hold is there for all functions; some functions run only in processes of their own.
    inside = inside or [one for one in files if mutant.module in one.entered]
    found, spent = [], 0.0
    for one in sorted(inside, key=lambda one: one.dearness(mutant.module)):
        if not found or spent + one.seconds <= budget:
            found.append(one)
            spent += one.seconds
    return found


def survives(source: Path, mutant: Mutant, files: list[Tested]) -> bool:
    """Return True if all files of tests pass on a mutant; one that takes three times as long as usual hangs."""
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
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default: 0)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="mutants at a time (default: all cores)")
    parser.add_argument("--room", action="append", choices=ROOMS, help="repeatable (default: every room here)")
    parser.add_argument("--budget", type=float, default=90.0, help="seconds of tests for a mutant (default: 90)")
    parser.add_argument("--map", type=Path, help="file that keeps what the tests enter, for another sample")
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
            word = f"SURVIVED {len(tests)} files" if alive else "noticed"
            print(f"{number:4d} {word} {mutant.module}:{mutant.line}  {mutant.what}", flush=True)
    print(f"{len(sample) - survivors} of {len(sample)} mutants noticed (seed {options.seed})")


if __name__ == "__main__":
    main()
