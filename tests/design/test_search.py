"""The search for the global optimum: what is scanned, what is found, and that nothing better exists."""

import math
import types

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import differential_evolution, minimize_scalar

import plough_opt as po
from plough_opt.design import program as program_module
from plough_opt.design.program import Program
from plough_opt.design.search import SCAN_POINTS
from plough_opt.motion.integrators import integration
from plough_opt.motion.terms import Structure, parameters
from plough_opt.motion.timeline import Timeline


def _averages(scenes, duration, steps, outputs=1):
    """Return mean and RMS of the mount force and the largest deflection, by order 8 outside any design."""
    structure = Structure.of(scenes[0])
    solver = integration(structure, po.Accuracy("dop853", steps=steps), Timeline(outputs, steps))
    p = np.array([[float(parameters(scene)[name]) for name in solver.names] + [duration] for scene in scenes])
    states, means, variances = (np.asarray(result) for result in solver.function.map(len(scenes))(p.T))
    k0, static, drag, speed = (p[:, solver.names.index(name)] for name in ("stiffness", "static", "drag", "tow_speed"))
    first = static + drag * speed**2
    peak = first / k0 + np.max(states[0].reshape(len(scenes), outputs + 1), axis=1)
    if structure.damper:
        return first + means[1], np.sqrt(np.maximum(variances[1], 0.0)), peak
    return first + k0 * means[0], k0 * np.sqrt(np.maximum(variances[0], 0.0)), peak


def _on_other_mounts(scene, stiffness):
    return [po.Scene(scene.soil, scene.share, float(k), scene.mass, scene.tow_speed, scene.effects) for k in stiffness]


@pytest.fixture
def waves():
    """A scalar objective with four basins on [0, 1], the deepest at the left."""
    d = po.Design()
    x = d.variable("x", guess=0.9, lower=0.0, upper=1.0)
    y = d.variable("y", guess=0.9, lower=-1.0, upper=1.0)
    d.minimise(3.0 + x + ca.sin(20.0 * x) + (y - 0.25) ** 2)
    return d


def _basins():
    """Return the minima of x + sin(20 x): 20 cos(20 x) = -1 on the rising side."""
    first = (math.pi + math.acos(1.0 / 20.0)) / 20.0
    found = [first + 2.0 * math.pi * k / 20.0 for k in range(3)]
    return [x for x in found if x <= 1.0]


# --- what is scanned ----------------------------------------------------------------------------------------


def test_without_a_wave_nothing_is_scanned(waves):
    best = waves.solve()
    assert best.scans == ()
    assert len(best.local_optima) == 1


def test_a_run_without_a_wave_is_not_scanned(build_r1):
    best = build_r1(wavelength=None).design.solve()
    assert best.scans == ()
    assert best.name == "optimum"


def test_a_wave_over_a_fixed_stiffness_is_not_scanned(r1_scene, r1_wave):
    d = po.Design()
    height = d.variable("height", guess=0.25, lower=0.2, upper=0.4)
    d.minimise(po.simulate(r1_scene(height=height, strength_wave=r1_wave), 0.5, outputs=5).mean_draft / 1e3)
    assert d.solve().scans == ()


def test_a_stiffness_under_a_wave_is_scanned(r1):
    assert {scan.variable for scan in r1.best.scans} == {"stiffness"}


def test_a_stiffness_in_other_words_is_scanned_too(r1_scene, r1_wave):
    d = po.Design()
    d.variable("idle", guess=0.5, lower=0.0, upper=1.0)
    softness = d.variable("compliance", guess=2e-5, lower=2e-6, upper=2e-4, unit="m/N", log=True)
    run = po.simulate(r1_scene(stiffness=1.0 / softness, strength_wave=r1_wave), 0.5, outputs=5)
    d.minimise(run.force_rms / 1e3)
    assert {scan.variable for scan in d.solve().scans} == {"compliance"}


def test_a_local_search_scans_nothing(build_r1):
    best = build_r1().design.solve(search="local")
    assert best.scans == ()
    assert len(best.local_optima) == 1
    truths = [0.8250057092, 0.8383450230, 0.9164459115]
    assert any(best.objective == pytest.approx(truth, rel=1e-9) for truth in truths)


