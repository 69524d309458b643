"""The motion of many shares in C, for the millions of designs behind a truth; it needs a C compiler.

The method is of order 8 with fixed steps (the weights of SciPy's DOP853), with sixteen designs in the lanes of an inner
loop; averages are quadratures with the method's own weights, and outputs between steps lie on polynomials of degree 5.
"""

import ctypes
import hashlib
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from scipy.integrate import DOP853

from independent import motion

_A, _B, _C = DOP853.A[:12, :12], DOP853.B[:12], DOP853.C[:12]
_AA = _A @ _A
_POINTER = ctypes.POINTER(ctypes.c_double)


def _combination(weights, name, by="l"):
    """Return the C expression of a weighted sum of earlier stages."""
    terms = [f"{weight!r}*{name}[{j}][{by}]" for j, weight in enumerate(map(float, weights)) if weight != 0.0]
    return " + ".join(terms) or "0.0"


def _stage(i):
    """Return the C call of the macro of one stage."""
    places, rates = _combination(_AA[i, :i], "acc"), _combination(_A[i, :i], "acc")
    return f"STAGE({i}, {float(_C[i])!r}, {places}, {rates}, {float(_B[i])!r})"


@cache
def _library():
    """Compile the steps, once for each temporary folder."""
    source = Path(__file__).with_name("steps.c").read_text(encoding="utf-8")
    weights = {
        "STAGES": "\n".join(map(_stage, range(12))),
        "SPEEDS": _combination(_B, "at"),
        "RATES": _combination(_B, "acc"),
    }
    for name, text in weights.items():
        source = source.replace(f"@{name}@", text)
    key = hashlib.sha256(f"{source} linked plainly".encode()).hexdigest()[:16]
    target = Path(tempfile.gettempdir()) / f"plough_truth_{key}.so"
    if not target.exists():
        with tempfile.TemporaryDirectory() as folder:
            code, built = Path(folder) / "steps.c", Path(folder) / "steps.so"
            code.write_text(source, encoding="utf-8")
            plain, compiled = ["cc", "-shared", "-fPIC", "-o", built], Path(folder) / "steps.o"
            subprocess.run(
                ["cc", "-c", "-O3", "-march=native", "-ffast-math", "-fPIC", "-o", compiled, code], check=True
            )
            # Linked with -ffast-math, the library would disable denormal numbers in the whole process.
            subprocess.run([*plain, compiled, "-lm"], check=True)
            built.replace(target)
    found = ctypes.CDLL(str(target)).advance
    found.argtypes = [ctypes.c_long, _POINTER, ctypes.c_double, ctypes.c_int, _POINTER, _POINTER]
    return found


def simulate(runs, *, phase=0.5, paths=False):
    """Return the response of every run; NaN if a share runs away.

    Args:
        runs: a `motion.Motion`.
        phase: phase of the summed rates in a step [rad]. 0.5 leaves relative errors of about 1e-10 (paths: 1e-8), 1.4
            of about 1e-6 (paths: 1e-5).
        paths: whether to return deflection and mount force at the output times.
    """
    steps, followed = motion.steps_of(runs, phase, paths)
    order = np.argsort(-steps, kind="stable")
    one, steps = runs.take(order), steps[order]
    before, durations = motion.split(one, steps)
    w, v = one.first()
    n, mass = len(one), one.inertia
    with np.errstate(all="ignore"):
        p = np.ascontiguousarray(
            [
                one.static * one.amplitude / mass, one.drag / mass, one.stiffness / mass, one.damping / mass,
                2.0 * np.pi / one.wavelength, one.speed, one.ramp, one.steady, one.stiffness,
                one.damping, one.static + one.drag * one.speed**2, w, v, durations[0], durations[1], before, steps,
                np.where(one.ramp > 0.0, 1.0 / one.ramp, 0.0), one.ramp <= 0.0,
            ],
            dtype=float,
        )  # fmt: skip
    sums = np.empty((5, n))
    course = np.empty((2, motion.OUTPUTS + 1, n)) if paths else np.empty(0)
    pointers = (array.ctypes.data_as(_POINTER) for array in (sums, course))
    _library()(n, p.ctypes.data_as(_POINTER), runs.duration, motion.OUTPUTS if paths else 0, *pointers)
    with np.errstate(all="ignore"):
        averages = motion.averages_of(one, p[10], sums)
    back = np.argsort(order, kind="stable")
    averages = averages[:, back]
    averages[:, ~followed] = np.nan
    averages[:, ~np.all(np.isfinite(averages), axis=0)] = np.nan
    return motion.Response(*averages, *(course[:, :, back] if paths else ()))
