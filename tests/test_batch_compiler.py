"""Compilation of C on whatever the system offers: no compiler, a damaged or read-only cache, and several processes."""

import ctypes
import errno
import hashlib
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import casadi as ca
import pytest
from helpers import swept

import plough_opt as po
from plough_opt.core import compiler as compilers
from plough_opt.core.compiler import compiler_problem, find_compiler, library

NOBODY = 65534
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
    return tmp_path / "cache" / "plough_opt"


def test_a_batch_without_a_compiler_warns(r1_scene, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "no_such_compiler")
    assert find_compiler() is None
    k0 = ca.SX.sym("k0")
    plain = po.Batch(r1_scene(stiffness=k0), 0.1, [k0], error=1e-3)
    assert not plain.compiled
    (warning,) = plain.warnings
    assert "no C compiler was found" in warning
    assert plain([[5e4]]).warnings == plain.warnings


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("compiler", ["false", "true", "./no_program"])
def test_a_compiler_that_produces_nothing(tmp_path, monkeypatch, compiler):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "no_program").touch(mode=0o755)
    monkeypatch.setenv("CC", compiler)
    assert compiled() is None


@pytest.mark.usefixtures("cache")
def test_of_several_variants_the_first_that_loads_is_used():
    source = SOURCE.replace("2.0", "absent()")
    source = f"#ifdef FAST\ndouble absent(void);\n#else\n#define absent() 2.0\n#endif\n{source}"
    assert compiled(source, (("-DFAST",), ())) is not None


def test_a_source_is_compiled_once(cache):
    path = compiled()
    before = path.stat()
    assert compiled() == path
    assert list(cache.iterdir()) == [path]
    assert path.stat() == before


@pytest.mark.parametrize("damaged", [b"", b"no library", None], ids=["empty", "other", "truncated"])
def test_a_damaged_library_is_compiled_again(cache, damaged):
    path = compiled()
    content = path.read_bytes()
    # A new file, because the old one is loaded.
    path.unlink()
    path.write_bytes(content[: len(content) // 2] if damaged is None else damaged)
    assert compiled() == path
    assert len(path.read_bytes()) == len(content)
    assert list(cache.iterdir()) == [path]


WITHOUT_CACHE = [
    ("", "temporary"),
    ("import os; del os.environ['HOME']; os.getuid = lambda: 2**31 - 3", "temporary"),  # nobody's home
    ("import tempfile; tempfile.tempdir = 'file'", "None"),
    *(
        (f"import os; os.environ['XDG_CACHE_HOME'] = {place!r}", "temporary")
        for place in ("relative", "/proc", "\udcff")
    ),
]


@pytest.mark.parametrize(("before", "found"), WITHOUT_CACHE)
def test_without_a_cache_a_temporary_folder_serves_until_the_process_ends(tmp_path, before, found):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "temporary").mkdir()
    environment = os.environ | {"XDG_CACHE_HOME": "", "HOME": "file", "TMPDIR": str(tmp_path / "temporary")}
    line = [sys.executable, "-c", f"{before}\n{SCRIPT}"]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert found in done.stdout
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "temporary"]


def test_several_processes_at_once(cache):
    command = [sys.executable, "-c", SCRIPT]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    printed = {process.communicate(timeout=120)[0].strip() for process in running}
    assert [process.returncode for process in running] == [0, 0, 0]
    assert printed == {str(path) for path in cache.iterdir()}
    assert len(printed) == 1


# --- libraries that somebody else could have put into the cache ------------------------------------------------------


def given_away(path):
    os.chown(path, NOBODY, NOBODY)


@pytest.mark.parametrize(
    "harm", [pytest.param(given_away, marks=by_root), lambda path: path.chmod(0o720), lambda path: path.chmod(0o1702)]
)
def test_a_library_that_others_own_or_may_write_is_compiled_again(cache, harm):
    path = compiled()
    before = path.stat().st_ino
    harm(path)
    assert compiled() == path
    assert (path.stat().st_ino == before, path.stat().st_uid, path.stat().st_mode & 0o777) == (
        False, os.geteuid(), 0o700,
    )  # fmt: skip
    assert cache.stat().st_mode & 0o777 == 0o700


HARMS = [
    (lambda folder: folder.chmod(0o720), False),
    (lambda folder: folder.chmod(0o702), False),
    (lambda folder: folder.chmod(0o1777), True),
    (lambda folder: folder.parent.chmod(0o777), False),
    (lambda folder: folder.parent.chmod(0o1777), True),
    pytest.param(given_away, False, marks=by_root),
    pytest.param(lambda folder: given_away(folder.parent), False, marks=by_root),
]


@pytest.mark.parametrize(("harm", "safe"), HARMS)
def test_a_cache_that_others_may_write_is_not_used(cache, harm, safe):
    path = compiled()
    harm(cache)
    if safe:
        assert compiled() == path
    else:
        with pytest.warns(UserWarning, match="code is not kept for other runs: .*chmod go-w"):
            assert compiled() != path


def replaced_by(make):
    def replace(path):
        path.unlink()
        make(path)

    return replace


