"""Compilation of C on whatever the system offers: no compiler, a damaged or read-only cache, and several processes."""

import ctypes
import os
import re
import subprocess
import sys

import casadi as ca
import pytest

import plough_opt as po
from plough_opt.core import compiler as compilers
from plough_opt.core.compiler import compiler_problem, find_compiler, library

by_root = pytest.mark.skipif(
    os.name != "posix" or os.geteuid() != 0, reason="only root can give a file to another user"
)

SOURCE = "double twice(double x) { return 2.0 * x; }"
SCRIPT = f"from plough_opt.core.compiler import library; print(library({SOURCE!r}, ((('-O1',), ()),)))"


def compiled(source=SOURCE, *before):
    """Compile a source and return the path of its library, once the library has proved to work."""
    path = library(source, (*before, (("-O1",), ())))
    if path is not None:
        twice = ctypes.CDLL(str(path)).twice
        twice.argtypes, twice.restype = [ctypes.c_double], ctypes.c_double
        assert twice(1.5) == 3.0
    return path


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "plough_opt" / "code"


@pytest.mark.usefixtures("no_compiler")
def test_a_batch_without_a_compiler_warns(r1_scene):
    assert find_compiler() is None
    k0 = ca.SX.sym("k0")
    plain = po.Batch(r1_scene(stiffness=k0), 0.1, [k0], error=1e-3)
    assert not plain.compiled
    (warning,) = plain.warnings
    assert "no C compiler was found" in warning
    assert plain([[5e4]]).warnings == plain.warnings


def test_a_source_is_compiled_once_and_kept_in_a_private_folder(cache):
    path = compiled()
    before = path.stat()
    assert compiled() == path
    assert list(cache.iterdir()) == [path]
    assert (path.stat(), cache.stat().st_mode & 0o777) == (before, 0o700)


def test_several_processes_at_once(cache):
    command = [sys.executable, "-c", SCRIPT]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    printed = {process.communicate(timeout=120)[0].strip() for process in running}
    assert [process.returncode for process in running] == [0, 0, 0]
    assert printed == {str(path) for path in cache.iterdir()}
    assert len(printed) == 1


WITHOUT_CACHE = [
    ("", "temporary"),
    *((f"import os; os.environ['XDG_CACHE_HOME'] = {place!r}", "temporary") for place in ("relative", "/proc")),
]


@pytest.mark.parametrize(("before", "found"), WITHOUT_CACHE)
def test_without_a_cache_a_temporary_folder_serves_until_the_process_ends(tmp_path, before, found):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "temporary").mkdir()
    environment = os.environ | {"XDG_CACHE_HOME": "", "HOME": "file", "TMPDIR": str(tmp_path / "temporary")}
    line = [sys.executable, "-c", f"{before}\n{SCRIPT}"]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert found in done.stdout
    assert "code is not kept for other runs" in done.stderr
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "temporary"]


@pytest.mark.filterwarnings("ignore:compiled code is not kept")
@pytest.mark.parametrize(
    "harm",
    [lambda folder: folder.chmod(0o710), pytest.param(lambda folder: os.chown(folder, 65534, 65534), marks=by_root)],
)
def test_a_cache_that_is_not_private_is_not_used(cache, harm):
    path = compiled()
    harm(cache)
    assert not compiled().is_relative_to(cache)
    assert [*cache.iterdir()] == [path]


FAILING = [
    ("exit 3", "exit status 3"),
    ("exit 0", "wrote no library"),
    ("sleep 60", r"did not end within 1.5 s"),
    ('while [ "$1" != -o ]; do shift; done; echo text > $2', "(invalid ELF header|file too short|not a)"),
]


@pytest.mark.parametrize(("text", "words"), FAILING)
def test_a_failing_compiler_is_named_and_leaves_nothing_behind(cache, monkeypatch, tmp_path, text, words):
    monkeypatch.setattr(compilers, "_TIMEOUT", 1.5 if "sleep" in text else 60.0)
    script = tmp_path / "my-cc"
    script.write_text(f'#!/bin/sh\nfor one; do [ "$one" = --version ] && exit; done\n{text}\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", f"{script} -DARGUMENT")
    for _ in range(2):
        assert library(SOURCE, ((("-O1",), ()),)) is None
        assert re.search(words, compiler_problem())
    assert list(cache.iterdir()) == []
