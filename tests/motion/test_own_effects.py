"""Resistances of a user's own class: equal to built-in terms, under stick and slip, with derivatives, in designs."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.expressions import Expression
from plough_opt.studies.accuracy.reference import reference_run

WAVE = po.StrengthWave(0.3, 0.2)
SLIP = po.StickSlip(1.3)


@dataclass(frozen=True)
class Shank:
    static: Expression = 0.0
    viscous: Expression = 0.0
    quadratic: Expression = 0.0
    per_metre: Expression = 0.0

    def force(self, travel, speed):
        return self.static + self.per_metre * travel + self.viscous * speed + self.quadratic * speed**2


@dataclass(frozen=True)
class Resting(Shank):
    """The same, with a different resistance at rest."""

    resting: Expression = 0.0

    def at_rest(self, travel):
        return self.resting + self.per_metre * travel


@dataclass(frozen=True)
class Silent:
    value: float


@dataclass(frozen=True)
class Constant(po.ResistanceLaw):
    """Static resistance that is independent of the share."""

    newtons: Expression
    label = "a constant resistance"

    def reaction(self, at):
        del at
        return po.SoilReaction(static=self.newtons)


def scene(*own, **effects):
    share = po.Wedge(po.deg(30), po.deg(15), 0.25)
    return po.Scene(po.named_soil("serozem"), share, 5e4, 20.0, 2.0, po.Effects(own=own, **effects))


def sticking(newtons, *own, **effects):
    """Return a scene with a constant resistance and own ones under stick and slip."""
    given = {"contact": SLIP, "start": "rest"} | effects
    return replace(scene(), stiffness=2e4, mass=25.0, tow_speed=0.3, medium=Constant(newtons),
                   effects=po.Effects(own=own, **given))  # fmt: skip


# --- equal to built-in terms ---


def test_own_quadratic_drag_is_the_inertial_drag():
    drag = scene().reaction.drag
    built_in = po.simulate(scene(strength_wave=WAVE), 1.0)
    own = po.simulate(scene(Shank(quadratic=drag), strength_wave=WAVE, inertial_drag=False), 1.0)
    np.testing.assert_allclose(own.mount_force, built_in.mount_force, rtol=1e-8)
    assert own.mean_draft == pytest.approx(built_in.mean_draft, rel=1e-9)
    assert own.force_rms == pytest.approx(built_in.force_rms, rel=1e-8)
    steady = scene(Shank(quadratic=drag), inertial_drag=False).steady_resistance
    assert steady == pytest.approx(scene().steady_resistance, rel=1e-14)


def test_own_viscous_drag_damps_as_the_mounts_damper_does():
    own = po.simulate(scene(Shank(viscous=400.0), strength_wave=WAVE, orbit="periodic"))
    damper = po.simulate(scene(strength_wave=WAVE, damping=400.0, orbit="periodic"))
    assert own.displacement_rms == pytest.approx(damper.displacement_rms, rel=1e-11)
    assert own.mean_draft == pytest.approx(damper.mean_draft + 400.0 * 2.0, rel=1e-11)


@pytest.mark.parametrize("effects", [{}, {"motion": False}], ids=str)
def test_own_resistances_are_added_to_the_draft(effects):
    more = po.simulate(scene(Shank(60.0), Shank(40.0), **effects), 1.0)
    assert more.mean_draft - po.simulate(scene(**effects), 1.0).mean_draft == pytest.approx(100.0, rel=1e-10)


# --- under stick and slip ---


def test_part_of_the_resistance_may_be_an_own_effect():
    """A constant resistance acts like two parts of it that both hold 1.3 times as much at rest."""
    whole = po.simulate(sticking(1500.0), 1.5)
    parts = po.simulate(sticking(1100.0, Resting(400.0, resting=1.3 * 400.0)), 1.5)
    assert np.ptp(whole.mode) == 1.0
    assert parts.mean_draft == pytest.approx(whole.mean_draft, rel=1e-9)
    np.testing.assert_allclose(parts.mount_force, whole.mount_force, rtol=0.0, atol=1e-7 * whole.peak_force)


@pytest.mark.parametrize("wave", [None, po.StrengthWave(0.8, 0.3)], ids=["even", "wave"])
def test_motion_is_that_of_the_wide_reference(wave):
    own = sticking(1000.0, Resting(300.0, 30.0, 0.0, 40.0, 700.0), strength_wave=wave, damping=50.0)
    run = po.simulate(own, 1.0, outputs=200)
    exact = reference_run(own, 1.0, outputs=200)
    assert run.error_estimate < 1e-8
    assert any(name == "move" for _, name in exact.events)
    assert run.mean_draft == pytest.approx(float(exact.run.mean_draft), rel=1e-8)
    force = np.asarray(exact.run.mount_force, dtype=float)
    np.testing.assert_allclose(run.mount_force, force, rtol=0.0, atol=1e-7 * run.peak_force)


def test_derivatives_go_through_the_moments_at_which_it_moves():
    x = ca.MX.sym("rest")
    run = po.simulate(sticking(1000.0, Resting(300.0, resting=x)), 1.0, outputs=4)
    both = ca.Function("f", [x], [run.mean_draft, ca.gradient(run.mean_draft, x)])
    step = 0.05
    difference = (float(both(600.0 + step)[0]) - float(both(600.0 - step)[0])) / (2.0 * step)
    # Central differences of integrations to 1e-10.
    assert float(both(600.0)[1]) == pytest.approx(difference, rel=1e-4)


@dataclass(frozen=True)
class Wrong(Shank):
    def at_rest(self, travel):
        return "much" if travel is not None else None


@pytest.mark.parametrize(
    ("own", "words"),
    [
        (Shank(3.0), r"Shank does not define its force at rest.*at_rest\(travel\)"),
        (Resting(300.0, resting=200.0), r"Resting holds a share at rest with 200 N.*with 300 N: at_rest must be"),
        (Wrong(300.0), r"Wrong\.at_rest returned 'much'"),
    ],
    ids=["silent", "weaker than slip", "no number"],
)
def test_a_valid_force_at_rest_is_required(own, words):
    with pytest.raises(po.InputError, match=words):
        po.simulate(sticking(1000.0, own), 0.5)


# --- derivatives and designs ---


def test_a_design_varies_and_rebuilds_it():
    d = po.Design()
    viscous = d.variable("viscous", guess=400.0, lower=10.0, upper=2000.0, unit="N s/m")

    def objective(value):
        run = po.simulate(scene(Shank(0.0, value), strength_wave=WAVE), 1.0)
        return run.mean_draft / 1e3 + 4.0 * run.force_rms / 1e3

    d.minimise(objective(viscous))
    best = d.solve(search="local")
    own = best.variables["viscous"]
    assert best(Shank(0.0, viscous)) == Shank(0.0, own)
    assert best.gap < 1e-8
    assert objective(own) == pytest.approx(best.objective, rel=1e-8)
    assert objective(own) < min(objective(0.97 * own), objective(1.03 * own))


# --- refusals ---


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ((3.0,), r"own effect 3\.0 must be a frozen dataclass with a method force"),
        (Shank(1.0), "must be a tuple of effects"),
        ((Shank,), "must be a frozen dataclass with a method force"),
        ((Silent(1.0),), "must be a frozen dataclass with a method force"),
    ],
)
def test_invalid_own_effects_are_refused(own, message):
    with pytest.raises(po.InputError, match=message):
        po.Effects(own=own)


def test_the_elastic_medium_refuses_own_effects():
    with pytest.raises(po.InputError, match="own has no meaning in the elastic medium"):
        replace(scene(Shank(1.0), motion=False), medium="elastic")


@dataclass(frozen=True)
class Looked:
    """Resistance that calls its field, such as a lookup table."""

    table: object

    def force(self, travel, speed):
        return self.table(travel) * speed


def _table(value):
    return ca.interpolant("table", "linear", [[-1.0, 3.0]], [value, value])


class Named:
    """Object whose repr does not depend on its value."""

    def __init__(self, value):
        self.value = value

    def __repr__(self):
        return "Named"


@pytest.mark.parametrize(
    "field",
    [_table(100.0), np.zeros(5000), Named(3.0), (1.0, [np.zeros(2)]), {"x": ca.DM([1.0, 2.0])}, ca.MX.sym("x", 3)],
    ids=lambda field: type(field).__name__,
)
def test_fields_without_a_distinct_repr_are_refused(field):
    with pytest.raises(po.InputError, match=r"own effect Looked holds a .*compared by their repr"):
        po.Effects(own=(Looked(field),))


@pytest.mark.parametrize("field", [3.0, "text", None, (1.0, 2.0), {"a": 1.0}, ca.SX.sym("x"), np.float64(2.0)])
def test_fields_with_a_complete_repr_are_accepted(field):
    assert po.Effects(own=(Looked(field),)).own[0].table is field


def test_tables_behind_functions_are_kept_apart():
    # Different tables must not share a graph, even if a new one has the memory address of a deleted one.
    for value in (100.0, 500.0, 100.0):
        table = _table(value)
        drafts = [
            po.simulate(scene(own, start="towed"), 0.5, outputs=4).mean_draft
            for own in (Shank(viscous=value), Looked(lambda travel, table=table: table(travel)))
        ]
        # Each run has an error of up to 1e-8.
        assert drafts[1] == pytest.approx(drafts[0], rel=1e-7)
