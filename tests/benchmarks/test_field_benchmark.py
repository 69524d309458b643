"""How long each step from a penetrometer's readings to a share takes. Nothing here asserts a time."""

from pathlib import Path

import casadi as ca
import pytest

import plough_opt as po

pytestmark = pytest.mark.bench

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
FIELD = PROBLEMS / "field.toml"
LOAM = po.named_soil("firm sandy loam")


def test_cone_index(benchmark):
    benchmark(po.cone_index, LOAM)


@pytest.mark.parametrize("adjust", ["strength factor", "cohesion", "density ratio"])
def test_from_cone_index(benchmark, adjust):
    benchmark(po.Soil.from_cone_index, 1.5e6, LOAM, adjust)


def test_read_penetrometer(benchmark):
    benchmark(po.read_penetrometer, PROBLEMS / "insertions.csv", (0.25, 0.45))


def test_read_strength_record(benchmark):
    benchmark(po.read_strength_record, PROBLEMS / "transect.csv")


@pytest.mark.parametrize("part", [0.2, 0.8])
def test_strength_waves(benchmark, part):
    """One wave, and eight of them, in 800 readings."""
    record = po.read_strength_record(PROBLEMS / "transect.csv")
    benchmark.pedantic(po.strength_waves, (record, part), rounds=5, warmup_rounds=1)


def test_strength_spectrum(benchmark):
    benchmark(po.strength_spectrum, po.read_strength_record(PROBLEMS / "transect.csv"))


def scene(random, damping=4e3):
    effects = po.Effects(random_strength=random, damping=damping)
    return po.Scene(LOAM, po.Cone(po.deg(15.0), 0.21), 5e5, 60.0, 1.4, effects)


@pytest.fixture(params=["model", "record"])
def random(request):
    """Return a model of random strength, and the spectrum of a record."""
    if request.param == "model":
        return po.RandomStrength(0.12, 0.35)
    return po.strength_spectrum(po.read_strength_record(PROBLEMS / "transect.csv"))


def test_stationary_rms(benchmark, random):
    benchmark(lambda: scene(random).stationary_force_rms)


def test_stationary_rms_and_its_second_derivatives(benchmark, random):
    damping = ca.MX.sym("damping")
    rms = scene(random, damping).stationary_force_rms
    hessian, gradient = ca.hessian(rms, damping)
    benchmark(ca.Function("rms", [damping], [rms, gradient, hessian]), 4e3)


def test_from_readings_to_the_best_share(benchmark):
    """The whole of problems/field.toml, its search over all variables too."""
    benchmark.pedantic(lambda: po.read_problem(FIELD).optimise(), rounds=2)
