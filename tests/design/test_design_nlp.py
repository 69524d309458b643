"""The nonlinear program of a design: values and first and second derivatives, against independent references."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design.model.program import Program


def _whole_by_ad(program):
    """Return the program's objective, requirements and derivatives by CasADi from the undivided expression."""
    y, p = ca.MX.sym("y", len(program.declared.variables)), ca.MX.sym("p", len(program.declared.parameters))
    f, g = program.scaled(y, p)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
    hessian, _ = ca.hessian(lam_f * f + ca.dot(lam_g, g), y)
    results = [f, ca.densify(g), ca.gradient(f, y), ca.jacobian(g, y), hessian]
    return ca.Function("whole", [y, p, lam_f, lam_g], results)


def _symmetric(upper):
    upper = np.asarray(upper)
    assert np.all(np.tril(upper, -1) == 0.0)
    return upper + np.triu(upper, 1).T


def _close(found, wanted, relative):
    """Compare arrays by their largest entry."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert found.shape == wanted.shape
    assert np.all(np.isfinite(found))
    error = np.max(np.abs(found - wanted), initial=0.0)
    assert error <= relative * max(np.max(np.abs(wanted), initial=0.0), 1e-8)


def _evaluations(program, y, *, by_ad=False):
    """Return objective, requirements, gradient, Jacobian and Hessian at a point, with a multiplier for every row."""
    p, nlp = np.array([q.value for q in program.declared.parameters]), program.nlp
    multipliers = 0.7, np.cos(1.0 + np.arange(len(program.owner)))
    if by_ad:
        return _whole_by_ad(program)(y, p, *multipliers)
    found = nlp.slopes(y, p)
    for own, alone in zip(found, nlp.values(y, p), strict=False):
        # The two graphs sum the same averages in different order.
        assert np.asarray(own) == pytest.approx(np.asarray(alone), rel=1e-12, abs=1e-13)
    return *found, _symmetric(nlp.hess_lag(y, p, *multipliers))


def _check(found, wanted, values, first, second):
    for own, other, relative in zip(found, wanted, (values, values, first, first, second), strict=True):
        _close(own, other, relative)


def _check_against_ad(program, y, first=1e-9, second=1e-8):
    _check(_evaluations(program, y), _evaluations(program, y, by_ad=True), 1e-11, first, second)


def _built(d):
    """Return the program of a design, built at its declared parameters."""
    return Program.of(d.declared).with_steps(np.array([p.value for p in d.declared.parameters]))


@pytest.fixture
def small(r1_soil):
    """Build a design around a share of R1 with few steps, its requirements and objective left to the caller."""

    def build(accuracy=None, effects=None, motion=True):
        sizes = {"angle": (0.5, 0.2, 0.9, "rad"), "height": (0.25, 0.10, 0.40, "m")}
        d, angle, height, k0 = design(**sizes, stiffness=(2e4, 5e3, 1e5, "N/m", True))
        share = po.Wedge(angle, po.deg(15.0), height)
        keywords = {"strength_wave": po.StrengthWave(0.3, 0.6)} if effects is None else effects
        mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
        scene = po.Scene(r1_soil, share, k0, mass, 2.0, po.Effects(motion=motion, **keywords))
        run = po.simulate(scene, 0.8, accuracy=accuracy, outputs=5)
        return SimpleNamespace(design=d, angle=angle, height=height, k0=k0, scene=scene, run=run)

    return build


FIXED = po.Accuracy("dop853", steps=60)
POINT = np.array([0.61, 0.43, 0.37, 0.52])


def usual(case):
    """Declare the usual objective and a limit on the path of a case's run."""
    case.design.minimise(case.run.mean_draft / 1e3 + case.run.force_rms / 1e3)
    case.design.require("deflection", case.run.deflection, at_most=0.2)
    return case.design


