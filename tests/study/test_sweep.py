"""Sweeps of functions: points, results, failures, tables and stores, and which sweeps may share a store."""

import contextlib
import csv
import functools
import importlib
import math
import os
import sqlite3
import subprocess
import sys
import threading
import tomllib
import types
import zipfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import swept
from helpers.problem_files import SUBSOILER
from scipy.stats import qmc

import plough_opt as po
from plough_opt.problem_file.sweep import ProblemSweep
from plough_opt.studies.sweep import engine
from plough_opt.studies.sweep.question import PointGrid, PointSample, digest_of

# --- sweeps of functions: points of grids and samples, results, failures, tables and stores; invalid sweeps ---

OVER = {"a": po.Range(0.0, 3.0, 40), "b": [1.0, 2.0, 5.0]}


def expected_waves():
    places = np.linspace(0.0, 3.0, 40).tolist()
    return [tuple(swept.waves({"a": a, "b": b}).values()) for a in places for b in OVER["b"]]


def test_results_are_those_of_the_function(inline):
    result = po.sweep(swept.waves, OVER, executor=inline)
    assert result.names == ("a", "b")
    assert result.results == ("sine", "root")
    assert result.complete
    assert (len(result), result.failed, result.already) == (120, 0, 0)
    assert result.table[["sine", "root"]].tolist() == expected_waves()
    assert result.table["point"].tolist() == list(range(120))
    np.testing.assert_array_equal(result.column("root"), result.table["root"])
    best = result.extreme("sine", largest=True)
    rows = [row[0] for row in expected_waves()]
    assert (best.value, best.point) == (max(rows), rows.index(max(rows)))
    assert best.values == {"a": result.table["a"][best.point], "b": 5.0}
    for ask, words in ((result.column, "'cube' is not a column"), (result.extreme, "'cube' is not a result")):
        with pytest.raises(po.InputError, match=f"{words}: there are .*sine, root"):
            ask("cube")


def test_results_do_not_depend_on_executor_workers_and_size_of_tasks(inline, monkeypatch):
    first = po.sweep(swept.waves, OVER, executor=inline).table
    with ThreadPoolExecutor(3) as threads:
        np.testing.assert_array_equal(po.sweep(swept.waves, OVER, executor=threads, workers=3).table, first)
    np.testing.assert_array_equal(po.sweep(swept.waves, OVER, workers=2).table, first)
    monkeypatch.setattr(engine, "_TASK_SECONDS", 0.0)
    np.testing.assert_array_equal(po.sweep(swept.waves, OVER, executor=inline).table, first)


def test_numbers_are_stored_to_the_last_bit(inline):
    numbers = [5e-324, 1.7976931348623157e308, 0.1 + 0.2, -1.0 / 3.0, 2.0**53 + 2.0]
    with po.sweep(lambda values: {"x": values["a"]}, {"a": numbers}, executor=inline) as found:
        assert found.table[["a", "x"]].tolist() == [(number, number) for number in numbers]


def test_failures_are_rows_with_a_reason(inline, tmp_path):
    result = po.sweep(swept.failing, {"a": [0.0, 1.0, 7.0, 3.0]}, executor=inline)
    reasons = [
        "ZeroDivisionError: float division by zero",
        "ValueError: one is not allowed",
        "half = inf is not finite",
    ]
    found = [(failure.point, failure.values, failure.reason) for failure in result.failures]
    assert found == [(k, {"a": a}, reason) for k, a, reason in zip((0, 1, 3), (0.0, 1.0, 3.0), reasons, strict=True)]
    assert (result.complete, result.failed) == (True, 3)
    np.testing.assert_array_equal(result.column("inverse"), [np.nan, np.nan, 1.0 / 7.0, np.nan])
    # SQLite has no negative zero.
    assert math.copysign(1.0, result.column("half")[2]) == 1.0
    rows = list(csv.reader(result.to_csv(tmp_path / "deep" / "t.csv").read_text(encoding="utf-8").splitlines()))
    assert rows[:2] == [["point", "a", "inverse", "half", "reason"], ["0", "0.0", "", "", reasons[0]]]
    assert float(rows[3][2]) == 1.0 / 7.0
    with np.load(result.to_npz(tmp_path / "t.npz")) as arrays:
        assert set(arrays) == {"point", "a", "inverse", "half", "failed", "reasons", "undetermined"}
        np.testing.assert_array_equal(arrays["inverse"], result.column("inverse"))
        assert (arrays["failed"].tolist(), arrays["undetermined"].tolist()) == ([0, 1, 3], [])
        assert arrays["reasons"].tolist() == reasons


