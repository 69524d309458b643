"""Scenes that several test files share."""

import collections
import gc
import itertools
import math
import signal
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import pytest
from helpers.browser import chromium
from helpers.scenes import R1_SOIL

import plough_opt as po
from plough_opt.core import process as heartbeat
from plough_opt.motion.solvers.compiled_steps import compiled_steps

HERE = Path(__file__).parent


@pytest.fixture
def ctrl_c():
    """Give Ctrl-C its usual effect here and in processes started meanwhile, as at a terminal.

    A shell makes tests in the background ignore it.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session", autouse=True)
def no_lines_that_depend_on_time():
    """Suppress progress lines, which commands write only on a busy machine."""
    before, heartbeat.INTERVAL = heartbeat.INTERVAL, 3600.0
    yield
    heartbeat.INTERVAL = before


THINNED = tomllib.loads((HERE / "thinned.toml").read_text(encoding="utf-8"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark as slow and as thorough what `thinned.toml` leaves out, before pytest selects."""
    seen = collections.Counter()
    tests, long, one_of = collections.defaultdict(dict), THINNED["long"], THINNED["one_of"]
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        file = item.path.relative_to(HERE).with_suffix("").as_posix()
        name = f"{file}::{item.originalname}"
        step = one_of.get(name, one_of.get(file, 1))
        if step == 0:
            item.add_marker(pytest.mark.slow)
        elif step > 1 and hasattr(item, "callspec") and item.get_closest_marker("slow") is None:
            if seen[name] % step:
                item.add_marker(pytest.mark.slow)
            seen[name] += 1
        if file in long and tests[file].setdefault(item.originalname, len(tests[file])) % 3:
            item.add_marker(pytest.mark.thorough)


# Modules and tests last to the end: the garbage collector would look through them again and again, a third of the time
# of the collection and a tenth of that of the tests.
gc.disable()


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def inline():
    """Return an executor in this process."""
    with ThreadPoolExecutor(1) as executor:
        yield executor


@pytest.fixture
def no_compiler(monkeypatch, tmp_path):
    """Hide the C compilers, and what they compiled before."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    compiled_steps.cache_clear()
    yield
    compiled_steps.cache_clear()


@pytest.fixture
def batch_of(r1_scene):
    """Build a batch of the wedge angle, the height and the stiffness of a scene of problem R1."""

    def build(duration=1.0, error=1e-9, **effects):
        angle, height, k0 = inputs = [ca.MX.sym(name) for name in ("angle", "height", "k0")]
        return po.Batch(r1_scene(angle * (180.0 / math.pi), height, k0, **effects), duration, inputs, error=error)

    return build


# Argument of `plough_opt.Effects` -> its value without and with the effect, which is strong enough to matter.
EFFECTS = {
    "inertial_drag": (False, True), "rate_term": (None, 0.05), "strength_wave": (None, po.StrengthWave(0.3, 0.6)),
    "tow_ramp": (None, 0.137), "damping": (None, 250.0), "start": ("equilibrium", "rest"),
}  # fmt: skip


def _is_covering(drag, rate, wave, ramp, damper, rest):
    # Eight of the 64 combinations, which contain all four settings of any two flags.
    return ramp == (drag ^ rate) and damper == (drag ^ wave) and rest == (rate ^ wave)


# For a module: in its thread playwright keeps an event loop running, so that asyncio could start no other.
@pytest.fixture(scope="module")
def browser():
    """Return a headless Chromium."""
    with chromium() as started:
        yield started


@pytest.fixture(scope="session")
def r1_soil():
    return R1_SOIL


@pytest.fixture(scope="session")
def r1_scene(r1_soil):
    """Build a scene of problem R1: a steel share and 20 kg of frame at 2 m/s under a strength wave."""

    def build(wedge_angle_deg=25.0, height=0.25, stiffness=5e4, *, tow_speed=2.0, soil=r1_soil, **effects):
        share = po.Wedge(po.deg(wedge_angle_deg), po.deg(15.0), height)
        mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
        return po.Scene(soil, share, stiffness, mass, tow_speed, po.Effects(**effects))

    return build


@pytest.fixture(scope="session")
def r1_wave():
    return po.StrengthWave(amplitude=0.3, wavelength=0.6)


@pytest.fixture(
    params=[
        pytest.param(
            {name: EFFECTS[name][on] for name, on in zip(EFFECTS, flags, strict=True)},
            id="+".join(name for name, on in zip(EFFECTS, flags, strict=True) if on) or "none",
            marks=() if _is_covering(*flags) else pytest.mark.slow,
        )
        for flags in itertools.product((False, True), repeat=len(EFFECTS))
    ]
)
def effects(request):
    """Return the arguments of `plough_opt.Effects`: eight combinations that cover all pairs, and in slow tests all."""
    return request.param
