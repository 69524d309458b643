"""The program of a design and its derivatives; designs of orbits, profiles and compiled runs; limits of theories."""

import dataclasses
import math
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers.differences import check_derivatives
from helpers.scenes import SHARE, scene_of
from helpers.small_designs import design
from scipy.optimize import brentq

import plough_opt as po
from plough_opt.core import compiler
from plough_opt.core.expressions import exp
from plough_opt.design.model.program import Program
from plough_opt.motion.solvers import compiled_steps
from plough_opt.soil import elastic


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
    p, nlp = np.array([q.value for q in program.declared.parameters]), program.built.nlp
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
def case_of(r1_soil):
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


def two_runs(case_of):
    case = case_of(FIXED)
    hard = po.Soil(1500.0, 0.82, 30e3, po.deg(32.0), 0.45, 1e4)
    effects = po.Effects(damping=300.0, inertial_drag=False)
    scene = po.Scene(hard, case.scene.share, case.k0, case.scene.mass, 1.5, effects)
    other = po.simulate(scene, 0.5, accuracy=po.Accuracy("dop853", steps=35), outputs=7)
    case.design.minimise((2.0 * case.run.mean_draft + other.mean_draft) / 1e3 + other.force_rms / 1e2)
    case.design.require("deflection", other.deflection, at_most=0.2)
    case.design.require("both", case.run.mean_deflection * other.mean_deflection, at_most=0.01)
    return case.design


def quasi_static(case_of):
    return usual(case_of(motion=False, effects={"strength_wave": po.StrengthWave(0.3, 0.6), "tow_ramp": 0.3}))


def parameters_alone(case_of):
    d, x = design(x=(0.5, 0.0, 1.0))
    scene = replace(case_of(FIXED).scene, share=po.Wedge(0.4, 0.2, 0.25), mass=25.0, stiffness=d.parameter("k0", 2e4))
    run = po.simulate(scene, 0.5, accuracy=FIXED, outputs=5)
    d.minimise(run.mean_draft / 1e3 * (1.0 + (x - 0.3) ** 2))
    d.require("deflection", x * run.deflection, at_most=1.0)
    return d


def speed_duration_and_wave(case_of):
    d, duration, speed, wavelength = design(duration=(0.8, 0.4, 1.2), speed=(2.0, 1.0, 3.0), wavelength=(0.6, 0.3, 0.9))
    damping = d.variable("damping", guess=200.0, lower=10.0, upper=1e3, log=True)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, wavelength), damping=damping)
    scene = po.Scene(case_of().scene.soil, po.Wedge(0.4, 0.2, 0.25), 2e4, 25.0, speed, effects)
    run = po.simulate(scene, duration, accuracy=FIXED, outputs=7)
    d.minimise(run.tow_power / 1e3 + run.displacement_rms * 10.0)
    d.require("force", run.mount_force, at_most=5e3)
    return d


# Designs with the number of their runs and of the rows of their requirements.
DESIGNS = {two_runs: (2, 8 + 1), quasi_static: (0, 6), parameters_alone: (1, 6), speed_duration_and_wave: (1, 8)}


@pytest.mark.parametrize("declare", DESIGNS)
def test_derivatives_are_those_of_casadi(case_of, declare):
    program = _built(declare(case_of))
    assert (len(program.exact.runs), len(program.owner)) == DESIGNS[declare]
    _check_against_ad(program, POINT[: len(program.declared.variables)])


def test_every_combination_of_effects(case_of, effects):
    case = case_of(FIXED, effects=effects)
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
def test_methods_of_casadi_agree_with_order_8(case_of, name):
    given, *allowed = METHODS[name]
    methods = (po.Accuracy(name, **given), po.Accuracy("dop853", steps=400))
    effects = {"strength_wave": po.StrengthWave(0.3, 0.6), "start": "rest", "rate_term": 0.05, "tow_ramp": 0.137}
    found = (_evaluations(_built(usual(case_of(method, effects))), POINT[:3]) for method in methods)
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
def test_a_run_of_a_run_is_refused(case_of, r1_soil, motion):
    case = case_of(FIXED)
    mass, effects = 20.0 + case.run.mean_draft / 1e3, replace(case.scene.effects, motion=motion)
    scene = po.Scene(r1_soil, case.scene.share, case.k0, mass, 2.0, effects)
    case.design.minimise(po.simulate(scene, 0.5, accuracy=FIXED if motion else None, outputs=5).mean_draft)
    with pytest.raises(po.InputError, match="cannot depend"):
        case.design.solve()