def test_no_name_leads_out_of_a_folder_of_arrays(inline, tmp_path):
    over = {"../../up": [1.0, 2.0], "..\\up": [1.0, 3.0], "/root": [1.0, 4.0], "C:up": [1.0, 5.0]}
    names = {".._.._up": 2.0, ".._up": 3.0, "_root": 4.0, "C_up": 5.0, "a_b": 12.0, "a_b_": 14.0, "failed_": 16.0}
    results = {"a_b": 12.0, "a/b": 14.0, "failed_": 16.0}
    with po.sweep(lambda _: results, over, executor=inline) as found:
        path = found.to_npz(tmp_path / "t.npz")
    with np.load(path) as arrays:
        assert {name: arrays[name][-1] for name in names} == names
    with zipfile.ZipFile(path) as archive:
        assert not [name for name in archive.namelist() if {"/", "\\", ":"} & {*name}]


WITHOUT_RESULTS = [
    (None, (), "the function returned None: return a dictionary of named numbers"),
    ({"draft": "much"}, (), "draft = 'much' is not a number: could not convert string to float: 'much'"),
    ({"draft": math.inf}, ("draft",), "draft = inf is not finite"),
]


@pytest.mark.parametrize(("given", "names", "reason"), WITHOUT_RESULTS)
def test_a_sweep_in_which_everything_fails_has_no_results(inline, tmp_path, given, names, reason):
    result = po.sweep(lambda _: given, {"a": [1.0, 2.0]}, executor=inline)
    assert (result.results, [result.extreme(name) for name in names]) == (names, [None] * len(names))
    assert str(result).splitlines() == ["2 points, 2 failed", *(f"failed at a = {a}: {reason}" for a in (1, 2))]
    assert [failure.reason for failure in result.failures] == [reason] * 2
    assert result.to_csv(tmp_path / "t.csv").read_text().splitlines()[1] == f"0,1.0,{',' * len(names)}{reason}"
    assert result.table.dtype.names == ("point", "a", *names)


def test_the_store_of_another_sweep_is_refused_with_the_difference(inline, tmp_path):
    store, same = tmp_path / "sweep.db", {"a": [1.0, 2.0], "b": [1.0, 2.0]}
    po.sweep(swept.waves, same, executor=inline, store=store).close()
    for function, over, more, expected in (
        (swept.waves, same | {"a": [1.0, 3.0]}, {}, r"over a: 1\.0, 2\.0 there, 1\.0, 3\.0 here"),
        (swept.failing, same, {}, "function: waves there, failing here"),
        (functools.update_wrapper(lambda _: {}, swept.waves), same, {}, r"\(code of the function: "),
        (swept.waves, {"a": po.Range(1.0, 2.0), "b": po.Range(1.0, 2.0)}, {"samples": 4}, "samples: absent there, 4"),
    ):
        with pytest.raises(po.InputError, match=f"belongs to another sweep .*{expected}"):
            po.sweep(function, over, executor=inline, store=store, **more)


def test_a_file_that_is_not_a_store_is_refused_and_left_as_it_is(inline, tmp_path):
    text, other, empty = (tmp_path / name for name in ("text.db", "other.db", "empty.db"))
    text.write_text("this is not a database, however long it may be" * 40)
    with contextlib.closing(sqlite3.connect(other)) as connection:
        connection.execute("CREATE TABLE meta (key, value)")
    empty.touch()
    before = [path.read_bytes() for path in (text, other, empty)]
    for load, path, words in (
        (False, text, "file is not a database"),
        (True, other, "is a database, but not the store of a sweep: name another file"),
        (False, other, "is a database, but not the store of a sweep: name another file"),
        (True, empty, "is empty, not the store of a sweep"),
        (True, tmp_path / "none.db", "there is no store"),
        (False, "/proc/sweep.db", "cannot be"),
        (False, other / "sweep.db", "cannot be written"),
    ):
        with pytest.raises(po.InputError, match=words):
            po.Sweep.load(path) if load else po.sweep(swept.waves, OVER, executor=inline, store=path)
    assert [path.read_bytes() for path in (text, other, empty)] == before


def test_another_run_may_have_created_the_file_and_a_closed_store_is_refused(inline, tmp_path):
    store = tmp_path / "sweep.db"
    with contextlib.closing(sqlite3.connect(store)) as another_run:
        another_run.execute("PRAGMA journal_mode = WAL")  # its tables follow
        assert store.stat().st_size > 0
        result = po.sweep(swept.waves, OVER, executor=inline, store=store)
    with pytest.raises(po.InputError, match=r"is the store of a sweep: .*po\.Sweep\.load"):
        po.load(store)
    result.close()
    for read in (len, lambda closed: closed.table, lambda closed: closed.to_csv(tmp_path / "a.csv")):
        with pytest.raises(po.InputError, match=r"sweep\.db' cannot be used: Cannot operate on a closed database"):
            read(result)
    assert not (tmp_path / "a.csv").exists()


