"""Own effects under stick-slip: what holds a resting share, and what is refused."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.expressions import Expression
from plough_opt.studies.accuracy.reference import reference_run

WAVE = po.StrengthWave(0.8, 0.3)
SLIP = po.StickSlip(1.3)


@dataclass(frozen=True)
class Constant(po.ResistanceLaw):
    """A static resistance, whatever the share."""

    newtons: Expression
    label = "a constant resistance"

    def reaction(self, at):
        del at
        return po.SoilReaction(static=self.newtons)


@dataclass(frozen=True)
class Shank:
    slipping: Expression
    resting: Expression
    per_metre: Expression = 0.0
    viscous: Expression = 0.0

    def force(self, travel, speed):
        return self.slipping + self.per_metre * travel + self.viscous * speed

    def at_rest(self, travel):
        return self.resting + self.per_metre * travel


def scene(newtons, *own, wave=None, stiffness=2e4, **effects):
    share = po.Wedge(po.deg(30), po.deg(15), 0.25)
    given = {"contact": SLIP, "start": "rest"} | effects
    return po.Scene(po.named_soil("serozem"), share, stiffness, 25.0, 0.3,
                    po.Effects(own=own, strength_wave=wave, **given), medium=Constant(newtons))  # fmt: skip


def test_share_of_the_resistance_may_be_an_own_effect():
    """A constant resistance, and the same in two parts that both hold 1.3 times as much at rest."""
    whole = po.simulate(scene(1500.0), 1.5)
    parts = po.simulate(scene(1100.0, Shank(400.0, 1.3 * 400.0)), 1.5)
    assert np.ptp(whole.mode) == 1.0
    assert parts.mean_draft == pytest.approx(whole.mean_draft, rel=1e-9)
    np.testing.assert_allclose(parts.mount_force, whole.mount_force, rtol=0.0, atol=1e-7 * whole.peak_force)


def test_stronger_rest_makes_the_share_stick_for_longer():
    stuck = [float(np.mean(po.simulate(scene(1100.0, Shank(400.0, rest)), 1.5).mode == 1.0)) for rest in (400.0, 800.0)]
    assert stuck[1] > 1.2 * stuck[0] > 0.0


@pytest.mark.parametrize("wave", [None, WAVE], ids=["even", "wave"])
def test_motion_is_that_of_the_wide_reference(wave):
    own = scene(1000.0, Shank(300.0, 700.0, 40.0, 30.0), wave=wave, damping=50.0)
    run = po.simulate(own, 1.0, outputs=200)
    exact = reference_run(own, 1.0, outputs=200)
    assert run.error_estimate < 1e-8
    assert any(name == "move" for _, name in exact.events)
    assert run.mean_draft == pytest.approx(float(exact.run.mean_draft), rel=1e-8)
    force = np.asarray(exact.run.mount_force, dtype=float)
    np.testing.assert_allclose(run.mount_force, force, rtol=0.0, atol=1e-7 * run.peak_force)


def test_derivatives_go_through_the_moments_at_which_it_moves():
    x = ca.MX.sym("rest")
    run = po.simulate(scene(1000.0, Shank(300.0, x)), 1.0, outputs=4)
    both = ca.Function("f", [x], [run.mean_draft, ca.gradient(run.mean_draft, x)])
    step = 0.05
    difference = (float(both(600.0 + step)[0]) - float(both(600.0 - step)[0])) / (2.0 * step)
    # Differences of second order, over integrations to 1e-10.
    assert float(both(600.0)[1]) == pytest.approx(difference, rel=1e-4)


def test_effect_that_does_not_say_what_it_is_at_rest_is_refused():
    @dataclass(frozen=True)
    class Silent:
        value: float

        def force(self, travel, speed):
            del travel, speed
            return self.value

    with pytest.raises(po.InputError, match=r"Silent does not say what it is at rest.*at_rest\(travel\)"):
        scene(1000.0, Silent(3.0))
    assert scene(1000.0, Silent(3.0), contact="resisting", start="rest").effects.own


def test_rest_weaker_than_the_beginning_of_slip_is_refused():
    with pytest.raises(po.InputError, match=r"Shank holds a share at rest with 200 N.*with 300 N: at_rest must be"):
        po.simulate(scene(1000.0, Shank(300.0, 200.0)), 0.5)


def test_something_else_at_rest_is_refused():
    @dataclass(frozen=True)
    class Wrong(Shank):
        def at_rest(self, travel):
            return "much" if travel is not None else None

    with pytest.raises(po.InputError, match=r"Wrong\.at_rest returned 'much'"):
        po.simulate(scene(1000.0, Wrong(300.0, 400.0)), 0.5)
