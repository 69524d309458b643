"""The motion of many shares on their mounts in C, for the millions of designs behind a truth; it needs a C compiler.

It integrates w = z - z_s of equation (27), the deflection relative to the steady one at tow speed. The method is of
order 8 (the weights of SciPy's DOP853) with fixed steps, a number for each design, and sixteen designs in the lanes of
an inner loop; averages are quadratures with the method's own weights, and outputs between steps lie on polynomials of
degree 5.
"""

import ctypes
import hashlib
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from scipy.integrate import DOP853

OUTPUTS = 400
AVERAGES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
PATHS = ("deflection", "mount force")
# Factor on the step if paths are wanted: their polynomials of degree 5 between steps are less accurate than the steps.
_FOR_PATHS = 0.6
_FEWEST = 20
# A run that needs more steps is not integrated; its results are NaN.
_MOST = 20_000
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
    stages = "\n".join(map(_stage, range(12)))
    for name, text in (("STAGES", stages), ("SPEEDS", _combination(_B, "at")), ("RATES", _combination(_B, "acc"))):
        source = source.replace(f"@{name}@", text)
    key = hashlib.sha256(f"{source} linked plainly".encode()).hexdigest()[:16]
    target = Path(tempfile.gettempdir()) / f"plough_truth_{key}.so"
    if not target.exists():
        with tempfile.TemporaryDirectory() as folder:
            code, compiled, built = (Path(folder) / f"steps.{kind}" for kind in ("c", "o", "so"))
            code.write_text(source, encoding="utf-8")
            fast = ["-O3", "-march=native", "-ffast-math", "-fPIC"]
            subprocess.run(["cc", "-c", *fast, "-o", compiled, code], check=True)
            # Linked with -ffast-math, the library would disable denormal numbers in the whole process.
            subprocess.run(["cc", "-shared", "-fPIC", "-o", built, compiled, "-lm"], check=True)
            built.replace(target)
    found = ctypes.CDLL(str(target)).advance
    found.argtypes = [ctypes.c_long, _POINTER, ctypes.c_double, ctypes.c_int, _POINTER, _POINTER]
    return found


def simulate(
    static, drag, inertia, stiffness, damping, speed, amplitude, wavelength, ramp, start, duration, *, phase=0.5,
    paths=False
):  # fmt: skip
    """Return results by name, arrays over designs: `AVERAGES` and, if requested, `PATHS` with a row for each output.

    They are NaN if a share runs away.

    Args:
        static: F0 [N], like all others but the last two an array over designs or a number.
        drag: Fd [N s^2/m^2].
        inertia: M, share and added mass [kg].
        stiffness: k0 [N/m].
        damping: c [N s/m].
        speed: V0 [m/s].
        amplitude: of the strength wave [-]; 0 without one.
        wavelength: of the wave [m].
        ramp: time in which the strut reaches its speed [s]; 0 without a ramp.
        start: "equilibrium", "rest" or "towed".
        duration: simulated time [s].
        phase: phase of the summed rates in a step [rad]. 0.5 leaves relative errors of about 1e-10 (paths: 1e-8), 1.4
            of about 1e-6 (paths: 1e-5).
        paths: whether to return deflection and mount force at the output times.
    """
    given = static, drag, inertia, stiffness, damping, speed, amplitude, wavelength, ramp
    rows = np.array([np.ravel(x) for x in np.broadcast_arrays(*map(np.atleast_1d, given))], dtype=float)
    with np.errstate(all="ignore"):
        steps, followed = _steps(rows, duration, phase * _FOR_PATHS if paths else phase)
        # The lanes of a loop end together.
        order = np.argsort(-steps, kind="stable")
        p, steady = _arguments(rows[:, order], steps[order], start, duration)
        n = len(order)
        sums, course = np.empty((5, n)), np.empty((2, OUTPUTS + 1, n) if paths else 0)
        pointers = (array.ctypes.data_as(_POINTER) for array in (sums, course))
        _library()(n, p.ctypes.data_as(_POINTER), duration, OUTPUTS if paths else 0, *pointers)
        w, square_w, force, square_force, power = sums / duration
        spreads = (np.sqrt(np.maximum(x - y**2, 0.0)) for x, y in ((square_force, force), (square_w, w)))
        averages = np.array([p[10] + force, next(spreads), steady + w, next(spreads), power])
    back = np.argsort(order, kind="stable")
    averages = averages[:, back]
    averages[:, ~(followed & np.all(np.isfinite(averages), axis=0))] = np.nan
    found = dict(zip(AVERAGES, averages, strict=True))
    return found | dict(zip(PATHS, course[:, :, back], strict=True)) if paths else found


def _steps(rows, duration, phase):
    """Return each run's number of steps, and whether it is integrated at all."""
    _, drag, inertia, stiffness, damping, speed, amplitude, wavelength, _ = rows
    wave = np.where(amplitude > 0.0, 2.0 * np.pi * speed / wavelength, 0.0)
    rate = np.sqrt(stiffness / inertia) + (damping + 2.0 * drag * speed) / inertia + wave
    wanted = np.ceil(rate * duration / phase)
    followed = wanted <= _MOST
    steps = np.clip(np.where(followed, wanted, 1.0), _FEWEST, _MOST)
    # Rounded up to four binary digits, so that designs side by side have equal steps and smooth differences.
    unit = 2.0 ** np.maximum(np.floor(np.log2(steps)) - 3.0, 0.0)
    return np.where(followed, unit * np.ceil(steps / unit), 1).astype(int), followed


def _arguments(rows, steps, start, duration):
    """Return the rows of numbers that steps.c takes, and the steady deflection z_s."""
    static, drag, inertia, stiffness, damping, speed, amplitude, wavelength, ramp = rows
    pull = static + drag * speed**2
    first = np.where(ramp > 0.0, 0.0, speed)
    if start == "equilibrium":
        w, rate = drag * (first**2 - speed**2) / stiffness, 0.0 * speed
    else:
        w, rate = -pull / stiffness, first if start == "rest" else 0.0 * speed
    # Some steps lie in the ramp and the others after it, so that a step ends with it.
    inside = np.clip(ramp / duration, 0.0, 1.0)
    before = np.where(inside > 0.0, np.clip(np.round(steps * inside), 1, None), 0).astype(int)
    before = np.where(inside < 1.0, np.minimum(before, steps - 1), steps)
    p = [
        static * amplitude / inertia, drag / inertia, stiffness / inertia, damping / inertia, 2.0 * np.pi / wavelength,
        speed, ramp, pull / stiffness, stiffness, damping, pull, w, rate,
        np.minimum(ramp, duration) / np.maximum(before, 1),
        np.maximum(duration - ramp, 0.0) / np.maximum(steps - before, 1),
        before, steps, np.where(ramp > 0.0, 1.0 / ramp, 0.0), ramp <= 0.0,
    ]  # fmt: skip
    return np.ascontiguousarray(p, dtype=float), pull / stiffness