def test_what_cannot_be_called_sent_to_workers_or_put_into_one_table_is_refused(inline):
    ended = ThreadPoolExecutor(1)
    ended.shutdown()
    for what, more, words in (
        (3, {}, "3 cannot be swept: use a problem, or a function"),
        (lambda _: ended, {}, "cannot be sent"),  # its locks go into no pickle
        (swept.waves, {"method": "batch"}, "what and method are for problem files"),
        (swept.waves, {"executor": ended}, "the executor failed at a task: RuntimeError: .* after shutdown"),
        (swept.two_names, {"executor": inline}, r"results of one point are .*: return the same names"),
    ):
        with pytest.raises(po.InputError, match=words):
            po.sweep(what, OVER, **more)


def test_a_broken_executor_is_reported_and_stored_points_remain(tmp_path):
    store = tmp_path / "sweep.db"
    expected = r"the executor is broken: .*continues from there with a new one"
    with ProcessPoolExecutor(1) as pool, pytest.raises(po.InputError, match=expected):
        po.sweep(swept.Deadly(tmp_path / "died"), {"a": np.arange(8.0)}, executor=pool, workers=1, store=store)
    assert not po.Sweep.load(store).complete
    (tmp_path / "cured").touch()  # another run may continue at once
    with po.sweep(swept.Deadly(tmp_path / "died"), {"a": np.arange(8.0)}, workers=1, store=store) as found:
        assert found.complete


UNGUARDED = """
from plough_opt.studies.sweep.engine import sweep
def own(values):
    return {"x": values["a"]}
sweep(own, {"a": [1.0, 2.0]}, workers=1)
"""


def test_a_script_without_a_guard_is_refused(script):
    process = script(UNGUARDED)
    error = process.communicate(timeout=60)[1]
    assert process.returncode == 1
    # Only by the main process, not by its workers.
    assert error.count("Traceback") == 1
    assert "a script must call sweep under if __name__ == '__main__':" in error.splitlines()[-1]


IN_A_THREAD = """
import threading
from helpers import swept
from plough_opt.studies.sweep.engine import sweep
def run():
    print(len(sweep(swept.waves, {"a": [float(k) for k in range(200)]}, workers=1).table), flush=True)
if __name__ == "__main__":
    threading.Thread(target=run).start()
"""


@pytest.mark.thorough
def test_a_sweep_in_a_thread_goes_on_after_the_main_thread_has_ended(script):
    process = script(IN_A_THREAD)
    assert process.communicate(timeout=60) == ("200\n", "")


def test_a_grid_of_a_trillion_points_needs_no_memory():
    grid = PointGrid({"a": po.Range(0.0, 1.0, 10**6), "b": po.Range(0.0, 1.0, 10**6)})
    np.testing.assert_array_equal(grid.block(10**12 - 1, 10**12), [[1.0, 1.0]])


# As sweeps request them: forwards, with gaps, and back for what another run abandoned.
BLOCKS = ([(0, 64)], [(0, 1), (1, 4), (4, 64)], [(0, 3), (10, 20), (3, 10), (20, 64)])


@pytest.mark.parametrize("blocks", BLOCKS, ids=("whole", "pieces", "holes"))
def test_a_sample_is_that_of_scipy(blocks):
    ranges = {"a": po.Range(2.0, 3.0), "b": po.Range(-7.0, 9.0), "c": po.Range(1e-3, 1e3, log=True)}
    sample = PointSample(ranges, 64, seed=5)
    found = np.empty((64, 3))
    for first, last in blocks:
        found[first:last] = sample.block(first, last)
    unit = qmc.Sobol(3, scramble=True, seed=5).random(64)
    np.testing.assert_array_equal(found[:, :2], qmc.scale(unit[:, :2], [2.0, -7.0], [3.0, 9.0]))
    # exp(log) of numbers up to e^7 loses a few bits, compared with the power that the sample computes.
    np.testing.assert_allclose(found[:, 2], np.exp(qmc.scale(unit[:, 2:], np.log(1e-3), np.log(1e3))[:, 0]), rtol=1e-14)