def test_a_run_inside_a_function_of_the_user(case_of):
    case = case_of(FIXED)
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


# --- designs of periodic orbits, against brute force over the stiffness ---

LOWER, UPPER = 3e3, 4e5
LIMIT = 0.12


@pytest.fixture(scope="module")
def build(r1_scene):
    def scene(stiffness, damping=400.0):
        wave = po.StrengthWave(0.3, 0.6)
        return r1_scene(stiffness=stiffness, strength_wave=wave, damping=damping, orbit="periodic")

    def build(*, limit=None, accuracy=None, damping=400.0, guess=5e4, lower=LOWER):
        d, stiffness = design(stiffness=(guess, lower, UPPER, "N/m", True))
        run = po.simulate(scene(stiffness, damping), accuracy=accuracy, outputs=48)
        d.minimise(objective(run))
        if limit is not None:
            d.require("deflection", run.deflection, at_most=limit, unit="m")
        return SimpleNamespace(design=d, run=run)

    def numbers(stiffness, damping=400.0):
        return po.simulate(scene(stiffness, damping), outputs=48)

    build.numbers = numbers
    return build


def objective(run):
    return run.force_rms / 1e3 + run.mean_draft / 1e3


@pytest.fixture(scope="module")
def solved(build):
    """Return the design with limited deflection and its optimum."""
    problem = build(limit=LIMIT)
    problem.best = problem.design.solve()
    return problem


def branches(build):
    """Return the neighbourhoods of the local minima of a grid of stiffnesses that keep the limit, and their values."""
    stiffness = np.geomspace(LOWER, UPPER, 61)
    runs = [build.numbers(k) for k in stiffness]
    wall = [np.inf, *(objective(run) if run.peak_deflection <= LIMIT else np.inf for run in runs), np.inf]
    lowest = [k for k in range(61) if wall[k] > wall[k + 1] < wall[k + 2]]
    return [(stiffness[max(k - 1, 0)], stiffness[min(k + 1, 60)], wall[k + 1]) for k in lowest]