@pytest.mark.parametrize("search", ["x", ("x",), ["x"]])
def test_a_named_variable_is_scanned(waves, search):
    best = waves.solve(search=search)
    assert [scan.variable for scan in best.scans] == ["x"]
    found = [optimum.variables["x"] for optimum in best.local_optima]
    # The objective's bottom is flat to 1e-10 over 1e-6 at most.
    assert found[: len(_basins())] == pytest.approx(_basins(), abs=1e-7)
    assert [o.objective for o in best.local_optima] == sorted(o.objective for o in best.local_optima)
    assert best.name == "optimum 1"


def test_naming_the_stiffness_is_the_same_as_automatic(r1, build_r1):
    best = build_r1().design.solve(search=("stiffness",))
    assert [o.objective for o in best.local_optima] == [o.objective for o in r1.best.local_optima]


@pytest.mark.parametrize("search", ["stifness", ("stiffness", "hight")])
def test_an_unknown_name_is_refused_with_the_nearest(build_r1, search):
    nearest = "'stiffness'" if isinstance(search, str) else "'height'"
    with pytest.raises(po.InputError, match=f"is no variable of this design: did you mean {nearest}"):
        build_r1().design.solve(search=search)


def test_a_scan_records_what_it_tried(r1):
    scan = r1.best.scans[0]
    assert len(scan.values) == len(scan.objective) == SCAN_POINTS
    # Evenly in the logarithm between the bounds.
    assert scan.values == pytest.approx(np.geomspace(5e3, 5e5, SCAN_POINTS), rel=1e-12)
    assert (scan.values[0], scan.values[-1]) == (5e3, 5e5)
    seen = scan.objective[np.isfinite(scan.objective)]
    assert len(seen) > SCAN_POINTS // 2
    # All of the first scan are at the geometry of an optimum, which is that of all three.
    assert np.min(seen) >= r1.best.objective * (1.0 - 1e-8)


def test_what_a_scan_recorded_is_the_objective(r1):
    scan = r1.best.scans[0]
    scene = r1.best(r1.scene)
    mean, rms, _ = _averages(_on_other_mounts(scene, scan.values), 2.0, 1000)
    seen = np.isfinite(scan.objective)
    # Two fifths of the optimiser's steps, which are good for some 3e-9: 2.5^8 times that.
    assert scan.objective[seen] == pytest.approx((mean + rms)[seen] / 1e3, rel=2e-5)


def test_a_scan_leaves_out_what_violates_a_requirement(waves):
    x = waves._variables[0].symbol
    waves.require("right half", x, at_least=0.5)
    scan = waves.solve(search="x").scans[0]
    # A point is kept to 1e-6 beyond its limit.
    assert np.all(np.isnan(scan.objective[scan.values < 0.499]))
    assert np.all(np.isfinite(scan.objective[scan.values > 0.5]))


def test_progress_tells_of_the_scan_and_the_basins(build_r1):
    told = []
    build_r1().design.solve(progress=lambda stage, fraction: told.append((stage, fraction)))
    stages = [stage for stage, _ in told]
    assert stages[:2] == ["building the model", "solving from the guess"]
    assert "scanning stiffness" in stages
    assert any(stage.startswith("polishing basin 1 of") for stage in stages)
    assert stages[-1] == "checking"
    assert all(0.0 <= fraction <= 1.0 for _, fraction in told)


# --- that nothing better exists -----------------------------------------------------------------------------


def test_cotton_without_a_damper_has_several_optima(cotton):
    optima = cotton.best.local_optima
    assert len(optima) >= 4
    assert {optimum.name.split(" branch")[0] for optimum in optima} == {"soft", "stiff"}
    for optimum in optima:
        assert optimum.gap < 1e-8
        # Near resonance an undamped mount amplifies the integrators' 1e-12.
        assert optimum.error_estimate < 1e-10
        assert all(margin > -1e-9 for margin in optimum.margins.values())
    assert [o.objective for o in optima] == sorted(o.objective for o in optima)