REFUSED = [
    ({}, {}, "over is empty"),
    ({"a": po.Range(0.0, 1.0)}, {}, "'a': .* has no number of values"),
    (dict.fromkeys("abcd", po.Range(0.0, 1.0, 10**5)), {}, r"the grid has 1e\+20 points"),
    ({"a": po.Range(0.0, 1.0, 3)}, {"samples": 8}, "a sample fills the range"),
    ({"a": (0.0, 1.0)}, {"samples": 8}, "a range with two ends"),
    ({"a": po.Range(0.0, 1.0)}, {"samples": 1}, "samples = 1 must be a whole number from 2"),
    ({"a": po.Range(0.0, 1.0)}, {"samples": 8, "seed": -1}, "seed = -1"),
    ({"a": [1.0]}, {}, "two values or more"),
    ({"a": [1.0, 2.0, 1.0]}, {}, "same value twice"),
    ({"a": [1.0, float("nan")]}, {}, "must be finite"),
    ({"a": ["1", "2"]}, {}, "not all numbers"),
    ({"a": "5..45:9"}, {}, "give a po.Range or a list"),
    ({"a": [1.0, 2.0], "A": [1.0, 2.0]}, {}, "'a' cannot name"),
    ({"reason": [1.0, 2.0]}, {}, "'reason' cannot name"),
    ({"": [1.0, 2.0]}, {}, "'' cannot name"),
]


@pytest.mark.parametrize(("over", "options", "expected"), REFUSED)
def test_invalid_sweeps_of_functions_are_refused(inline, over, options, expected):
    with pytest.raises(po.InputError, match=expected):
        po.sweep(len, over, **{"executor": inline} | options)


# --- a store recognises a function by all that its results depend on, and a problem by its files too ---

STORES = tomllib.loads(Path(__file__).with_name("stores.toml").read_text(encoding="utf-8"))
SCRIPT = STORES["script"]


@pytest.fixture
def functions_of(monkeypatch):
    def read(text):
        module = types.ModuleType("own_script")
        monkeypatch.setitem(sys.modules, "own_script", module)
        exec(compile(text, "own_script.py", "exec"), vars(module))
        return module.FUNCTIONS

    return read


@pytest.mark.parametrize(("text", "other", "changed"), STORES["changes"])
def test_what_changes_results_changes_the_digest(functions_of, text, other, changed):
    assert text in SCRIPT
    before, after = (
        {name: digest_of(one) for name, one in functions_of(script).items()}
        for script in (SCRIPT, SCRIPT.replace(text, other))
    )
    assert {name for name in before if before[name] != after[name]} == {*changed}


def test_the_digest_is_the_same_in_another_process(functions_of, tmp_path):
    text = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\nfrom own_script import FUNCTIONS\n"
    text += "from plough_opt.studies.sweep.question import digest_of\nprint(*map(digest_of, FUNCTIONS.values()))"
    (tmp_path / "own_script.py").write_text(SCRIPT)
    command = [sys.executable, "-c", text]
    done = subprocess.run(command, env=os.environ | {"PYTHONHASHSEED": "5"}, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [digest_of(one) for one in functions_of(SCRIPT).values()]


AT_HEAD = "import top_own\ndef f(values):\n    return {'x': top_own.of(1.0)}\n"
INSIDE = "def f(values):\n    import top_own\n    return {'x': top_own.of(1.0)}\n"


MODULES = [
    ("deep_own", "import deep_own\ndef of(a):\n    return a + deep_own.VALUE\n"),
    ("deep_own", "from deep_own import VALUE\ndef of(a):\n    return a + VALUE\n"),
    ("deep_own", "def of(a):\n    from deep_own import VALUE\n    return a + VALUE\n"),
    ("this", "from this import VALUE\ndef of(a):\n    return a + VALUE\n"),
]


@pytest.mark.parametrize("user", [AT_HEAD, INSIDE])
@pytest.mark.parametrize(("deep", "top"), MODULES)
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


def test_an_edited_record_and_an_own_law_are_another_question(monkeypatch):
    problem = po.read_problem(SUBSOILER, ["scene.duration=0.2 s"])

    def question(**changes):
        return ProblemSweep.of(replace(problem, **changes), {"soil.cohesion": [1e4, 2e4]}, "optimise").question

    def changed(**changes):
        return {key for key, text in question(**changes).items() if text != before.get(key)}

    before = question(data={"record.csv": "0.00, 1564"})
    assert changed(data={"record.csv": "0.00, 1564"}) == set()
    assert changed(data={"record.csv": "0.00, 1565"}) == {"content of record.csv"}
    monkeypatch.setitem(po.laws.LAWS, "own", type("Own", (), {"reaction": lambda _self, _at: 1.0}))
    assert changed() == {"laws, effects, measures and methods"}
