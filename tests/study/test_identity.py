"""A store recognises a function by all that its results depend on, and a problem by its files too."""

import dataclasses
import functools
import importlib
import os
import subprocess
import sys
import threading
import types

import casadi as ca
import numpy as np
import pytest
from helpers.problem_files import SUBSOILER

import plough_opt as po
from plough_opt.problem_file.sweep import ProblemSweep
from plough_opt.studies.sweep.identity import digest_of

SCRIPT = """
import functools, math
import numpy as np
import casadi as ca
from dataclasses import dataclass

FACTOR = 2.0
def helper(a):
    return FACTOR * a

@functools.lru_cache
def kept(a):
    return a + 1.0

class Base:
    offset = 3.0

@dataclass
class Law(Base):
    gain: float = 5.0
    def of(self, a):
        return self.gain * a + self.offset
    def __call__(self, values):
        return {"x": self.of(values["a"])}

def outer(k):
    def inner(values, *, more=7.0):
        return {"x": k * values["a"] + more}
    return inner

def plain(values):
    # a comment
    return {"x": helper(values["a"]) + kept(1.0) + sum(b for b in (11.0, 13.0))}

TABLE = np.array([17.0, 19.0])
X = ca.SX.sym("x")
GRAPH = ca.Function("graph", [X], [ca.sin(23.0 * X)])
def looked_up(values):
    return {"x": TABLE[0] + float(GRAPH(values["a"]))}

def base(k, values):
    return {"x": k}

class Scaled:
    def __init__(self, k):
        functools.update_wrapper(self, base)
        self.k = k
    def __call__(self, values):
        return {"x": self.k}

def counted(values):
    return {"x": counted.k}
counted.k = 59.0

@functools.wraps(np.mean)
def wrapping(values):
    return {"x": 61.0}

class Partial:
    __call__ = functools.partialmethod(base, 67.0)

PAIRS = np.zeros(2, dtype=[("first", "f8"), ("second", "f8")])
MASKED = np.ma.array([1.0, 2.0], mask=[False, True])

FUNCTIONS = {
    "wrapped": functools.update_wrapper(functools.partial(base, 71.0), base),
    "scaled": Scaled(73.0),
    "counted": counted,
    "wrapping": wrapping,
    "partialmethod": Partial(),
    "pairs": functools.partial(base, PAIRS),
    "masked": functools.partial(base, MASKED),
    "plain": plain,
    "closure": outer(29.0),
    "partial": functools.partial(lambda values, k: {"x": k + 31.0}, k=37.0),
    "nested": functools.partial(functools.partial(outer(41.0)), more=43.0),
    "object": Law(),
    "method": Law().of,
    "table": looked_up,
    "lambda": lambda values: {"x": Law(47.0).of(1.0)},
}
"""
# Text of the script, its replacement, and the functions whose results change with it.
CHANGES = [
    ("FACTOR = 2.0", "FACTOR = 3.0", {"plain"}),
    ("return FACTOR * a", "return FACTOR + a", {"plain"}),
    ("a + 1.0", "a - 1.0", {"plain"}),
    ("11.0, 13.0", "13.0, 11.0", {"plain"}),
    ("offset = 3.0", "offset = 4.0", {"object", "method", "lambda"}),
    ("gain: float = 5.0", "gain: float = 6.0", {"object", "method", "lambda"}),
    ("self.gain * a", "self.gain / a", {"object", "method", "lambda"}),
    ("more=7.0", "more=8.0", {"closure", "nested"}),
    ("k * values", "k + values", {"closure", "nested"}),
    ("outer(29.0)", "outer(30.0)", {"closure"}),
    ("k + 31.0", "k + 32.0", {"partial"}),
    ("k=37.0", "k=38.0", {"partial"}),
    ("outer(41.0)", "outer(42.0)", {"nested"}),
    ("more=43.0", "more=44.0", {"nested"}),
    ("17.0, 19.0", "17.0, 20.0", {"table"}),
    ("23.0 * X", "24.0 * X", {"table"}),
    ("Law(47.0)", "Law(48.0)", {"lambda"}),
    ("base, 71.0", "base, 72.0", {"wrapped"}),
    ("Scaled(73.0)", "Scaled(74.0)", {"scaled"}),
    ("counted.k = 59.0", "counted.k = 60.0", {"counted"}),
    ('"x": 61.0', '"x": 62.0', {"wrapping"}),
    ("base, 67.0", "base, 68.0", {"partialmethod"}),
    ('("first", "f8"), ("second", "f8")', '("second", "f8"), ("first", "f8")', {"pairs"}),
    ("mask=[False, True]", "mask=[False, False]", {"masked"}),
    ("# a comment", "# two\n    # comments", set()),
    ("import functools, math", "import math\n\n\nimport functools", set()),
]


@pytest.fixture
def functions_of(monkeypatch):
    def read(text):
        module = types.ModuleType("own_script")
        monkeypatch.setitem(sys.modules, "own_script", module)
        exec(compile(text, "own_script.py", "exec"), vars(module))
        return module.FUNCTIONS

    return read


@pytest.mark.parametrize(("text", "other", "changed"), CHANGES)
def test_what_changes_results_changes_the_digest(functions_of, text, other, changed):
    assert text in SCRIPT
    before, after = (
        {name: digest_of(one) for name, one in functions_of(script).items()}
        for script in (SCRIPT, SCRIPT.replace(text, other))
    )
    assert {name for name in before if before[name] != after[name]} == changed


