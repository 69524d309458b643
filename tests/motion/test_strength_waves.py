"""Several strength waves: their sum in every kind of run, against an independent solver and linear series."""

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.differences import order_4
from helpers.scenes import scene_of

import plough_opt as po

WAVES = (po.StrengthWave(0.2, 0.2), po.StrengthWave(0.1, 0.3, 0.7), po.StrengthWave(0.05, 0.12, -2.0))


def scene(waves=WAVES, **effects):
    """Return a scene of a damped share in serozem under strength waves."""
    return scene_of(**{"strength_wave": waves, "damping": 400.0} | effects)


@pytest.mark.parametrize("effects", [{}, {"contact": po.StickSlip(1.1)}, {"entry": True, "start": "rest"}], ids=str)
def test_an_independent_solver_agrees(effects):
    three_modes.agreed(scene(**effects), 1.0, outputs=50)


def test_a_phase_is_a_shift_of_the_path():
    """Soil of phase phi is that of phase 0, shifted by phi/(2 pi) wavelengths."""
    later = po.simulate(scene(po.StrengthWave(0.3, 0.2, 1.0), motion=False, damping=None), 1.0, outputs=400)
    shift = 1.0 / (2 * math.pi) * 0.2
    force = scene().reaction.static * (1 + 0.3 * np.sin(2 * math.pi * (later.travel + shift) / 0.2))
    drag = scene().reaction.drag * 4.0
    assert later.soil_resistance == pytest.approx(force + drag, rel=1e-13)


def test_the_periodic_orbit_is_the_end_of_a_long_run():
    orbit = po.simulate(scene(orbit="periodic"))
    # The common length of 0.2, 0.3 and 0.12 m is 0.6 m.
    assert orbit.duration == pytest.approx(0.3, rel=1e-15)
    long = po.simulate(scene(), 6.0, outputs=2400)
    last = long.mount_force[-121:-1]  # one period
    assert np.std(last) == pytest.approx(orbit.force_rms, rel=1e-5)  # error of 120 samples
    balanced = po.simulate(scene(orbit=po.HarmonicBalance(20)))
    assert balanced.force_rms == pytest.approx(orbit.force_rms, rel=1e-6)


def test_small_waves_add_up_in_the_linear_response():
    small = tuple(po.StrengthWave(1e-5 * w.amplitude, w.wavelength, w.phase) for w in WAVES)
    together = po.simulate(scene(small, orbit="linearised"))
    alone = [po.simulate(scene(w, orbit="linearised")) for w in small]
    squares = sum(run.force_rms**2 for run in alone)
    assert together.force_rms == pytest.approx(math.sqrt(squares), rel=1e-12)
    orbit = po.simulate(scene(small, orbit="periodic"))
    # The difference is of second order in the amplitude.
    assert orbit.force_rms == pytest.approx(together.force_rms, rel=1e-4)


@pytest.mark.parametrize("name", ["amplitude", "wavelength", "phase"])
def test_derivatives_by_each_number(name):
    x = ca.MX.sym("x")
    value = getattr(WAVES[1], name)

    def changed(new):
        return scene((WAVES[0], replace(WAVES[1], **{name: new}), WAVES[2]))

    rms = po.simulate(changed(x), 1.0).force_rms
    slope = float(ca.Function("slope", [x], [ca.jacobian(rms, x)])(value))
    # Steps of 1e-3 have an error of about 1e-9.
    expected = order_4(lambda new: float(po.simulate(changed(new), 1.0).force_rms), value, 1e-3 * value)
    assert slope == pytest.approx(expected, rel=1e-6)