def two_runs(small):
    case = small(FIXED)
    hard = po.Soil(1500.0, 0.82, 30e3, po.deg(32.0), 0.45, 1e4)
    effects = po.Effects(damping=300.0, inertial_drag=False)
    scene = po.Scene(hard, case.scene.share, case.k0, case.scene.mass, 1.5, effects)
    other = po.simulate(scene, 0.5, accuracy=po.Accuracy("dop853", steps=35), outputs=7)
    case.design.minimise((2.0 * case.run.mean_draft + other.mean_draft) / 1e3 + other.force_rms / 1e2)
    case.design.require("deflection", other.deflection, at_most=0.2)
    case.design.require("both", case.run.mean_deflection * other.mean_deflection, at_most=0.01)
    return case.design


def quasi_static(small):
    return usual(small(motion=False, effects={"strength_wave": po.StrengthWave(0.3, 0.6), "tow_ramp": 0.3}))


def parameters_alone(small):
    d, x = design(x=(0.5, 0.0, 1.0))
    scene = replace(small(FIXED).scene, share=po.Wedge(0.4, 0.2, 0.25), mass=25.0, stiffness=d.parameter("k0", 2e4))
    run = po.simulate(scene, 0.5, accuracy=FIXED, outputs=5)
    d.minimise(run.mean_draft / 1e3 * (1.0 + (x - 0.3) ** 2))
    d.require("deflection", x * run.deflection, at_most=1.0)
    return d


def speed_duration_and_wave(small):
    d, duration, speed, wavelength = design(duration=(0.8, 0.4, 1.2), speed=(2.0, 1.0, 3.0), wavelength=(0.6, 0.3, 0.9))
    damping = d.variable("damping", guess=200.0, lower=10.0, upper=1e3, log=True)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, wavelength), damping=damping)
    scene = po.Scene(small().scene.soil, po.Wedge(0.4, 0.2, 0.25), 2e4, 25.0, speed, effects)
    run = po.simulate(scene, duration, accuracy=FIXED, outputs=7)
    d.minimise(run.tow_power / 1e3 + run.displacement_rms * 10.0)
    d.require("force", run.mount_force, at_most=5e3)
    return d


# Designs with the number of their runs and of the rows of their requirements.
DESIGNS = {two_runs: (2, 8 + 1), quasi_static: (0, 6), parameters_alone: (1, 6), speed_duration_and_wave: (1, 8)}


@pytest.mark.parametrize("declare", DESIGNS)
def test_derivatives_are_those_of_casadi(small, declare):
    program = _built(declare(small))
    assert (len(program.exact.runs), len(program.owner)) == DESIGNS[declare]
    _check_against_ad(program, POINT[: len(program.declared.variables)])


def test_every_combination_of_effects(small, effects):
    case = small(FIXED, effects=effects)
    case.design.minimise(case.run.mean_draft / 1e3 + case.run.force_rms / 1e3 + case.run.tow_power / 1e3)
    for name in ("deflection", "speed", "travel", "mount_force", "soil_resistance"):
        case.design.require(name, getattr(case.run, name), at_most=1e4)
    case.design.require("sway", case.run.displacement_rms, at_most=0.2)
    program = _built(case.design)
    # Without a wave nothing oscillates: an RMS of 1e-10 of the force has rounding for a derivative.
    _check_against_ad(program, POINT[:3], first=1e-8, second=1e-7)


METHODS = {
    # Sensitivities are integrated to the tolerance too, of their own size: each order loses a digit or two.
    "cvodes": ({"tolerance": 1e-10}, 1e-7, 1e-6, 1e-5),
    # These two differentiate the discrete solution, the steps of the adaptive method frozen.
    "erk": ({"tolerance": 1e-10}, 1e-8, 1e-7, 1e-6),
    "rosenbrock": ({"tolerance": 1e-10}, 1e-8, 1e-7, 1e-6),
    # Order 4 with 0.03 rad in a step; collocation has order 3 at the end of a ramp.
    "rk": ({"steps": 2000}, 1e-7, 1e-6, 1e-5),
    "collocation": ({"steps": 800}, 1e-7, 1e-6, 1e-5),
}


