"""The C export with a C compiler as its client."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.compiler import find_compiler
from plough_opt.core.expressions import log
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
def test_its_own_makefile_finds_pythons_numbers(folder):
    """The steps of a user; values and Jacobian are held against Python's, written as hexadecimal floats."""
    done = _run("make", folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    # CasADi's interpreter and its C do the same operations in the same order with the same C library.
    assert re.search(r"90 values, 270 derivatives: at most 0 ulp from Python", done.stdout)


def test_it_compiles_without_a_warning_and_keeps_to_4_ulp_unoptimised(with_columns, tmp_path):
    folder = write_c(with_columns, tmp_path / "pulled")
    done = _compiled(folder, "pulled", *STRICT, "-O0")
    assert done.returncode == 0, done.stdout
    assert int(re.search(r"at most (\d+) ulp", done.stdout)[1]) <= 4


def test_the_test_can_fail(with_columns, tmp_path):
    """One expected number moved by five in the last place."""
    folder = write_c(with_columns, tmp_path / "pulled")
    source = folder / "pulled_test.c"
    text = source.read_text()
    block = text.index("outputs[POINTS]")
    first = re.compile(r"-?0x[0-9a-fp.+-]+").search(text, block)
    value = float.fromhex(first[0])
    moved = value + 5 * np.spacing(value)
    source.write_text(text[: first.start()] + moved.hex() + text[first.end() :])
    done = _compiled(folder, "pulled", "-O0", "-ffp-contract=off")
    assert done.returncode == 1
    assert "output 0 at point 0" in done.stdout
    assert "at most 5 ulp" in done.stdout


def test_a_program_of_ones_own_uses_the_header(around_r1, folder, tmp_path):
    """As a shared library: names, units, bounds, values and a Jacobian row by row."""
    library = tmp_path / "share.so"
    done = _run(
        *COMPILER, "-shared", "-fPIC", "-O0", "-ffp-contract=off", "share.c", "-o", library, "-lm", folder=folder
    )
    assert done.returncode == 0, done.stderr
    share = ctypes.CDLL(str(library))
    names = (ctypes.c_char_p * 3).in_dll(share, "share_input_names")
    units = (ctypes.c_char_p * 3).in_dll(share, "share_input_units")
    lower, upper, values = (
        (ctypes.c_double * 3).in_dll(share, f"share_input_{kind}") for kind in ("lower", "upper", "values")
    )
    told = [(n.decode(), u.decode(), *x) for n, u, *x in zip(names, units, lower, upper, values, strict=True)]
    assert told == [(p.name, p.unit, p.lower, p.upper, p.value) for p in around_r1.inputs]
    outputs = (ctypes.c_char_p * 6).in_dll(share, "share_output_names")
    assert [name.decode() for name in outputs] == [port.name for port in around_r1.outputs]
    x = (ctypes.c_double * 3)(0.6, 0.2, 3.5e4)
    found, slopes = (ctypes.c_double * 6)(), (ctypes.c_double * 18)()
    assert share.share_evaluate(x, found) == 0
    assert share.share_jacobian(x, slopes) == 0
    assert tuple(found) == around_r1(*x)
    assert np.array(slopes).reshape(6, 3).tolist() == around_r1.slopes(*x).full().tolist()
    header = (folder / "share.h").read_text()
    for text in ("in  share.height [m] 0.15 to 0.3", "out half_angle [rad] at most 0.261799", "plane sections"):
        assert text in header


def test_a_quasi_static_scene_and_the_linear_response_have_c(r1_scene, r1_wave, tmp_path):
    for name, duration, effects in (
        ("steady", 2.0, {"motion": False, "strength_wave": r1_wave}),
        ("linear", None, {"orbit": "linearised", "strength_wave": r1_wave, "damping": 300.0}),
    ):
        made = po.component(
            r1_scene(**effects), duration, inputs=["share.height"], outputs=["mean_draft", "force_rms"], name=name
        )
        done = _compiled(write_c(made, tmp_path / name), name, "-O0", "-ffp-contract=off")
        assert done.returncode == 0, done.stdout


def test_what_cannot_be_is_refused_and_nothing_is_written(around_r1, r1_scene, r1_wave, tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(po.InputError, match="exists already and is left as it is"):
        write_c(around_r1, tmp_path / "taken")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(po.InputError, match="cannot be written"):
        write_c(around_r1, tmp_path / "file" / "below")
    orbit = po.component(
        r1_scene(orbit="periodic", strength_wave=r1_wave, damping=400.0),
        inputs=["scene.stiffness"],
        outputs=["force_rms"],
        name="orbit",
    )
    with pytest.raises(po.InputError, match="periodic orbit as C"):
        write_c(orbit, tmp_path / "orbit")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "taken"]
    assert not list((tmp_path / "taken").iterdir())


@pytest.mark.parametrize("name", ["double", "main"])
def test_words_of_c_are_names_like_others(r1_scene, tmp_path, name):
    made = po.component(r1_scene(motion=False), 1.0, inputs=["share.height"], outputs=["mean_draft"], name=name)
    done = _compiled(write_c(made, tmp_path / "c"), name, *STRICT, "-O0")
    assert done.returncode == 0, done.stdout


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_it_is_c_plus_plus_too(folder, tmp_path):
    command = ("g++", "-x", "c++", "-std=c++20", *STRICT[1:-1], "-O0", "-o", tmp_path / "t")
    done = _run(*command, "share.c", "share_test.c", "-lm", folder=folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert _run(tmp_path / "t", folder=folder).returncode == 0


OUTSIDE = """
#include <math.h>
#include <stdio.h>
#include "share.h"
int main(void) {
  double x[SHARE_INPUTS], y[SHARE_OUTPUTS], slopes[SHARE_OUTPUTS * SHARE_INPUTS];
  int j, k, side;
  for (j = 0; j < SHARE_INPUTS; ++j)
    for (side = 0; side < 4; ++side) {
      double width = share_input_upper[j] - share_input_lower[j];
      double at[] = {share_input_lower[j] - 0.9e-6 * width, share_input_lower[j] - 1.1e-6 * width,
                     share_input_upper[j] + 1.1e-6 * width, NAN};
      for (k = 0; k < SHARE_INPUTS; ++k) x[k] = share_input_values[k];
      x[j] = at[side];
      for (k = 0; k < SHARE_OUTPUTS; ++k) y[k] = 0.0;
      printf("%d", share_evaluate(x, y));
      printf("%d", share_jacobian(x, slopes));
      for (k = 0; k < SHARE_OUTPUTS; ++k)
        if (isnan(y[k]) != (side > 0) || isnan(slopes[k * SHARE_INPUTS]) != (side > 0)) return 1;
    }
  return 0;
}
"""


def test_outside_its_bounds_it_says_so_and_gives_nothing(folder, tmp_path):
    (tmp_path / "outside.c").write_text(OUTSIDE)
    command = (*COMPILER, *STRICT, "-O0", f"-I{folder}", tmp_path / "outside.c", folder / "share.c", "-o", "t", "-lm")
    done = _run(*command, folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    done = _run("./t", folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, "00222222" * 3)


def test_a_result_that_is_not_finite_is_a_status(r1_scene, tmp_path):
    """The logarithm of a height that may be zero."""
    logarithm = po.Output("logarithm", of=lambda run: log(run.scene.share.height - 0.25), unit="")
    inputs = [po.Input("share.height", 0.2, 0.3, 0.26)]
    made = po.component(r1_scene(motion=False), 1.0, inputs=inputs, outputs=[logarithm])
    (tmp_path / "c").mkdir()
    folder = write_c(made, tmp_path / "c" / "new")
    command = (*COMPILER, "-shared", "-fPIC", "-O0", "share.c", "-o", "share.so", "-lm")
    assert _run(*command, folder=folder).returncode == 0
    share = ctypes.CDLL(str(folder / "share.so"))
    found = ctypes.c_double()
    assert [share.share_evaluate(ctypes.byref(ctypes.c_double(x)), ctypes.byref(found)) for x in (0.26, 0.24)] == [0, 3]
