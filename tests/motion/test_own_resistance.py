"""Resistances of a user's own class: equal to the built-in terms that they imitate, and with derivatives."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.expressions import Expression
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.terms import Structure


@dataclass(frozen=True)
class Shank:
    static: Expression
    viscous: Expression
    quadratic: Expression = 0.0

    def force(self, travel, speed):
        del travel
        return self.static + self.viscous * speed + self.quadratic * speed**2


@dataclass(frozen=True)
class Stones:
    force_per_metre: Expression

    def force(self, travel, speed):
        del speed
        return self.force_per_metre * travel


@dataclass(frozen=True)
class Silent:
    value: float


WAVE = po.StrengthWave(0.3, 0.2)


def scene(*own, **effects):
    share = po.Wedge(po.deg(30), po.deg(15), 0.25)
    return po.Scene(po.named_soil("serozem"), share, 5e4, 20.0, 2.0, po.Effects(own=own, **effects))


def test_own_quadratic_drag_is_the_inertial_drag():
    drag = scene().reaction.drag
    built_in = po.simulate(scene(strength_wave=WAVE), 1.0)
    own = po.simulate(scene(Shank(0.0, 0.0, drag), strength_wave=WAVE, inertial_drag=False), 1.0)
    np.testing.assert_allclose(own.mount_force, built_in.mount_force, rtol=1e-8)
    assert own.mean_draft == pytest.approx(built_in.mean_draft, rel=1e-9)
    assert own.force_rms == pytest.approx(built_in.force_rms, rel=1e-8)
    assert scene(Shank(0.0, 0.0, drag), inertial_drag=False).steady_resistance == pytest.approx(
        scene().steady_resistance, rel=1e-14
    )


def test_own_viscous_drag_damps_as_the_mounts_damper_does():
    own = po.simulate(scene(Shank(0.0, 400.0), strength_wave=WAVE, orbit="periodic"))
    damper = po.simulate(scene(strength_wave=WAVE, damping=400.0, orbit="periodic"))
    assert own.displacement_rms == pytest.approx(damper.displacement_rms, rel=1e-11)
    assert own.mean_draft == pytest.approx(damper.mean_draft + 400.0 * 2.0, rel=1e-11)


@pytest.mark.parametrize("effects", [{}, {"start": "rest"}, {"tow_ramp": 0.2}, {"motion": False}], ids=str)
def test_own_constant_resistance_is_added_to_the_draft(effects):
    more = po.simulate(scene(Shank(100.0, 0.0), **effects), 20.0 if effects else 1.0)
    less = po.simulate(scene(**effects), 20.0 if effects else 1.0)
    assert more.mean_draft - less.mean_draft == pytest.approx(100.0, rel=1e-3)


def test_resistance_along_the_path_is_that_of_the_travel():
    run = po.simulate(scene(Stones(50.0), motion=False), 1.0)
    np.testing.assert_allclose(run.mount_force - run.mount_force[0], 50.0 * run.travel, rtol=1e-10, atol=1e-8)


def test_several_add_up():
    both = po.simulate(scene(Shank(60.0, 0.0), Shank(40.0, 0.0)), 1.0)
    one = po.simulate(scene(Shank(100.0, 0.0)), 1.0)
    np.testing.assert_allclose(both.mount_force, one.mount_force, rtol=1e-12)


def test_without_one_nothing_of_it_is_in_the_equation():
    plain, with_one = (equation_of_motion(Structure.of(s)) for s in (scene(), scene(Shank(1.0, 2.0))))
    assert not any(name.startswith("own") for name in plain.names)
    assert [name for name in with_one.names if name.startswith("own")] == ["own_0_0", "own_0_1", "own_0_2"]
    assert plain.function.n_nodes() < with_one.function.n_nodes()


def test_derivatives_by_its_quantities():
    viscous = ca.MX.sym("viscous")
    run = po.simulate(scene(Shank(50.0, viscous), strength_wave=WAVE), 0.5, accuracy=po.Accuracy("dop853", steps=1000))
    hessian, gradient = ca.hessian(run.force_rms, viscous)
    found = [float(x) for x in ca.Function("f", [viscous], [run.force_rms, gradient, hessian])(300.0)]

    def rms(value):
        own = scene(Shank(50.0, value), strength_wave=WAVE)
        return po.simulate(own, 0.5, accuracy=po.Accuracy("dop853", steps=1000)).force_rms

    steps = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    values = np.array([rms(300.0 + 5.0 * step) for step in steps])
    # An expression rounds its RMS off below 1e-12 of the steady force.
    assert found[0] == pytest.approx(values[2], rel=1e-11)
    # Differences of fourth order over 5 N s/m.
    assert found[1] == pytest.approx(values @ [1, -8, 0, 8, -1] / 60.0, rel=1e-7)
    assert found[2] == pytest.approx(values @ [-1, 16, -30, 16, -1] / 300.0, rel=1e-4)


def test_a_design_varies_and_rebuilds_it():
    d = po.Design()
    viscous = d.variable("viscous", guess=400.0, lower=10.0, upper=2000.0, unit="N s/m")
    run = po.simulate(scene(Shank(0.0, viscous), strength_wave=WAVE), 1.0)
    d.minimise(run.mean_draft / 1e3 + 4.0 * run.force_rms / 1e3)
    best = d.solve(search="local")
    assert best(Shank(0.0, viscous)) == Shank(0.0, best.variables["viscous"])
    assert best.gap < 1e-8

    def objective(value):
        again = po.simulate(scene(Shank(0.0, value), strength_wave=WAVE), 1.0)
        return again.mean_draft / 1e3 + 4.0 * again.force_rms / 1e3

    own = best.variables["viscous"]
    assert objective(own) == pytest.approx(best.objective, rel=1e-8)
    assert objective(own) < min(objective(0.97 * own), objective(1.03 * own))


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"own": (3.0,)}, r"own effect 3\.0 must be a frozen dataclass with a method force"),
        ({"own": Shank(1.0, 0.0)}, "must be a tuple of effects"),
        ({"own": (Shank,)}, "must be a frozen dataclass with a method force"),
        ({"own": (Silent(1.0),)}, "must be a frozen dataclass with a method force"),
        ({"own": (Shank(1.0, 0.0),), "contact": po.StickSlip()}, "at rest or in a gap"),
    ],
)
def test_what_is_no_resistance_is_refused(effects, message):
    with pytest.raises(po.InputError, match=message):
        po.Effects(**effects)


def test_the_elastic_medium_refuses_it():
    with pytest.raises(po.InputError, match="own has no meaning in the elastic medium"):
        replace(scene(Shank(1.0, 0.0), motion=False), medium="elastic")


@dataclass(frozen=True)
class Looked:
    """A resistance by a table over the travel, or by whatever a field holds."""

    table: object

    def force(self, travel, speed):
        return self.table(travel) * speed


def _table(value):
    return ca.interpolant("table", "linear", [[-1.0, 3.0]], [value, value])


class Named:
    """What prints alike whatever it holds."""

    def __init__(self, value):
        self.value = value

    def __repr__(self):
        return "Named"


@pytest.mark.parametrize(
    "field",
    [
        _table(100.0),
        np.zeros(5000),
        np.array(3.0),
        Named(3.0),
        (1.0, [np.zeros(2)]),
        {"values": ca.DM([1.0, 2.0])},
        ca.MX.sym("column", 3),
    ],
    ids=lambda field: type(field).__name__,
)
def test_fields_that_may_print_alike_are_refused(field):
    with pytest.raises(po.InputError, match=r"own effect Looked holds a .*compared by their repr"):
        po.Effects(own=(Looked(field),))


def test_tables_behind_functions_are_told_apart():
    def built_in(viscous):
        return po.simulate(scene(Shank(0.0, viscous), start="towed"), 0.5, outputs=4).mean_draft

    def looked_up(value):
        table = _table(value)
        return po.simulate(scene(Looked(lambda travel: table(travel)), start="towed"), 0.5, outputs=4).mean_draft

    # The second is not taken for the first, nor one that is gone for one that has its place in memory.
    for value in (100.0, 500.0, 100.0):
        # Either run is told to 1e-8.
        assert looked_up(value) == pytest.approx(built_in(value), rel=1e-7)


@pytest.mark.parametrize("field", [3.0, 3, "text", True, None, (1.0, 2.0), {"a": 1.0}, ca.SX.sym("x"), np.float64(2.0)])
def test_fields_that_print_what_they_are_pass(field):
    assert po.Effects(own=(Looked(field),)).own[0].table is field