@pytest.mark.parametrize("name", METHODS)
def test_methods_of_casadi_agree_with_order_8(small, name):
    given, *allowed = METHODS[name]
    methods = (po.Accuracy(name, **given), po.Accuracy("dop853", steps=400))
    effects = {"strength_wave": po.StrengthWave(0.3, 0.6), "start": "rest", "rate_term": 0.05, "tow_ramp": 0.137}
    found = (_evaluations(_built(usual(small(method, effects))), POINT[:3]) for method in methods)
    _check(*found, *allowed)


@pytest.fixture
def mount(r1_scene, r1_wave):
    """Build a design of the mount alone: a soft spring shakes, a hard one costs."""

    def build(accuracy):
        d, k0 = design(stiffness=(1e5, 6e4, 5e5, "N/m", True))
        scene = r1_scene(stiffness=k0, strength_wave=r1_wave, damping=300.0)
        run = po.simulate(scene, 0.5, accuracy=accuracy, outputs=5)
        d.minimise(run.force_rms / 1e3 + k0 / 1e6)
        return d

    return build


@pytest.mark.parametrize("method", ["cvodes", "erk", "rosenbrock", "dop853", "collocation", "rk"])
def test_a_design_by_any_method_is_solved_to_the_same_optimum(mount, method):
    reference = mount(None).solve(search="local")
    # With five outputs one step for each would be far too coarse for the methods of fixed steps.
    adaptive = method in ("cvodes", "erk", "rosenbrock")
    own = mount(po.Accuracy(method, tolerance=1e-9) if adaptive else po.Accuracy(method)).solve(search="local")
    # The optimum lies at a bound, or forgives the square of the error in the gradient.
    assert own.objective == pytest.approx(reference.objective, rel=1e-9)
    assert own.variables["stiffness"] == pytest.approx(reference.variables["stiffness"], rel=1e-4)
    # The gap is that of the method itself.
    assert own.gap < 1e-6


def test_a_design_by_idas_is_refused(mount):
    with pytest.raises(po.InputError, match="'idas' has no second derivatives"):
        mount(po.Accuracy("idas", tolerance=1e-8)).solve(search="local")


# --- runs in expressions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [True, False])
def test_a_run_of_a_run_is_refused(small, r1_soil, motion):
    case = small(FIXED)
    mass, effects = 20.0 + case.run.mean_draft / 1e3, replace(case.scene.effects, motion=motion)
    scene = po.Scene(r1_soil, case.scene.share, case.k0, mass, 2.0, effects)
    case.design.minimise(po.simulate(scene, 0.5, accuracy=FIXED if motion else None, outputs=5).mean_draft)
    with pytest.raises(po.InputError, match="cannot depend"):
        case.design.solve()


def test_a_run_inside_a_function_of_the_user(small):
    case = small(FIXED)
    inputs = [case.angle, case.height, case.k0]
    case.design.minimise(ca.Function("draft", inputs, [case.run.mean_draft / 1e3 + case.run.force_rms / 1e3])(*inputs))
    program = _built(case.design)
    assert len(program.exact.runs) == 1
    _check_against_ad(program, POINT[:3])


# --- automatic accuracy -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_motions_that_need_too_many_steps_are_skipped_or_refused(r1_scene, r1_wave):
    # 2e5 rad/s for a second at the upper bound, at 0.8 rad a step.
    d, k0 = design(stiffness=(1e4, 5e3, 1e12, "N/m", True))
    d.minimise(po.simulate(r1_scene(stiffness=k0, strength_wave=r1_wave), 1.0, outputs=5).mean_draft / 1e3)
    best = d.solve()
    assert np.mean(np.isnan(best.search.objective)) > 0.1
    assert any("could not be evaluated" in warning and "too fast" in warning for warning in best.warnings)
    fast, k0 = design(stiffness=(7e11, 5e11, 1e12, "N/m", True))
    fast.minimise(po.simulate(r1_scene(stiffness=k0, strength_wave=r1_wave), 1.0, outputs=5).mean_draft / 1e3)
    with pytest.raises(po.PloughError, match="shorten"):
        fast.solve()