def test_the_digest_is_the_same_in_another_process(functions_of, tmp_path):
    text = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\nfrom own_script import FUNCTIONS\n"
    text += "from plough_opt.studies.sweep.identity import digest_of\nprint(*map(digest_of, FUNCTIONS.values()))"
    (tmp_path / "own_script.py").write_text(SCRIPT)
    command = [sys.executable, "-c", text]
    done = subprocess.run(command, env=os.environ | {"PYTHONHASHSEED": "5"}, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [digest_of(one) for one in functions_of(SCRIPT).values()]


AT_HEAD = "import top_own\ndef f(values):\n    return {'x': top_own.of(1.0)}\n"
INSIDE = "def f(values):\n    import top_own\n    return {'x': top_own.of(1.0)}\n"


@pytest.mark.parametrize("user", [AT_HEAD, INSIDE])
@pytest.mark.parametrize(
    ("deep", "top"),
    [
        ("deep_own", "import deep_own\ndef of(a):\n    return a + deep_own.VALUE\n"),
        ("deep_own", "from deep_own import VALUE\ndef of(a):\n    return a + VALUE\n"),
        ("deep_own", "def of(a):\n    from deep_own import VALUE\n    return a + VALUE\n"),
        ("this", "from this import VALUE\ndef of(a):\n    return a + VALUE\n"),
    ],
)
def test_a_module_of_the_users_own_is_read_as_a_whole(tmp_path, monkeypatch, user, deep, top):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    digests = []
    for value in (1.0, 2.0):
        (tmp_path / f"{deep}.py").write_text(f"VALUE = {value}\n")
        (tmp_path / "top_own.py").write_text(top)
        names = {}
        importlib.invalidate_caches()
        exec(user, names)
        digests.append(digest_of(names["f"]))
        for name in (deep, "top_own"):
            sys.modules.pop(name, None)
    assert digests[0] != digests[1]


def test_modules_that_code_would_import_are_read_and_not_run(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    folder = tmp_path / "package_own"
    folder.mkdir()
    texts = {"__init__": "raise RuntimeError('run')", "inner": "from .deep import VALUE"}
    texts |= {"deep": "import package_own.odd", "odd": "this is not Python"}

    def digest(**changed):
        for name, text in {**texts, **changed}.items():
            (folder / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        names = {}
        exec("def f(values):\n    from package_own import inner, missing\n    return inner.VALUE\n", names)
        return digest_of(names["f"])

    before = digest()
    assert digest() == before
    for name in texts:
        assert digest(**{name: f"{texts[name]} # changed"}) != before, name
    assert not [name for name in sys.modules if name.startswith("package_own")]


def test_an_installed_module_counts_by_its_version(tmp_path, monkeypatch):
    names, digests = {}, []
    exec("def f(values):\n    import fake_own\n    return fake_own.VALUE\n", names)
    for number, (version, text) in enumerate((("1.0", "VALUE = 1"), ("1.0", "VALUE = 2"), ("2.0", "VALUE = 2"))):
        place = tmp_path / str(number) / "site-packages"
        about = place / f"another_name-{version}.dist-info"
        about.mkdir(parents=True)
        (place / "fake_own.py").write_text(text)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: another_name\nVersion: {version}\n")
        (about / "top_level.txt").write_text("fake_own\n")
        monkeypatch.syspath_prepend(place)
        digests.append(digest_of(names["f"]))
    assert digests[0] == digests[1] != digests[2]


def test_cycles_sets_and_values_of_casadi_have_a_digest():
    one, x = [1.0], ca.MX.sym("x")
    one.append(one)
    assert digest_of(one) != digest_of([1.0, [1.0]])
    assert digest_of({"a", "b", 3}) == digest_of({3, "b", "a"}) != digest_of({"a", "b"})
    assert (
        len({digest_of(each) for each in (x + 1, x + 2, ca.DM([1, 2]), ca.DM([1, 3]), np.arange(2), np.arange(3))}) == 6
    )


def test_what_cannot_be_recognised_again_is_refused_with_a_store_only(inline, tmp_path):
    lock, over = threading.Lock(), {"a": [1.0, 2.0]}

    def locked(values):
        with lock:
            return {"x": values["a"]}

    with po.sweep(locked, over, executor=inline) as found:
        assert found.failed == 0
    for one in (locked, functools.partial(locked), functools.partial(print, (k for k in "ab"))):
        with pytest.raises(po.InputError, match=r"store cannot recognise .*(lock|generator).*or sweep without a store"):
            po.sweep(one, over, executor=inline, store=tmp_path / "sweep.db")
    assert not (tmp_path / "sweep.db").exists()


def test_rows_of_another_partial_are_refused(inline, tmp_path):
    first, other = (functools.partial(lambda values, k: {"x": k * values["a"]}, k=k) for k in (2.0, 3.0))
    options = {"executor": inline, "store": tmp_path / "sweep.db"}
    assert [po.sweep(first, {"a": [1.0, 2.0]}, **options).already for _ in range(2)] == [0, 2]
    with pytest.raises(po.InputError, match=r"belongs to another sweep .*code of the function"):
        po.sweep(other, {"a": [1.0, 2.0]}, **options)


def test_an_edited_record_and_an_own_law_are_another_question(monkeypatch):
    problem = po.read_problem(SUBSOILER, ["scene.duration=0.2 s"])

    def question(**changes):
        return ProblemSweep.of(dataclasses.replace(problem, **changes), {"soil.cohesion": [1e4, 2e4]}).question

    def changed(**changes):
        return {key for key, text in question(**changes).items() if text != before[key]}

    before = question(data={"record.csv": "0.00, 1564"})
    assert changed(data={"record.csv": "0.00, 1564"}) == set()
    assert changed(data={"record.csv": "0.00, 1565"}) == {"content of record.csv"}
    monkeypatch.setitem(po.laws.LAWS, "own", type("Own", (), {"reaction": lambda _self, _at: 1.0}))
    assert changed() == {"laws, effects, measures and methods"}