def test_the_soft_and_the_stiff_branch_of_brute_force_are_found(solved, build):
    best = solved.best
    expected = branches(build)
    assert len(expected) == len(best.local_optima) == 2
    found = sorted(best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    for optimum, (low, high, coarse) in zip(found, expected, strict=True):
        assert low * (1 - 1e-6) <= optimum.variables["stiffness"] <= high * (1 + 1e-6)
        # No worse than the grid, and no better than a step of it can hide.
        assert coarse * 0.95 < optimum.objective <= coarse * (1 + 1e-7)
    assert best.objective == min(optimum.objective for optimum in found)


def test_optima_are_those_of_the_orbit_simulated_anew(solved, build):
    problem = solved
    soft = min(problem.best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    assert soft.active == ("deflection",)
    assert build.numbers(soft.variables["stiffness"]).peak_deflection == pytest.approx(LIMIT, rel=1e-7)
    for optimum in problem.best.local_optima:
        run = build.numbers(optimum.variables["stiffness"])
        assert optimum.objective == pytest.approx(objective(run), rel=1e-10)
        assert optimum.gap < 1e-8
        assert optimum.error_estimate < 1e-9
    run = build.numbers(problem.best.variables["stiffness"])
    assert float(problem.best(problem.run.mean_draft)) == pytest.approx(run.mean_draft, rel=1e-10)
    assert float(problem.best(problem.run.force_rms)) == pytest.approx(run.force_rms, rel=1e-10)
    assert problem.best(problem.run.deflection).ravel() == pytest.approx(run.deflection, rel=1e-10)
    again = problem.best(problem.run)
    assert again.duration == pytest.approx(0.3, rel=1e-15)
    assert np.array_equal(again.mount_force, run.mount_force)
    assert again.error_estimate == run.error_estimate
    assert len(again.checks.floquet) == 2


def test_designs_without_an_orbit_are_skipped(build):
    # Without damping, the search tries stiffnesses beside the resonance whose orbit is not found.
    best = build(damping=None, lower=2e3).design.solve()
    stiffness = sorted(optimum.variables["stiffness"] for optimum in best.local_optima)
    assert stiffness[0] == pytest.approx(2e3, rel=1e-6)
    assert stiffness[-1] == pytest.approx(UPPER, rel=1e-6)
    for optimum in best.local_optima:
        run = build.numbers(optimum.variables["stiffness"], damping=None)
        assert optimum.objective == pytest.approx(objective(run), rel=1e-8)


def test_thousands_of_orbits_under_two_waves_are_tried(r1_scene):
    waves = po.StrengthWave(0.2, 0.6), po.StrengthWave(0.2, 0.2, 1.0)

    def run_at(stiffness):
        scene = r1_scene(stiffness=stiffness, strength_wave=waves, damping=400.0, orbit="periodic")
        return po.simulate(scene, outputs=48)

    d, stiffness = design(stiffness=(5e4, LOWER, UPPER, "N/m", True))
    d.minimise(objective(run_at(stiffness)))
    best = d.solve()
    assert best.search.designs > 500
    assert not best.search.one_by_one
    # Of the sampled designs' orbits the search takes few steps.
    some = best.search.values[:: len(best.search.values) // 5, 0]
    tried = [objective(run_at(float(k))) for k in some]
    assert best.search.objective[:: len(best.search.values) // 5] == pytest.approx(tried, rel=1e-4)
    grid = [objective(run_at(float(k))) for k in np.geomspace(LOWER, UPPER, 40)]
    assert best.objective <= min(grid) * (1.0 + 1e-8)
    assert best.objective == pytest.approx(objective(run_at(best.variables["stiffness"])), rel=1e-8)


@pytest.mark.parametrize(("accuracy", "steps"), [(None, 56), (po.Accuracy("dop853", steps=96), None)])
def test_derivatives_of_the_program_are_those_of_differences(build, accuracy, steps):
    declared = build(limit=LIMIT, accuracy=accuracy).design.declared
    program = Program.of(declared).with_steps(np.array([]))
    assert program.built.steps == [steps]
    for y in (0.2, 0.8):
        check_derivatives(program.built.nlp, np.array([y]), [], 1e-8, 1e-7, step=1e-3)


# --- scenes and designs in soil with a density profile, whose parameters are fixed, given per solve, or variables ---

ORDER = 8


def density(r, core, width):
    """Return a density [kg/m^3] that is `core` at the wall and 1420 far out."""
    return 1420.0 + (core - 1420.0) * exp(-((r / width) ** 2))


def soil_of(r1_soil, core=1700.0, width=0.1, order=ORDER):
    return dataclasses.replace(r1_soil, density=1350.0).with_density_profile(density, core, width, order=order)


def test_a_scene_of_a_profile_moves_with_the_reaction_of_its_soil(r1_soil, r1_wave):
    soil = soil_of(r1_soil, order=16)
    scene = scene_of(soil, strength_wave=r1_wave)
    wanted = po.soil_reaction(SHARE.equivalent_cone(), soil)
    assert scene.reaction == wanted
    run = po.simulate(scene, 1.0, outputs=20)
    rigid = po.simulate(scene_of(soil, stiffness=1e12), 0.2, outputs=2)
    assert rigid.mean_draft == pytest.approx(wanted.static + 4.0 * wanted.drag, rel=1e-9)
    assert run.checks.error_estimate < 1e-8


@pytest.fixture(scope="module")
def sized(r1_soil):
    """Return a design of the smallest draft that loosens 0.1 m, in soil whose profile is a parameter."""
    d, height = design(height=(0.2, 0.1, 0.4, "m"))
    soil = soil_of(r1_soil, width=d.parameter("width", 0.1, unit="m"))
    cone = po.Cone(po.deg(12.0), height)
    d.minimise(po.soil_reaction(cone, soil).static / 1e3)
    d.require("loosened radius", po.loosened_radius(cone, soil), at_least=0.1, unit="m")
    return d, soil


@pytest.mark.parametrize("width", [None, 0.05, 0.2])
def test_a_profile_parameter_is_a_designs_parameter(sized, r1_soil, width):
    d, soil = sized
    best = d.solve(parameters={} if width is None else {"width": width})
    numbers = soil_of(r1_soil, width=width or 0.1)

    def short(height):
        return po.loosened_radius(po.Cone(po.deg(12.0), height), numbers) - 0.1

    # Draft and loosened radius both rise with the height, so the requirement decides.
    height = brentq(short, 0.1, 0.4, xtol=1e-15)
    assert best.variables["height"] == pytest.approx(height, rel=1e-9)
    wanted = po.soil_reaction(po.Cone(po.deg(12.0), height), numbers).static / 1e3
    assert best.objective == pytest.approx(wanted, rel=1e-9)
    assert best.active == ("loosened radius",)
    given = best(soil)
    assert given.density_profile.parameters == (1700.0, width or 0.1)
    assert type(given.density_profile.order) is int
    assert given.density_profile.order == ORDER
    assert po.loosened_radius(po.Cone(po.deg(12.0), height), given) == pytest.approx(0.1, rel=1e-12)


def test_bounds_without_a_front_are_refused_by_name(r1_soil):
    d, core = design(core=(1600.0, 1300.0, 1900.0, "kg/m^3"))
    d.minimise(po.simulate(scene_of(soil_of(r1_soil, core=core)), 0.5, outputs=10).mean_draft / 1e3)
    with pytest.raises(po.DomainError, match="at the lower bound of 'core': "):
        d.solve()


# --- many designs at once: machine code that reads operations, and CasADi without a compiler ---

SYMBOLS = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
(U, V, W), (A, B) = map(ca.vertsplit, SYMBOLS)
OPERATIONS = ca.vertcat(
    U + V, U - 2.0 * V, U * V, U / V, 1.0 / W, -U, U**2, 2.0 * U, ca.sqrt(U), ca.fabs(U - V), ca.sign(U - V),
    ca.exp(U), ca.log(U), ca.expm1(U), ca.log1p(U), ca.sin(U), ca.cos(U), ca.tan(U), ca.asin(U), ca.acos(U), ca.atan(U),
    ca.sinh(U), ca.cosh(U), ca.tanh(U), ca.asinh(U), ca.acosh(1.0 + U), ca.atanh(U), ca.erf(U), ca.atan2(U, V),
    ca.hypot(U, V), U**V, U**2.5, ca.fmin(U, V), ca.fmax(U, A), ca.floor(9.0 * U), ca.ceil(9.0 * U), U < V, U <= V,
    ca.eq(U, V), ca.ne(U, V), ca.logic_not(U < V), ca.logic_and(U < V, V < W), ca.logic_or(U < V, V < W),
    ca.if_else(U < V, W, ca.log(U - V)), B, 3.0,
)  # fmt: skip


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("count", [1, 16, 17, 50])
def test_each_operation_on_many_designs_is_what_casadi_finds_one_by_one(count, compiled, monkeypatch):
    if not compiled:
        monkeypatch.setattr(compiler, "_library", lambda: None)
    function = ca.Function("operations", [*SYMBOLS], [ca.densify(OPERATIONS), U + ca.log(V - W)])
    x, p = (np.random.default_rng(2).uniform(0.01, 0.99, (count, size)) for size in (3, 2))
    for number, found in enumerate(compiler.by_rows(function)(x, p)):
        alone = [np.asarray(function(*own)[number]).ravel() for own in zip(x, p, strict=True)]
        # The vector library is right to 4 units in the last place, and cancellation adds to that.
        assert found == pytest.approx(np.array(alone), rel=1e-14, abs=1e-15, nan_ok=True)


# --- compiled designs: the same optimum, and a warning if there is no compiler ---


@pytest.fixture
def small(build_r1):
    """R1 with short runs and the cohesion as a parameter."""
    return build_r1(duration=0.4, outputs=5, parameters=["cohesion"]).design


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "plough_opt"


def test_the_optimum_is_the_same(small, cache):
    plain, fast = small.solve(), small.solve(compiled=True)
    assert list(cache.glob("*.so"))
    # IPOPT stops at 1e-10 of the scaled optimality conditions, each time at a point of its own.
    assert fast.objective == pytest.approx(plain.objective, rel=1e-10)
    for own, other in zip(fast.local_optima, plain.local_optima, strict=True):
        assert own.objective == pytest.approx(other.objective, rel=1e-9)
    assert fast.warnings == plain.warnings
    # Parameters are not part of the compiled code.
    softer = {"cohesion": 10e3}
    again, expected = (small.solve(parameters=softer, compiled=how) for how in (True, False))
    assert again.objective == pytest.approx(expected.objective, rel=1e-10)
    assert again.objective < fast.objective


def test_a_design_is_interpreted_without_a_compiler(small, cache, monkeypatch):
    monkeypatch.setenv("CC", "no_such_compiler")
    monkeypatch.setenv("PATH", str(cache))
    monkeypatch.setattr(compiler, "_library", lambda: None)
    compiled_steps.compiled_steps.cache_clear()
    try:
        best = small.solve(compiled=True)
    finally:
        compiled_steps.compiled_steps.cache_clear()
    assert "no C compiler was found" in str(best.search)
    assert best.status == "solved"
    assert any("no C compiler was found" in warning for warning in best.warnings)
    compiled = small.solve()
    assert not any("no C compiler" in warning for warning in compiled.warnings)
    # Averages over the few steps of a search.
    assert best.search.objective[:50] == pytest.approx(compiled.search.objective[:50], rel=1e-3, nan_ok=True)


# --- limits implied by a theory: the speed in an elastic medium stays below that of shear waves ---

NAME = "elastic medium: speed over shear wave speed"
NODES = [(0.0, 0.0), (0.3, 0.03), (0.5, 0.0)]
SOIL = po.named_soil("serozem")
FASTEST = math.sqrt(SOIL.youngs_modulus / (2.0 * (1.0 + SOIL.poisson_ratio)) / SOIL.density)  # 52.8 m/s
# At the shear wave speed itself the fields' slopes are infinite, so a design ends a little below.
LAST = 0.9999

# Every result of the medium, at a point beside the body or on its face.
RESULTS = {
    "wedge stress": lambda soil, v: elastic.wedge_stress(0.1, 0.1, NODES, soil, v).xx,
    "wedge gradient": lambda soil, v: elastic.wedge_gradient(0.1, 0.1, NODES, soil, v).uy_y,
    "wedge displacement": lambda soil, v: elastic.wedge_displacement(0.1, 0.1, NODES, soil, v),
    "wedge pressure": lambda soil, v: elastic.wedge_pressure(0.1, NODES, soil, v),
    "wedge force": lambda soil, v: elastic.wedge_force(NODES, soil, v),
    "cone stress": lambda soil, v: elastic.cone_stress(0.1, 0.1, NODES, soil, v).rr,
    "cone displacement": lambda soil, v: elastic.cone_displacement(0.1, 0.1, NODES, soil, v).radial,
    "cone pressure": lambda soil, v: elastic.cone_pressure(0.1, NODES, soil, v),
    "cone force": lambda soil, v: elastic.cone_force(NODES, soil, v),
    "draft": lambda soil, v: po.simulate(scene_of(soil, medium="elastic", motion=False, tow_speed=v), 1.0).mean_draft,
}


@pytest.mark.parametrize(
    "result",
    [pytest.param(own, id=name, marks=[pytest.mark.slow] * (name == "draft")) for name, own in RESULTS.items()],
)
def test_fastest_design_stops_at_the_shear_waves_speed(result):
    d, v = design(speed=(20.0, 1.0, 100.0, "m/s"))
    d.minimise(-v / 50.0)
    d.require("the elastic result", result(SOIL, v), at_most=1e12)
    best = d.solve()
    # The limit is met, and reached to within IPOPT's barrier.
    assert best.variables["speed"] <= LAST * FASTEST
    assert best.variables["speed"] == pytest.approx(LAST * FASTEST, rel=1e-9)
    assert set(best.margins) == {"the elastic result", NAME}
    assert best.active == (NAME,)
    (limit,) = (limit for limit in best.limits if limit.name == NAME)
    assert 0.0 <= limit.margin <= 1e-9
    assert (limit.value, limit.limits, limit.unit) == (pytest.approx(LAST, rel=1e-9), "at most 0.9999", "")
    # A limit that is larger by 1 would raise the speed by the shear wave speed.
    assert limit.multiplier == pytest.approx(FASTEST / 50.0, rel=1e-6)


def test_several_results_imply_one_requirement_that_covers_them_all_in_every_solve():
    d, v = design(speed=(10.0, 1.0, 100.0, "m/s"))
    modulus = d.parameter("modulus", 1e6, unit="Pa")
    soft = po.Soil(1400.0, 0.8, 2e4, 0.5, 0.45, youngs_modulus=modulus, poisson_ratio=0.25)
    d.minimise(-v / 50.0)
    stress = elastic.wedge_stress(0.1, 0.1, NODES, SOIL, v)
    d.require("product", stress.xy * stress.zz, at_most=1e20)
    d.require("slower medium", elastic.wedge_pressure(0.1, NODES, soft, v), at_most=1e20)
    for value in (1e6, 4e5, 9e5, 1e6):
        best = d.solve(parameters={"modulus": value})
        assert [limit.name for limit in best.limits].count(NAME) == 1
        # rho V^2 = LAST^2 mu with mu = E/(2 (1 + nu))
        assert best.variables["speed"] == pytest.approx(LAST * math.sqrt(value / 2.5 / 1400.0), rel=1e-9)
        assert best.active == (NAME,)


CONFLICTING = {
    "where speed pays": lambda _v, p: -p / 1e6,
    "where speed costs": lambda v, p: v / 50.0 + 1e-9 * p,
    "with the result required": lambda v, _p: v / 50.0,
}


@pytest.mark.parametrize("objective", CONFLICTING.values(), ids=CONFLICTING)
def test_a_requirement_above_the_waves_speed_is_a_conflict(objective):
    d, v = design(speed=(20.0, 1.0, 100.0, "m/s"))
    pressure = elastic.wedge_pressure(0.1, NODES, SOIL, v)
    d.minimise(objective(v, pressure))
    d.require("pressure", pressure, at_most=1e12, unit="Pa")
    d.require("speed wanted", v, at_least=60.0, unit="m/s")
    with pytest.raises(po.InfeasibleDesign, match="in conflict with requirement 'elastic medium") as caught:
        d.solve()
    # The shortfall is assigned to the requirement; the theory's limit does not give way.
    assert caught.value.conflicts == {"speed wanted": pytest.approx(60.0 - LAST * FASTEST, rel=1e-6)}
    assert caught.value.blockers == [f"requirement '{NAME}' at most 0.9999"]


@pytest.mark.parametrize(("part", "shown"), [(0.5, False), (0.94, False), (0.97, True), (1.0, True)])
def test_a_limit_of_a_law_is_printed_if_it_is_near(part, shown):
    d, v = design(speed=(20.0, 1.0, 100.0, "m/s"))
    d.minimise((v / FASTEST - part) ** 2 + 1e-20 * elastic.wedge_pressure(0.1, NODES, SOIL, v))
    best = d.solve()
    assert best.variables["speed"] == pytest.approx(min(part, LAST) * FASTEST, rel=1e-6)
    assert (NAME in str(best)) == shown
    assert NAME in best.margins


@pytest.mark.parametrize("lower", [1.0, 60.0])
def test_a_start_above_the_waves_speed_is_refused_by_the_limits_name(lower):
    d, v = design(speed=(70.0, lower, 90.0, "m/s"))
    d.minimise(elastic.wedge_pressure(0.1, NODES, SOIL, v) / 1e6)
    with pytest.raises(po.InputError) as caught:
        d.solve(search="near")
    assert f"(speed = 70 m/s) '{NAME}' is {70.0 / FASTEST:.6g}" in str(caught.value)
    assert "only up to 0.9999" in str(caught.value)
