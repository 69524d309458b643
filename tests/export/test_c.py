"""The C export with a C compiler as its client."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.compiler import find_compiler
from plough_opt.export import write_c

COMPILER = find_compiler()
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
STRICT = ["-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-pedantic-errors"]


def _run(*command, folder):
    return subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, check=False)


def _compiled(folder, name, *flags):
    done = _run(*COMPILER, *flags, f"{name}_test.c", f"{name}.c", "-o", f"{name}_test", "-lm", folder=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return _run(f"./{name}_test", folder=folder)


@pytest.fixture(scope="module")
def folder(around_r1, tmp_path_factory):
    return write_c(around_r1, tmp_path_factory.mktemp("c") / "new" / "r1")


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_the_makefile_compares_with_pythons_numbers(folder):
    """The steps of a user; values and Jacobian are held against Python's, written as hexadecimal floats."""
    done = _run("make", folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    # CasADi's interpreter and its C do the same operations in the same order with the same C library.
    assert re.search(r"90 values, 270 derivatives: at most 0 ulp from Python", done.stdout)


def test_it_compiles_without_a_warning_and_keeps_to_4_ulp_unoptimised(with_columns, tmp_path):
    folder = write_c(with_columns, tmp_path / "c")
    done = _compiled(folder, with_columns.name(), *STRICT, "-O0")
    assert done.returncode == 0, done.stdout
    assert int(re.search(r"at most (\d+) ulp", done.stdout)[1]) <= 4


def _library(folder):
    """Return a written component as a shared library."""
    flags = ("-shared", "-fPIC", "-O0", "-ffp-contract=off")
    done = _run(*COMPILER, *flags, "share.c", "-o", "share.so", "-lm", folder=folder)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "share.so"))


@pytest.fixture(scope="module")
def share(folder):
    return _library(folder)


def _called(function, x, count):
    """Return the status of a C function, and its results."""
    results = np.zeros(count)
    doubles = ctypes.POINTER(ctypes.c_double)
    return function(np.array(x, dtype=float).ctypes.data_as(doubles), results.ctypes.data_as(doubles)), results


def test_a_program_reads_the_tables_and_calls_both_functions(around_r1, folder, share):
    """As a shared library: names, units, bounds, values and a Jacobian row by row."""
    texts = [(ctypes.c_char_p * 3).in_dll(share, f"share_input_{kind}") for kind in ("names", "units")]
    numbers = [(ctypes.c_double * 3).in_dll(share, f"share_input_{kind}") for kind in ("lower", "upper", "values")]
    read = [(n.decode(), u.decode(), *x) for n, u, *x in zip(*texts, *numbers, strict=True)]
    assert read == [(p.name, p.unit, p.lower, p.upper, p.value) for p in around_r1.inputs]
    outputs = (ctypes.c_char_p * 6).in_dll(share, "share_output_names")
    assert [name.decode() for name in outputs] == [port.name for port in around_r1.outputs]
    x = (0.6, 0.2, 3.5e4)
    (status, found), (of_jacobian, slopes) = _called(share.share_evaluate, x, 6), _called(share.share_jacobian, x, 18)
    assert status == of_jacobian == 0
    assert tuple(found) == around_r1(*x)
    assert slopes.reshape(6, 3).tolist() == around_r1.slopes(*x).full().tolist()
    header = (folder / "share.h").read_text()
    for text in ("in  share.height [m] 0.15 to 0.3", "out half_angle [rad] at most 0.261799", "plane sections"):
        assert text in header


@pytest.mark.parametrize("k", range(3))
def test_an_input_outside_its_bounds_gives_a_status_and_nan(around_r1, share, k):
    port, x = around_r1.inputs[k], [port.value for port in around_r1.inputs]
    width = port.upper - port.lower
    for x[k], status in ((port.lower - 0.9e-6 * width, 0), (port.upper + 1.1e-6 * width, 2), (np.nan, 2)):
        for function, count in ((share.share_evaluate, 6), (share.share_jacobian, 18)):
            found, results = _called(function, x, count)
            assert found == status
            assert np.isnan(results).all() == (status > 0)


def test_a_result_that_is_not_finite_gives_a_status(not_always_finite, tmp_path):
    share = _library(write_c(not_always_finite, tmp_path / "new"))
    assert [_called(share.share_evaluate, [height], 1)[0] for height in (0.26, 0.24)] == [0, 3]


def test_invalid_exports_are_refused_and_write_nothing(around_r1, r1_scene, r1_wave, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(po.InputError, match="cannot be written"):
        write_c(around_r1, tmp_path / "file" / "below")
    scene = r1_scene(orbit="periodic", strength_wave=r1_wave, damping=400.0)
    orbit = po.component(scene, inputs=["scene.stiffness"], outputs=["force_rms"], name="orbit")
    with pytest.raises(po.InputError, match="periodic orbit as C"):
        write_c(orbit, tmp_path / "orbit")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_the_files_compile_as_c_plus_plus(folder, tmp_path):
    command = ("g++", "-x", "c++", "-std=c++20", *STRICT[1:-1], "-O0", "-o", tmp_path / "t")
    done = _run(*command, "share.c", "share_test.c", "-lm", folder=folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert _run(tmp_path / "t", folder=folder).returncode == 0