def test_cotton_is_no_worse_than_a_fine_scan(cotton):
    scene = cotton.best(cotton.run.scene)

    def objective(stiffness):
        mean, rms, peak = _averages(_on_other_mounts(scene, stiffness), 2.0, 800, 400)
        return np.where(peak <= 0.12, (mean + rms) / 1e3, np.inf)

    stiffness = np.geomspace(1e4, 1e6, 1500)
    found = objective(stiffness)
    inner = found[1:-1]
    basins = 1 + np.flatnonzero((inner < found[:-2]) & (inner <= found[2:]))
    best = min(found[0], found[-1])
    for k in basins[np.argsort(found[basins])][:3]:
        polished = minimize_scalar(
            lambda log: float(objective([math.exp(log)])[0]),
            bounds=(math.log(stiffness[k - 1]), math.log(stiffness[k + 1])),
            method="bounded",
            options={"xatol": 1e-5},
        )
        best = min(best, polished.fun)
        # Every basin is an optimum that the search found as well; 1e-5 off, its bottom is 1e-8 too high.
        assert any(optimum.objective == pytest.approx(polished.fun, rel=1e-7) for optimum in cotton.best.local_optima)
    assert cotton.best.objective <= best * (1.0 + 1e-9)


@pytest.mark.slow
def test_no_better_design_of_r1_exists(r1, r1_soil):
    """Differential evolution over all three variables, with the requirements as penalties."""
    wave = po.StrengthWave(0.3, 0.6)

    def penalised(x):
        scenes, penalties = [], []
        for angle, height, log in np.atleast_2d(x.T):
            share = po.Wedge(float(angle), po.deg(15.0), float(height))
            cone = share.equivalent_cone()
            mass = 20.0 + cone.solid_mass(7850.0)
            scenes.append(po.Scene(r1_soil, share, math.exp(log), mass, 2.0, po.Effects(strength_wave=wave)))
            radius = float(po.loosened_radius(cone, r1_soil))
            penalties.append(max(0.0, 1.0 - radius / 0.12) + max(0.0, cone.half_angle / po.deg(15.0) - 1.0))
        mean, rms, _ = _averages(scenes, 2.0, 600)
        soft = np.maximum(0.0, mean / np.array([scene.stiffness for scene in scenes]) / 0.15 - 1.0)
        return (mean + rms) / 1e3 + 100.0 * (np.array(penalties) + soft)

    found = differential_evolution(
        penalised,
        [(po.deg(5.0), po.deg(60.0)), (0.1, 0.5), (math.log(5e3), math.log(5e5))],
        popsize=30,
        maxiter=100,
        tol=1e-10,
        seed=1,
        vectorized=True,
        updating="deferred",
        polish=False,
    )
    # The penalty is linear and steep, so no violation pays; the evolution ends within some 1e-7 of the optimum.
    assert found.fun >= r1.best.objective * (1.0 - 1e-9)
    assert found.fun == pytest.approx(r1.best.objective, rel=1e-4)


@pytest.mark.slow
def test_r1_is_no_worse_than_a_grid_over_its_geometry(r1, r1_soil):
    """Along the limit on the radius, which every good design touches, and over all stiffnesses."""
    wave, best = po.StrengthWave(0.3, 0.6), math.inf
    unit = po.loosened_radius(po.Cone(math.pi / 4, 1.0), r1_soil)
    for half_angle in po.deg(np.linspace(5.0, 15.0, 21)):
        for radius in (0.12, 0.125, 0.14):
            height = radius / (math.tan(half_angle) * unit)
            if not 0.1 <= height <= 0.5:
                continue
            cone = po.Cone(float(half_angle), height)
            mass = 20.0 + cone.solid_mass(7850.0)
            scenes = [
                po.Scene(r1_soil, cone, float(k), mass, 2.0, po.Effects(strength_wave=wave))
                for k in np.geomspace(5e3, 5e5, 300)
            ]
            mean, rms, _ = _averages(scenes, 2.0, 600)
            allowed = mean / np.array([scene.stiffness for scene in scenes]) <= 0.15
            if np.any(allowed):
                best = min(best, float(np.min(((mean + rms) / 1e3)[allowed])))
    assert best >= r1.best.objective * (1.0 - 1e-9)
    # The last line of the grid is the geometry of the optimum.
    assert best == pytest.approx(r1.best.objective, rel=1e-8)


# --- steps of integration ------------------------------------------------------------------------------------


