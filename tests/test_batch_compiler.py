"""Compilation of C on whatever the system offers: no compiler, a damaged or read-only cache, and several processes."""

import ctypes
import os
import subprocess
import sys

import casadi as ca
import pytest

import plough_opt as po
from plough_opt.core.compiler import find_compiler, library

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


@pytest.mark.parametrize(
    ("before", "found"),
    [
        ("", "temporary"),
        ("import os; del os.environ['HOME']; os.getuid = lambda: 2**31 - 3", "temporary"),  # nobody's home
        ("import tempfile; tempfile.tempdir = 'file'", "None"),
    ],
)
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
