"""Compiled batches whatever the system offers: no compiler, a spoilt or forbidden cache, and two processes at once."""

import subprocess
import sys

import casadi as ca
import pytest

import plough_opt as po
from plough_opt.core.compiler import find_compiler

SCRIPT = """
import sys
import casadi as ca
import plough_opt as po
k0 = ca.SX.sym("k0")
soil = po.Soil(1400.0, 0.8, 15e3, po.deg(30.0), 0.5, 1e4)
scene = po.Scene(soil, po.Cone(po.deg(10.0), 0.25), k0, 25.0, 2.0, po.Effects(strength_wave=po.StrengthWave(0.3, 0.6)))
batch = po.Batch(scene, 1.0, [k0], error=1e-6)
result = batch([[2e4], [5e4]])
print(batch.compiled, result.mean_draft[0].hex(), result.force_rms[1].hex())
"""


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "plough_opt"


@pytest.fixture
def build(r1_soil):
    def made():
        k0 = ca.SX.sym("k0")
        effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6))
        scene = po.Scene(r1_soil, po.Cone(po.deg(10.0), 0.25), k0, 25.0, 2.0, effects)
        return po.Batch(scene, 1.0, [k0], error=1e-6)

    return made


@pytest.mark.usefixtures("cache")
def test_without_a_compiler(build, monkeypatch, tmp_path):
    compiled = build()
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "no_such_compiler")
    plain = build()
    assert find_compiler() is None
    assert (compiled.compiled, plain.compiled) == (True, False)
    assert compiled.warnings == ()
    (warning,) = plain.warnings
    assert "no C compiler was found" in warning
    assert "slower" in warning
    assert plain([[5e4]]).warnings == plain.warnings
    assert plain([[5e4]]).force_rms[0] == pytest.approx(compiled([[5e4]]).force_rms[0], rel=1e-12)


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("compiler", ["false", "true"])
def test_a_compiler_that_makes_nothing(build, monkeypatch, compiler):
    monkeypatch.setenv("CC", compiler)
    assert not build().compiled


def test_a_library_is_compiled_once(build, cache):
    build()
    (library,) = cache.iterdir()
    before = library.stat()
    assert build().compiled
    assert list(cache.iterdir()) == [library]
    assert library.stat() == before


@pytest.mark.parametrize("spoilt", [b"", b"no library", None], ids=["empty", "other", "cut"])
def test_a_spoilt_library_is_compiled_again(build, cache, spoilt):
    expected = build()([[5e4]]).mean_draft[0]
    (library,) = cache.iterdir()
    content = library.read_bytes()
    # A new file: writing into one that is loaded would pull the ground from under it.
    library.unlink()
    library.write_bytes(content[: len(content) // 2] if spoilt is None else spoilt)
    again = build()
    assert again.compiled
    assert again([[5e4]]).mean_draft[0] == expected
    assert library.read_bytes()[:4] == content[:4]
    assert len(library.read_bytes()) == len(content)


def test_a_cache_that_cannot_be_written(build, tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert build().compiled
    assert blocked.read_text() == "no folder"


def test_processes_at_once(cache):
    command = [sys.executable, "-c", SCRIPT]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    printed = [process.communicate(timeout=120)[0] for process in running]
    assert [process.returncode for process in running] == [0, 0]
    assert printed[0] == printed[1]
    assert printed[0].startswith("True")
    assert [path.suffix for path in cache.iterdir()] == [".so"]