def test_steps_are_refined_until_the_objective_is_right(monkeypatch, build_r1):
    builds = []
    build_nlp = program_module.build_nlp

    def counted(parts, y, p, steps):
        builds.append(steps[0])
        return build_nlp(parts, y, p, steps)

    monkeypatch.setattr(program_module, "build_nlp", counted)
    monkeypatch.setattr(program_module, "_PHASE_PER_STEP", 2.5)
    best = build_r1(wavelength=0.6).design.solve()
    # A build is followed by a rough one of two fifths of its steps.
    assert len(builds) > 2
    assert builds[::2] == sorted(builds[::2])
    assert builds[1::2] == [max(20, 2 * steps // 5) for steps in builds[::2]]
    assert all(optimum.gap <= 1e-8 for optimum in best.local_optima)
    assert best.objective == pytest.approx(0.8250057092, rel=2e-10)
    assert not any("not reached" in warning for warning in best.warnings)


def test_steps_that_stay_too_coarse_are_owned_up_to(monkeypatch, build_r1):
    monkeypatch.setattr(program_module, "_PHASE_PER_STEP", 40.0)
    best = build_r1().design.solve(search="local")
    assert best.gap > 1e-8
    assert any("was not reached" in warning for warning in best.warnings)


def test_a_looser_wanted_error_takes_no_refinement(monkeypatch, build_r1):
    builds = []
    build_nlp = program_module.build_nlp
    monkeypatch.setattr(
        program_module, "build_nlp", lambda *arguments: builds.append(arguments) or build_nlp(*arguments)
    )
    monkeypatch.setattr(program_module, "_PHASE_PER_STEP", 1.5)
    best = build_r1(accuracy=po.Accuracy(error=1e-3)).design.solve(search="local")
    assert len(builds) == 2  # the program, and a rough one of two fifths of its steps
    assert best.gap <= 1e-3


def test_coarse_steps_by_wish_are_reported_honestly(build_r1):
    coarse = build_r1(accuracy=po.Accuracy("dop853", steps=20), outputs=20, guess=(25.0, 0.25, 5e3))
    best = coarse.design.solve(search="local")
    scene = best(coarse.scene)
    mean, rms, _ = _averages([scene], 2.0, 1000)
    tight = float((mean + rms)[0]) / 1e3
    # The objective is of the motion itself, integrated tightly, and the gap tells what the optimiser saw instead.
    assert best.objective == pytest.approx(tight, rel=1e-9)
    mean, rms, _ = _averages([scene], 2.0, 20)
    seen = float((mean + rms)[0]) / 1e3
    assert best.gap > 1e-6
    assert best.gap == pytest.approx(abs(seen - tight) / tight, rel=1e-6)
    assert best.error_estimate < 1e-10


def test_a_goal_reached_exactly_is_no_lack_of_accuracy(r1_scene, r1_wave):
    d = po.Design()
    height = d.variable("height", guess=0.25, lower=0.2, upper=0.4, unit="m")
    run = po.simulate(r1_scene(height=height, strength_wave=r1_wave), 0.5, outputs=5)
    d.minimise((run.mean_draft / 600.0 - 1.0) ** 2)
    best = d.solve()
    # The objective is zero but for rounding: a difference relative to it means nothing.
    assert best(run.mean_draft) == pytest.approx(600.0, rel=1e-7)
    assert not any("not reached" in warning for warning in best.warnings)


def test_positions_without_a_value_count_as_infinitely_bad():
    d = po.Design()
    x = d.variable("x", guess=0.2, lower=0.0, upper=1.0)
    d.minimise(1.0 + x)
    d.require("limit", x, at_most=0.4)
    program = Program(d.declared)
    program.build(np.empty(0))
    own = program.rough.values

    def values(y, p):
        """Fail as an integrator does, for all positions at once."""
        if np.any(y == 0.9):
            raise RuntimeError
        f, g = own(y, p)
        return ca.DM(np.where(y == 0.1, np.nan, f.full())), ca.DM(np.where(y == 0.3, np.nan, g.full()))

    positions = np.array([[0.1], [0.2], [0.3], [0.6], [0.9]])
    plain, _ = program.merit(positions, np.empty(0))
    program.rough = types.SimpleNamespace(values=values)
    objective, violation = program.merit(positions, np.empty(0))
    wanted = [1.2, 1.6]
    assert objective[[1, 3]] / objective[1] == pytest.approx(np.array(wanted) / wanted[0], rel=1e-15)
    assert objective[[1, 3]] == pytest.approx(plain[[1, 3]], rel=0.0, abs=0.0)
    # The limit scales its requirement.
    assert violation[[1, 3]] == pytest.approx([0.0, 0.5], rel=1e-15)
    assert np.all(np.isinf([objective, violation])[:, [0, 2, 4]])