def bound(path):
    with socket.socket(socket.AF_UNIX) as one:
        # The path of a socket must be short.
        descriptor = os.open(path.parent, os.O_RDONLY)
        one.bind(f"/proc/self/fd/{descriptor}/{path.name}")
        os.close(descriptor)


def of_another(path):
    """Put a sound library without the symbol in place, as if it had this name, with the digest of its content."""
    content = compiled(SOURCE + "/* other */").read_bytes()[:-32].replace(b"twice", b"other")
    path.write_bytes(content + hashlib.sha256(content).digest())


REPLACED = [
    (os.mkfifo, False),
    pytest.param(bound, False, marks=pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="no /proc")),
    (lambda path: path.symlink_to("nowhere"), False),
    (lambda path: path.symlink_to("/dev/zero"), False),
    (lambda path: path.symlink_to(compiled(SOURCE + "/* other */")), False),
    (of_another, False),
    (Path.mkdir, True),
]


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize(
    ("make", "stays"), REPLACED, ids=["fifo", "socket", "dangling", "device", "link", "another", "folder"]
)
def test_anything_else_in_the_place_of_a_library_is_replaced_or_left(make, stays):
    path = compiled()
    replaced_by(make)(path)
    again = library(SOURCE, ((("-O1",), ()),), ["twice"])
    assert again.is_file()
    assert not again.is_symlink()
    assert (again != path) == stays
    assert ctypes.CDLL(str(again)).twice


# --- compilers that fail -------------------------------------------------------------------------------------------


@pytest.fixture
def compiler(tmp_path, monkeypatch):
    """Make a shell script the compiler."""
    monkeypatch.setattr(compilers, "_hanging", {})

    def make(text):
        script = tmp_path / "my-cc"
        script.write_text(f'#!/bin/sh\nfor one; do [ "$one" = --version ] && exit; done\n{text}\n')
        script.chmod(0o755)
        monkeypatch.setenv("CC", f"{script} -DARGUMENT")

    return make


# Writes half of a library and claims success.
HALF = """last=; for one; do [ "$last" = -o ] && out=$one; last=$one; done
cc "${@}" && dd if="$out" of="$out.half" bs=1000 count=4 2>/dev/null && mv "$out.half" "$out" """


FAILING = [
    ("echo first >&2; echo second >&2; exit 3", r"my-cc failed \(first\)"),
    ("exit 3", "exit status 3"),
    ("kill -9 $$", "ended by signal 9"),
    ("exit 0", "wrote no library"),
    ("sleep 60 & echo $! > PIDS; sleep 60", r"did not end within 1.5 s"),
    (HALF, "cannot be loaded"),
]


@pytest.mark.parametrize(("text", "words"), FAILING)
def test_a_failing_compiler_is_named_and_leaves_nothing_behind(cache, compiler, monkeypatch, tmp_path, text, words):
    monkeypatch.setattr(compilers, "_TIMEOUT", 1.5 if "sleep" in text else 60.0)
    compiler(text.replace("PIDS", str(tmp_path / "pids")))
    for _ in range(2):
        assert library(SOURCE, ((("-O1",), ()), ((), ()))) is None
        assert re.search(words, compiler_problem())
    assert list(cache.iterdir()) == []
    if "sleep" in text:
        # A killed process may still be running for a moment on a busy machine.
        states = (time.sleep(0.05) or swept.process_of(int((tmp_path / "pids").read_text()))[0] for _ in range(200))
        assert any(state in "XZ" for state in states)


@pytest.mark.parametrize("who", ["compiler", "package"])
def test_a_full_cache_is_replaced_by_a_temporary_folder(cache, compiler, monkeypatch, who):
    def write(path, content, to=Path.write_bytes):
        if path.is_relative_to(cache):
            raise OSError(errno.ENOSPC, "No space left on device")
        return to(path, content)

    if who == "package":
        monkeypatch.setattr(Path, "write_bytes", write)
    else:
        compiler('case "$TMPDIR" in */cache/*) echo full >&2; exit 1;; esac; cc "$@"')
    path = compiled()
    assert not path.is_relative_to(cache)
    assert list(cache.iterdir()) == []


def test_folders_of_killed_processes_are_removed(cache):
    compiled()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    names = {number: cache / f"plough_opt-{number}-x" for number in (ended.pid, os.getpid(), 1)}
    names[10**22] = cache / f"plough_opt-{10**22}-x"  # no process has such a number
    for folder in (*names.values(), cache / f"plough_opt-{ended.pid}-young"):
        folder.mkdir()
        (folder / "0.so").touch()
        if "young" not in folder.name:
            os.utime(folder, (0, 0))
    compiled(SOURCE + "/* other */")
    left = {path.name.rpartition("-")[0] + path.name[-2:] for path in cache.iterdir() if path.is_dir()}
    assert left == {
        f"plough_opt-{number}" + end
        for number, end in ((ended.pid, "ng"), (os.getpid(), "-x"), (1, "-x"), (10**22, "-x"))
    }
