"""Designs of orbits, of density profiles and of compiled runs, and the limits that laws imply."""

import dataclasses
import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.differences import check_derivatives
from helpers.scenes import SHARE, scene_of
from helpers.small_designs import design
from scipy.optimize import brentq

import plough_opt as po
from plough_opt.core.expressions import exp
from plough_opt.design.model.program import Program
from plough_opt.motion import compiled_steps
from plough_opt.soil import elastic

# --- designs of periodic orbits and their approximations, against brute force over the stiffness ---

CHOICES = {"linearised": "linearised", "periodic": "periodic", "harmonic balance": po.HarmonicBalance(3)}
LOWER, UPPER = 3e3, 4e5
LIMIT = 0.12


@pytest.fixture(scope="module")
def build(r1_scene):
    def scene(stiffness, choice, damping=400.0):
        wave = po.StrengthWave(0.3, 0.6)
        return r1_scene(stiffness=stiffness, strength_wave=wave, damping=damping, orbit=choice)

    def build(choice, *, limit=None, accuracy=None, damping=400.0, guess=5e4, lower=LOWER):
        d, stiffness = design(stiffness=(guess, lower, UPPER, "N/m", True))
        run = po.simulate(scene(stiffness, choice, damping), accuracy=accuracy, outputs=48)
        d.minimise(objective(run))
        if limit is not None:
            d.require("deflection", run.deflection, at_most=limit, unit="m")
        return SimpleNamespace(design=d, run=run)

    def numbers(stiffness, choice, damping=400.0):
        return po.simulate(scene(stiffness, choice, damping), outputs=48)

    build.numbers = numbers
    return build


def objective(run):
    return run.force_rms / 1e3 + run.mean_draft / 1e3


@pytest.fixture(scope="module")
def solved(build):
    """Return the function from a kind of orbit to the design with limited deflection and its optimum, solved once."""

    @functools.cache
    def solved(name):
        problem = build(CHOICES[name], limit=LIMIT)
        problem.best = problem.design.solve()
        return problem

    return solved


def branches(build, name):
    """Return the neighbourhoods of the local minima of a grid of stiffnesses that keep the limit, and their values."""
    stiffness = np.geomspace(LOWER, UPPER, 61)
    runs = [build.numbers(k, CHOICES[name]) for k in stiffness]
    wall = [np.inf, *(objective(run) if run.peak_deflection <= LIMIT else np.inf for run in runs), np.inf]
    lowest = [k for k in range(61) if wall[k] > wall[k + 1] < wall[k + 2]]
    return [(stiffness[max(k - 1, 0)], stiffness[min(k + 1, 60)], wall[k + 1]) for k in lowest]


@pytest.mark.parametrize("name", CHOICES)
def test_the_soft_and_the_stiff_branch_of_brute_force_are_found(solved, build, name):
    best = solved(name).best
    expected = branches(build, name)
    assert len(expected) == len(best.local_optima) == 2
    found = sorted(best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    for optimum, (low, high, coarse) in zip(found, expected, strict=True):
        assert low * (1 - 1e-6) <= optimum.variables["stiffness"] <= high * (1 + 1e-6)
        # No worse than the grid, and no better than a step of it can hide.
        assert coarse * 0.95 < optimum.objective <= coarse * (1 + 1e-7)
    assert best.objective == min(optimum.objective for optimum in found)


@pytest.mark.parametrize("name", CHOICES)
def test_optima_are_those_of_the_orbit_simulated_anew(solved, build, name):
    problem = solved(name)
    soft = min(problem.best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    assert soft.active == ("deflection",)
    assert build.numbers(soft.variables["stiffness"], CHOICES[name]).peak_deflection == pytest.approx(LIMIT, rel=1e-7)
    for optimum in problem.best.local_optima:
        run = build.numbers(optimum.variables["stiffness"], CHOICES[name])
        assert optimum.objective == pytest.approx(objective(run), rel=1e-10)
        assert optimum.gap < 1e-8
        assert optimum.error_estimate < 1e-9
    run = build.numbers(problem.best.variables["stiffness"], CHOICES[name])
    assert float(problem.best(problem.run.mean_draft)) == pytest.approx(run.mean_draft, rel=1e-10)
    assert float(problem.best(problem.run.force_rms)) == pytest.approx(run.force_rms, rel=1e-10)
    assert problem.best(problem.run.deflection).ravel() == pytest.approx(run.deflection, rel=1e-10)
    again = problem.best(problem.run)
    assert again.duration == pytest.approx(0.3, rel=1e-15)
    assert np.array_equal(again.mount_force, run.mount_force)
    assert again.error_estimate == run.error_estimate
    assert len(again.checks.floquet) == (2 if name == "periodic" else 0)


@pytest.mark.parametrize("name", CHOICES)
def test_designs_without_an_orbit_are_skipped(build, name):
    # Without damping, the search tries stiffnesses beside the resonance whose orbit is not found.
    best = build(CHOICES[name], damping=None, lower=2e3).design.solve()
    stiffness = sorted(optimum.variables["stiffness"] for optimum in best.local_optima)
    assert stiffness[0] == pytest.approx(2e3, rel=1e-6)
    assert stiffness[-1] == pytest.approx(UPPER, rel=1e-6)
    for optimum in best.local_optima:
        run = build.numbers(optimum.variables["stiffness"], CHOICES[name], damping=None)
        assert optimum.objective == pytest.approx(objective(run), rel=1e-8)


@pytest.mark.parametrize("name", ["linearised", "periodic"])
def test_thousands_of_orbits_under_two_waves_are_tried(r1_scene, name):
    waves = po.StrengthWave(0.2, 0.6), po.StrengthWave(0.2, 0.2, 1.0)

    def run_at(stiffness):
        scene = r1_scene(stiffness=stiffness, strength_wave=waves, damping=400.0, orbit=CHOICES[name])
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


# A periodic orbit is found by harmonic balance or, with the user's own steps, by shooting.
OWN = po.Accuracy("dop853", steps=96)
STEPS = [("linearised", None, 56), ("periodic", None, 12), ("periodic", OWN, None), ("harmonic balance", None, 56)]


@pytest.mark.parametrize(("name", "accuracy", "steps"), STEPS)
def test_derivatives_of_the_program_are_those_of_differences(build, name, accuracy, steps):
    declared = build(CHOICES[name], limit=LIMIT, accuracy=accuracy).design.declared
    program = Program.of(declared).with_steps(np.array([]))
    assert program.built.steps == [steps]
    for y in (0.2, 0.8):
        check_derivatives(program.nlp, np.array([y]), [], 1e-8, 1e-7, step=1e-3)


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
