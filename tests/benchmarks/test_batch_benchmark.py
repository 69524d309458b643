"""Designs per second of a batch beside an expert's own C for problem R1. Nothing here asserts a time."""

import ctypes
import math
import shutil
import subprocess
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.terms import parameters

pytestmark = pytest.mark.bench

PEERS = Path(__file__).resolve().parent / "peers"
WANTED = 1e-6
START = (po.deg(25.0), 0.25, 5e4)


def _batch(soil, wave, **options):
    angle, height, k0 = (ca.MX.sym(name) for name in ("angle", "height", "k0"))
    share = po.Wedge(angle, po.deg(15.0), height)
    mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
    scene = po.Scene(soil, share, k0, mass, 2.0, po.Effects(strength_wave=wave))
    return po.Batch(scene, 2.0, [angle, height, k0], **options), scene, [angle, height, k0]


def _domain(count):
    random = np.random.default_rng(0)
    stiffness = np.exp(random.uniform(math.log(5e3), math.log(5e5), count))
    return np.column_stack(
        [random.uniform(po.deg(5.0), po.deg(60.0), count), random.uniform(0.1, 0.5, count), stiffness]
    )


def _near_start(count):
    return np.array(START) * np.random.default_rng(1).uniform(0.999, 1.001, (count, 3))


def _seconds(function, rounds=7):
    """Return the least processor time of some calls [s]: others share the machine."""
    function()
    times = []
    for _ in range(rounds):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return min(times)


class _Peer:
    """The C source in peers/, one design or a vector register of them at a time."""

    def __init__(self, folder, *flags):
        path = folder / f"peer{len(flags)}.so"
        command = ["cc", "-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", *flags, str(PEERS / "rk4.c")]
        subprocess.run([*command, "-o", str(path), "-lmvec", "-lm"], check=True)
        self._library = ctypes.CDLL(str(path))
        self._library.run.restype = None

    def __call__(self, p, steps, wave):
        out = np.empty((2, p.shape[1]))
        numbers = (ctypes.c_double(x) for x in (2.0, 2.0, wave.amplitude, wave.wavelength))
        pointers = (ctypes.c_void_p(a.ctypes.data) for a in (p, out))
        self._library.run(ctypes.c_int64(p.shape[1]), *pointers, ctypes.c_int64(steps), *numbers)
        return out


def _peer_parameters(scene, inputs, values):
    """Return F0, Fd, M, k and z0 of designs, a row each, and the mean draft's steady part."""
    known = parameters(scene)
    steady = known["static"] + known["drag"] * scene.tow_speed**2
    rows = [known[name] for name in ("static", "drag", "inertia", "stiffness")] + [steady / known["stiffness"]]
    return np.ascontiguousarray(ca.Function("f", inputs, [ca.vertcat(*rows)]).map(len(values))(*values.T[:, None, :]))


def _error(p, out, reference):
    mean, rms = p[3] * (p[4] + out[0]), p[3] * out[1]
    size = np.maximum(reference.mean_draft, reference.force_rms)
    return np.max(np.maximum(abs(mean - reference.mean_draft), abs(rms - reference.force_rms)) / size)


@pytest.mark.parametrize("where", ["start", "domain"])
def test_batch_beside_hand_written_c(r1_soil, r1_wave, tmp_path, where, capsys):
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    values = {"start": _near_start, "domain": _domain}[where](16384)
    batch, scene, inputs = _batch(r1_soil, r1_wave, error=WANTED)
    reference = _batch(r1_soil, r1_wave, error=1e-10)[0](values)
    p = _peer_parameters(scene, inputs, values)
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    width = 8 if "avx512f" in flags else 4 if "avx2" in flags else 2
    scalar, vector = _Peer(tmp_path), _Peer(tmp_path, f"-DWIDTH={width}")
    # As few steps as keep the error for all designs.
    steps = next(
        n for n in (int(100 * 1.1**k) for k in range(60)) if _error(p, vector(p, n, r1_wave), reference) < WANTED
    )
    few = np.ascontiguousarray(p[:, :2048])
    rates = {
        "batch": len(values) / _seconds(lambda: batch(values)),
        f"RK4, C, {width} designs side by side": len(values) / _seconds(lambda: vector(p, steps, r1_wave), 3),
        "RK4, C, one design at a time": few.shape[1] / _seconds(lambda: scalar(few, steps, r1_wave), 3),
    }
    found = batch(values)
    size = np.maximum(reference.mean_draft, reference.force_rms)
    errors = np.maximum(abs(found.mean_draft - reference.mean_draft), abs(found.force_rms - reference.force_rms)) / size
    assert np.max(errors) < WANTED
    with capsys.disabled():
        print(f"\n{where}: all errors below {WANTED}: RK4 in {steps} steps, a batch in {found.steps.mean():.0f}")
        print(f"  error of a batch: largest {np.max(errors):.1e}, median {np.median(errors):.1e}")
        for name, rate in rates.items():
            print(f"  {name:36s} {rate:9.3g} designs per second and core   {rates['batch'] / rate:6.2f}")


def test_time_and_memory_grow_with_the_batch_as_they_must(r1_soil, r1_wave, capsys):
    batch, *_ = _batch(r1_soil, r1_wave, error=WANTED)
    counts = (4096, 16384, 65536, 262144)
    times = [_seconds(lambda count=count: batch(_domain(count)), 3) for count in counts]
    exponent = np.polyfit(np.log(counts), np.log(times), 1)[0]
    with capsys.disabled():
        print(f"\ntime grows with the number of designs to the power {exponent:.3f}")
        for count, seconds in zip(counts, times, strict=True):
            print(f"  {count:7d} designs {seconds:8.3f} s, {count / seconds:9.3g} per second")


def test_build(benchmark, r1_soil, r1_wave):
    benchmark.pedantic(_batch, (r1_soil, r1_wave), rounds=5, warmup_rounds=1)


def test_one_design(benchmark, r1_soil, r1_wave):
    batch, *_ = _batch(r1_soil, r1_wave)
    benchmark(batch, [START])
