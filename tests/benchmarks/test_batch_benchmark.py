"""How long a batch takes to build, and to simulate one design. Nothing here asserts a time."""

import casadi as ca
import pytest

import plough_opt as po

pytestmark = pytest.mark.bench

START = (po.deg(25.0), 0.25, 5e4)


def _batch(soil, wave):
    angle, height, k0 = (ca.MX.sym(name) for name in ("angle", "height", "k0"))
    share = po.Wedge(angle, po.deg(15.0), height)
    mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
    return po.Batch(po.Scene(soil, share, k0, mass, 2.0, po.Effects(strength_wave=wave)), 2.0, [angle, height, k0])


def test_build(benchmark, r1_soil, r1_wave):
    benchmark.pedantic(_batch, (r1_soil, r1_wave), rounds=5, warmup_rounds=1)


def test_one_design(benchmark, r1_soil, r1_wave):
    batch = _batch(r1_soil, r1_wave)
    benchmark(batch, [START])
