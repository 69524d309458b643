"""Resistances of a user's own class: equal to built-in terms, stiff, under stick and slip, in designs."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from helpers import event_splitting
from helpers.differences import order_4
from helpers.linear_motion import oscillation
from helpers.scenes import Own, Shank, scene_of

import plough_opt as po
from plough_opt.core.expressions import Expression, exp, where
from plough_opt.motion import simulation
from plough_opt.studies.accuracy.reference import reference_run

WAVE = po.StrengthWave(0.3, 0.2)


@dataclass(frozen=True)
class Resting(Shank):
    """The same, with a different resistance at rest."""

    resting: Expression = 0.0

    def at_rest(self, travel):
        return self.resting + self.per_metre * travel


@dataclass(frozen=True)
class Constant(po.ResistanceLaw):
    """Static resistance that is independent of the share."""

    newtons: Expression
    label = "a constant resistance"

    def reaction(self, at):
        del at
        return po.SoilReaction(static=self.newtons)


def sticking(newtons, *own, **effects):
    """Return a scene with a constant resistance and own ones under stick and slip."""
    slips = {"contact": po.StickSlip(1.3), "start": "rest", "own": own}
    return scene_of(stiffness=2e4, mass=25.0, tow_speed=0.3, medium=Constant(newtons), **slips | effects)


# --- equal to built-in terms ---


def test_own_viscous_drag_damps_as_the_mounts_damper_does():
    own = po.simulate(scene_of(own=(Shank(viscous=400.0),), strength_wave=WAVE, orbit="periodic"))
    damper = po.simulate(scene_of(strength_wave=WAVE, damping=400.0, orbit="periodic"))
    assert own.displacement_rms == pytest.approx(damper.displacement_rms, rel=1e-11)
    assert own.mean_draft == pytest.approx(damper.mean_draft + 400.0 * 2.0, rel=1e-11)
    assert own.scene.steady_resistance == pytest.approx(damper.scene.steady_resistance + 400.0 * 2.0, rel=1e-14)


@pytest.mark.parametrize("motion", [True, False])
def test_own_resistances_are_added_to_the_draft(motion):
    more = po.simulate(scene_of(own=(Shank(60), Shank(40.0)), motion=motion), 1.0)
    assert more.mean_draft - po.simulate(scene_of(motion=motion), 1.0).mean_draft == pytest.approx(100.0, rel=1e-10)


@pytest.mark.parametrize(
    ("damping", "ground", "method"),
    [*((5e4, 0.0, method) for method in ("auto", "erk", "rosenbrock", "cvodes")), (0.0, 1e7, "auto")],
)
def test_a_stiff_own_resistance(damping, ground, method):
    scene = scene_of(inertial_drag=False, start="rest", own=(Shank(viscous=damping, per_metre=ground),))
    run = po.simulate(scene, 0.2, accuracy=po.Accuracy(method))
    exact, _ = oscillation(scene, run.time, damping, ground)
    # The default error, which a named method's tolerance of 1e-10 reaches too.
    np.testing.assert_allclose(run.deflection, exact, rtol=0.0, atol=1e-8 * np.max(np.abs(exact)))
    assert run.error_estimate < 1e-8


def test_a_named_method_checks_itself_where_steps_of_order_8_are_too_long():
    bed = Own(lambda travel, speed: where(travel > 0.3, 1e5, 0.0) * speed)
    runs = [po.simulate(scene_of(own=(bed,)), 0.3, accuracy=po.Accuracy(method)) for method in ("erk", "rosenbrock")]
    assert runs[0].mean_draft == pytest.approx(runs[1].mean_draft, rel=1e-9)
    assert all(abs(run.mean_draft / runs[1].mean_draft - 1.0) <= run.error_estimate < 1e-7 for run in runs)


# --- jumps, and forces that run away ---


@pytest.mark.parametrize("start", ["rest", "equilibrium"])
@pytest.mark.parametrize("at", ["speed", "travel"])
def test_a_jump_leaves_equal_steps_for_a_method_that_finds_it(start, at, monkeypatch):
    jump = {"speed": lambda travel, speed: 0.0 * travel - 500.0 * where(speed > 1.9, 1.0, 0.5),
            "travel": lambda travel, speed: 500.0 * where(travel > 0.5, 1.0, 0.5) + 0.0 * speed}[at]  # fmt: skip
    scene, counted, integrate = scene_of(own=(Own(jump),), start=start, strength_wave=WAVE), [], simulation.integrate

    def count(case, accuracy, *given, **named):
        counted.append(accuracy.steps or 0)
        return integrate(case, accuracy, *given, **named)

    monkeypatch.setattr(simulation, "integrate", count)
    run = po.simulate(scene, 1.0)
    switch = {"speed": lambda _, __, speed: speed - 1.9, "travel": lambda _, travel, __: travel - 0.5}[at]
    size = -500.0 if at == "speed" else 500.0
    mean, rms = event_splitting.averages(scene, lambda _, __, sides: size * (0.5 + 0.5 * sides[0]), [switch], 1.0)
    error = max(abs(run.mean_draft - mean), abs(run.force_rms - rms)) / mean
    assert error <= run.error_estimate <= 1e-6
    # The law of order 8 would ask for millions.
    assert sum(counted) < 20_000


@pytest.mark.parametrize("seed", range(12))
def test_a_force_that_runs_away_is_named_or_the_run_ends(seed):
    random = np.random.default_rng(seed)
    size, power = 10.0 ** random.uniform(-1.0, 5.0) * random.choice([-1.0, 1.0]), int(random.integers(2, 6))
    law = [lambda _, v: size * v**power, lambda _, v: size * v * exp(0.3 * power * v)][seed % 2]
    effects = {"start": random.choice(["rest", "towed"]), "contact": ["resisting", po.Smooth(0.1)][random.integers(2)]}
    scene = scene_of(stiffness=10.0 ** random.uniform(4.0, 6.0), own=(Own(law),), **effects)
    try:
        run = po.simulate(scene, random.uniform(0.1, 0.5), outputs=20)
    except po.IntegrationError as error:
        words = str(error)
    else:
        words = "beyond t = own effect Own"
        assert np.isfinite(run.mount_force).all()
        assert run.error_estimate <= 1e-8 or run.checks.notes
    assert "own effect Own" in words
    assert "beyond t = " in words


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
    # Differences of integrations to 1e-10.
    slope = order_4(lambda rest: float(both(rest)[0]), 600.0, 0.05)
    assert float(both(600.0)[1]) == pytest.approx(slope, rel=1e-4)


# --- designs and tables ---


@dataclass(frozen=True)
class Looked(Shank):
    """The same, times what a function says at the travel, such as a lookup table."""

    table: object = lambda travel: ca.interpolant("ones", "linear", [[-1.0, 3.0]], [1.0, 1.0])(travel)

    def force(self, travel, speed):
        return self.table(travel) * super().force(travel, speed)


@pytest.mark.parametrize("kind", [Shank, Looked])
def test_a_design_varies_and_rebuilds_it(kind):
    d = po.Design()
    viscous = d.variable("viscous", guess=400.0, lower=10.0, upper=2000.0, unit="N s/m")

    def objective(value):
        run = po.simulate(scene_of(own=(kind(0.0, value),), strength_wave=WAVE), 1.0)
        return run.mean_draft / 1e3 + 4.0 * run.force_rms / 1e3

    d.minimise(objective(viscous))
    best = d.solve(search="local")
    own = best.variables["viscous"]
    assert best(kind(0.0, viscous)) == kind(0.0, own)
    assert best.gap < 1e-8
    assert objective(own) == pytest.approx(best.objective, rel=1e-8)
    assert objective(own) < min(objective(0.97 * own), objective(1.03 * own))


@pytest.mark.parametrize("compiled", [False, True])
def test_tables_behind_functions_are_kept_apart(compiled):
    # Different tables must not share a graph, even if a new one has the memory address of a deleted one.
    for value in (100.0, 500.0, 100.0):
        table = ca.interpolant("table", "linear", [[-1.0, 3.0]], [value, value])
        drafts = [
            po.simulate(scene_of(own=(own,), start="towed"), 0.5, outputs=4, compiled=compiled).mean_draft
            for own in (Shank(viscous=value), Looked(viscous=1.0, table=lambda travel, table=table: table(travel)))
        ]
        # Each run has an error of up to 1e-8.
        assert drafts[1] == pytest.approx(drafts[0], rel=1e-7)
