"""Steps and their derivatives, compiled or added by name; no error of a run exceeds its estimate."""

import collections
import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from helpers import wild_scenes
from helpers.scenes import assert_alike, results_of, scene_of
from scipy.integrate import DOP853 as SCIPYS

import plough_opt as po
from plough_opt.design.model.program import error_of_derivatives
from plough_opt.motion.equation import Structure, equation_of, parameters
from plough_opt.motion.methods import DOP853, METHODS, Tableau
from plough_opt.motion.solvers.checks import difference
from plough_opt.motion.solvers.compiled_steps import compiled_steps
from plough_opt.motion.solvers.derivatives import jets
from plough_opt.motion.solvers.steps import Timeline

# --- derivatives through events and ramps: their forms, the methods that find a ramp's end, and ramps of no time ---

WAVE = po.StrengthWave(0.5, 0.4)
SUDDEN = {
    "motion": {"damping": 400.0},
    "stick and slip": {"damping": 400.0, "start": "rest", "contact": po.StickSlip(1.2)},
    "entry": {"damping": 400.0, "start": "towed", "entry": True},
    "quasi-static": {"motion": False, "strength_wave": WAVE},
}


@pytest.mark.parametrize("case", ["stick and slip", "entry"])
def test_second_derivatives_through_events_are_those_of_a_gradient(case):
    t = ca.MX.sym("t", 2)
    effects = SUDDEN[case] | {"strength_wave": WAVE, "tow_ramp": 0.2 * (1.0 + t[1])}
    draft = po.simulate(scene_of(stiffness=5e4 * (1.0 + t[0]), tow_speed=1.5, **effects), 0.5, outputs=4).mean_draft
    gradient, units = ca.gradient(draft, t), ca.horzsplit(ca.DM.eye(2))
    ways = [
        ca.hessian(draft, t)[0],
        ca.jacobian(gradient, t),
        ca.horzcat(*(ca.jtimes(gradient, t, unit) for unit in units)),
        ca.horzcat(*(ca.jtimes(gradient, t, unit, True) for unit in units)),
    ]
    found = [np.asarray(part) for part in ca.Function("ways", [t], ways)(0.0)]
    for other in found[1:]:
        # The same steps, added up in another order.
        assert other == pytest.approx(found[0], rel=0, abs=1e-9 * np.max(np.abs(found[0])))
    # The limit that the documentation states.
    with pytest.raises(
        RuntimeError, match=r"those_of_a_gradient_as_by_casadi_hessian:\n.*\nEvent support not implemented"
    ):
        ca.jacobian(ca.jacobian(draft, t), t)


@pytest.mark.parametrize("method", ["erk", "rosenbrock"])
def test_named_adaptive_methods_find_the_end_of_a_ramp(method):
    x = ca.MX.sym("x")
    scene = scene_of(damping=400.0, tow_ramp=x, start="rest")
    runs = [po.simulate(scene, 1.0, accuracy=a, outputs=7) for a in (po.Accuracy(method, tolerance=1e-11), None)]
    results = [(run.mean_draft, ca.gradient(run.mean_draft, x), ca.hessian(run.mean_draft, x)[0]) for run in runs]
    found = [float(part) for part in ca.Function("found", [x], [*results[0], *results[1]])(0.301)]
    # Without a step that ends there the slope has an error of 1e-5.
    for value, truth, allowed in zip(found[:3], found[3:], (1e-10, 1e-7, 1e-5), strict=True):
        assert value == pytest.approx(truth, rel=allowed)


# --- runs in machine code give the results of interpreted ones, for every combination of effects ---


def test_every_combination_of_effects(r1_scene, effects):
    scene = r1_scene(**effects)
    found, expected = (po.simulate(scene, 0.7, outputs=60, compiled=compiled) for compiled in (True, False))
    # The operations are the same, in the same order and not fused, so on most machines every bit agrees. A compiler's
    # own sine may round its last digit differently, over a few hundred steps.
    assert_alike(results_of(found), expected, 1e-12)
    # The difference of two runs that agree to eight digits has about eight digits left.
    assert found.error_estimate == pytest.approx(expected.error_estimate, rel=1e-3, abs=1e-12)
    assert (found.accuracy, found.warnings) == (expected.accuracy, expected.warnings)


def test_threads_do_not_share_states(r1_scene, r1_wave):
    scenes = [r1_scene(stiffness=k0, strength_wave=r1_wave) for k0 in np.linspace(3e4, 6e4, 12)]
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda scene: po.simulate(scene, 1.0, compiled=True), scenes))
    for run, scene in zip(runs, scenes, strict=True):
        assert np.array_equal(run.mount_force, po.simulate(scene, 1.0, compiled=True).mount_force)


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_a_run_is_interpreted_with_a_warning(r1_scene, r1_wave):
    scene = r1_scene(strength_wave=r1_wave)
    expected = po.simulate(scene, 1.0)
    compiled_steps.cache_clear()
    try:
        found = po.simulate(scene, 1.0, compiled=True)
    finally:
        compiled_steps.cache_clear()
    assert np.array_equal(found.mount_force, expected.mount_force)
    assert any("no C compiler was found" in warning for warning in found.warnings)


@dataclass(frozen=True)
class Tabled:
    """Own resistance that looks a force up in a table, which has no form for a vector register."""

    def force(self, travel, speed):
        return ca.interpolant("table", "linear", [[-1.0, 3.0]], [10.0, 50.0])(travel) + 0.0 * speed


NOT_COMPILED = [
    ({"own": (Tabled(),)}, "own effects"),
    ({"motion": False}, "a quasi-static run"),
    ({"contact": po.StickSlip(1.2)}, "a run by 'erk'"),
    ({"strength_wave": po.StrengthWave(0.3, 0.6), "orbit": "periodic"}, "a periodic orbit"),
]


@pytest.mark.parametrize(("effects", "what"), NOT_COMPILED)
def test_runs_that_cannot_be_compiled_carry_a_note(r1_scene, effects, what):
    scene, duration = r1_scene(**effects), None if "orbit" in effects else 0.2
    found, expected = (po.simulate(scene, duration, outputs=20, compiled=compiled) for compiled in (True, False))
    (note,) = set(found.warnings) - set(expected.warnings)
    assert note.startswith(f"compiled=True has no effect on {what}")
    assert found.mean_draft == expected.mean_draft


# --- a Butcher tableau added by name: its order, derivatives, default steps, and refusals ---

THREE_EIGHTHS = Tableau(
    4, nodes=(0.0, 1 / 3, 2 / 3, 1.0), weights=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
    stages=((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0)),
)  # fmt: skip
HEUN = Tableau(3, nodes=(0.0, 1 / 3, 2 / 3), weights=(0.25, 0.0, 0.75), stages=((), (1 / 3,), (0.0, 2 / 3)))
OWN = {"three_eighths": THREE_EIGHTHS, "heun_3": HEUN}


@pytest.fixture(autouse=True)
def _added(monkeypatch):
    for name, tableau in OWN.items():
        monkeypatch.setitem(METHODS, name, tableau)


def simulated(accuracy, **changes):
    effects = {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0}
    return po.simulate(scene_of(mass=25.0, **effects | changes), 0.5, accuracy=accuracy, outputs=4)


# Method -> order (of Radau IIA with three stages 2 s - 1), and steps at which the leading term of its error rules.
ORDERS = {"three_eighths": (4, 160), "heun_3": (3, 160), "dop853": (8, 40), "collocation": (5, 40), "rk": (4, 160)}


# The ramp ends a third of a step from the end of a step, where one more ends.
@pytest.mark.parametrize("effects", [{}, {"tow_ramp": 0.5 / 3.0, "rate_term": 0.05}], ids=["wave", "ramp"])
@pytest.mark.parametrize("name", ORDERS)
def test_error_falls_by_the_order(name, effects):
    order, steps = ORDERS[name]

    def results(count, method=name):
        run = simulated(po.Accuracy(method, steps=count), **effects)
        return np.array([run.deflection[-1] / run.mean_deflection, run.mean_draft / 1e3, run.force_rms / 1e3])

    exact = results(2000, "dop853")
    coarse, fine = (np.linalg.norm(results(count) - exact) for count in (steps, 2 * steps))
    # The next term of the error changes the order by about an eighth at these steps, and a ramp divides them unevenly.
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("name", ["three_eighths", "rk", "collocation"])
def test_default_steps_suit_the_order_and_the_estimate_is_honest(name):
    exact, run = simulated(po.Accuracy(error=1e-11)).mean_draft, simulated(po.Accuracy(name))
    assert abs(run.mean_draft - exact) <= run.error_estimate * exact < 1e-7 * exact


INVALID_TABLEAUS = [
    ({"weights": (0.25, 0.75)}, "must be explicit"),
    ({"stages": ((), (1 / 3,), (0.0, 2 / 3, 0.0))}, "must be explicit"),
    ({"order": 0}, "must be explicit"),
    ({"weights": (0.5, 0.0, 0.5)}, r"integrate t\^1 with an error of -1.7e-01"),
    ({"stages": ((), (1 / 3,), (0.1, 2 / 3))}, "row .* adds up to .* node 0.66"),
]


@pytest.mark.parametrize(("change", "message"), INVALID_TABLEAUS)
def test_invalid_tableaus_are_refused(change, message):
    with pytest.raises(po.InputError, match=message):
        replace(HEUN, **change)


# --- the error of derivatives, as designs and components estimate and report it ---

DURATION = 0.5


def scene(stiffness=5e4, **effects):
    return scene_of(stiffness=stiffness, mass=45.0, **{"start": "rest", "damping": 300.0} | effects)


def design(accuracy, **effects):
    d = po.Design()
    stiffness = d.variable("stiffness", guess=5e4, lower=3e4, upper=1e5, unit="N/m", log=True)
    run = po.simulate(scene(stiffness, **effects), DURATION, accuracy=accuracy, outputs=4)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e2)
    return d


def about_derivatives(warnings):
    return [text for text in warnings if "derivatives" in text]


def test_a_design_with_too_few_steps_warns():
    best = design(po.Accuracy("dop853", steps=12)).solve(search="near")
    (text,) = about_derivatives(best.warnings)
    assert "the wanted error 1.0e-06 of the motion's derivatives was not reached: it is" in text


@pytest.mark.parametrize("effects", [{}, {"tow_ramp": 0.2}], ids=["rest", "ramp"])
def test_a_design_takes_as_many_steps_as_derivatives_need(effects):
    steps = []
    for wanted in (1e-2, 1e-6, 1e-10):
        d = design(po.Accuracy(derivatives=wanted), **effects)
        best = d.solve(search="near")
        assert about_derivatives(best.warnings) == []
        program = best.solved.program
        y = np.array([program.declared.variables[0].scaled(best.variables["stiffness"])])
        assert error_of_derivatives(program, y, np.zeros(0)) < wanted
        steps += program.built.steps
    assert steps[0] <= steps[1] < steps[2]


def test_derivatives_by_machine_code_are_those_of_interpreted_steps():
    structure, p = Structure.of(scene()), parameters(scene())
    equation = equation_of(structure)
    given, names = equation.column(p, DURATION), equation.names
    varying = tuple(names.index(name) for name in ("stiffness", "static"))
    made = [jets(equation, Timeline(1, 48, aligned=True), varying, 1, compiled=own) for own in (False, True)]
    interpreted, compiled = (np.asarray(one(given)) for one in made)
    # The compiler may contract products and sums: rounding over 48 steps.
    np.testing.assert_allclose(compiled, interpreted, rtol=1e-12)


# Estimated error above which a reference is rejected, such as that of forces that are only the rounding of a travel.
DOUBTFUL = 1e-10


def by(seed, *accuracies):
    """Return a sampled scene's runs by each accuracy with their errors, or a text if there are none."""
    drawn = wild_scenes.sampled(seed, speed_term=True)
    if drawn is None:
        return "not drawn"
    scene, duration, outputs = drawn
    try:
        runs = [po.simulate(scene, duration, accuracy=accuracy, outputs=outputs) for accuracy in accuracies]
    except po.IntegrationError:
        return "refused"
    if not runs[0].mount_force.any() and not runs[0].soil_resistance.any():
        return "nothing pulls"
    try:
        truth = wild_scenes.truth(scene, duration, outputs)
    except AssertionError:  # SciPy's integrator gives up
        return "no truth"
    doubtful = max(truth.errors.values()) > DOUBTFUL
    return "no truth" if doubtful else [(run, wild_scenes.errors(run, truth)) for run in runs]


@pytest.mark.parametrize("count", [18, pytest.param(1600, marks=pytest.mark.slow)])
def test_no_result_is_further_from_the_truth_than_estimated_or_wanted(count):
    kinds, ratios, beyond, missed = collections.Counter(), [], [], []
    for seed in range(count):
        wanted = 10.0 ** np.random.default_rng(seed).uniform(-10.0, -3.0)
        found = by(seed, None, po.Accuracy(error=wanted))
        if isinstance(found, str):
            kinds[found] += 1
            continue
        for run, errors in found:
            kinds["runs"] += 1
            worst = max(errors, key=errors.get)
            error = errors[worst]
            if error > 0.0:
                ratios.append(run.error_estimate / error)
            if error > run.error_estimate:
                beyond.append((seed, worst, error, run.error_estimate))
            assert error <= 3.0 * run.error_estimate, (seed, worst, error, run.error_estimate)
            assert error <= 1e-6 or run.checks.notes or run is found[1][0], (seed, worst, error)
        if max(error, run.error_estimate) > wanted:
            missed.append((seed, wanted, error, run.error_estimate))
            assert run.checks.notes, missed[-1]
    assert kinds["runs"] > 1.2 * count
    # If only rounding pulls, or a share nearly stops, the reference reports that it is inaccurate.
    assert kinds["no truth"] < 0.06 * count
    assert len(beyond) <= 0.01 * kinds["runs"], beyond
    assert len(missed) <= 0.01 * kinds["runs"], missed
    assert np.median(ratios) <= 30.0


@pytest.fixture(scope="module")
def gapped():
    """Return a run with slip, stick and gaps after a ramp."""
    effects = {"contact": po.StickSlip(), "strength_wave": po.StrengthWave(0.9, 0.1), "tow_ramp": 0.1, "start": "rest"}
    run = po.simulate(scene_of(mass=45.0, tow_speed=1.5, **effects), 0.6, outputs=60)
    assert set(run.mode) == {0.0, 1.0, 2.0}
    return run


@pytest.mark.parametrize("name", ["mount_force", "soil_resistance", "deflection", "speed", "travel", "opening"])
def test_every_array_counts_on_its_own_scale(gapped, name):
    values, mode = getattr(gapped, name).copy(), gapped.mode.copy()
    size = max(np.max(np.abs(values)), np.max(np.abs(gapped.deflection)) if name in ("travel", "opening") else 0.0)
    values[30] += 1e-3 * size
    mode[30] += 1.0
    assert difference(gapped, dataclasses.replace(gapped, **{name: values})) == pytest.approx(1e-3, rel=1e-9)
    # Speed and soil resistance jump from mode to mode.
    found = difference(gapped, dataclasses.replace(gapped, **{name: values}, mode=mode))
    assert found == (0.0 if name in ("soil_resistance", "speed") else pytest.approx(1e-3, rel=1e-9))
    values[3] = np.nan
    assert difference(gapped, dataclasses.replace(gapped, **{name: values})) == np.inf


# Scenes whose forces are far below the soil's strength.
HARD = po.Soil(1900.0, 0.69, 1.5e6, 0.066, 0.93, 700.0)
FIRM = dataclasses.replace(HARD, density_ratio=0.8, cohesion=2e5, friction_angle=0.3, tool_friction=0.5)
STUCK = {"start": "towed", "contact": po.StickSlip()}
ENTERS = scene_of(mass=45.0, tow_speed=1.5, start="towed", entry=True)
WEAK = {
    "sticks at once": (scene_of(HARD, po.Wedge(1.24, 0.52, 0.35), 1565.0, 0.27, 1.3, damping=120.0, **STUCK), 0.033),
    "sticks, no added mass": (
        scene_of(FIRM, po.Wedge(1.0, 0.26, 0.35), 2e3, 5.0, 0.1, damping=500.0, added_mass=False, **STUCK), 0.5
    ),
    "touches the soil": (ENTERS, 1e-4),
    "begins to enter": (ENTERS, 1e-3),
}  # fmt: skip


@pytest.mark.parametrize("method", ["auto", "erk", "rosenbrock"])
@pytest.mark.parametrize("name", WEAK)
def test_weak_forces_keep_their_digits(name, method):
    scene, duration = WEAK[name]
    run, truth = po.simulate(scene, duration, accuracy=po.Accuracy(method)), wild_scenes.truth(scene, duration)
    errors = wild_scenes.errors(run, truth)
    assert max(errors.values()) <= run.error_estimate <= 3e-8, errors


# Seeds of `wild_scenes` -> quantity with the largest error. A ramp ends shortly before the end or soon after the start,
# or a share has entered by a millionth of its height.
FOUND = {421: "speed", 453: "soil_resistance", 1282: "force_rms", 1571: "force_rms"}


@pytest.mark.parametrize("seed", FOUND)
def test_the_estimate_holds_where_a_ramp_ends_late_or_an_entry_has_just_begun(seed):
    ((run, errors),) = by(seed, None)
    assert errors[FOUND[seed]] <= max(errors.values()) <= run.error_estimate < 1e-8


def test_the_resistance_of_a_share_that_just_entered_has_all_its_digits():
    # 1e-4 of the height is in the soil, so the resistance is 1e-8 of the full one: F0 (L/h)^2, times the wave.
    wave = po.StrengthWave(0.5, 0.1)
    scene = scene_of(tow_speed=1.5, start="towed", entry=True, strength_wave=wave, added_mass=False)
    run = po.simulate(scene, 2e-5, outputs=10)
    depth = run.travel / scene.cone.height
    strength = scene.reaction.static * (1.0 + 0.5 * np.sin(2.0 * np.pi * run.travel / 0.1))
    expected = depth**2 * (strength + scene.reaction.drag * run.speed**2)
    assert 0.9e-4 < depth[-1] < 1.3e-4
    assert run.soil_resistance == pytest.approx(expected, rel=8 * np.finfo(float).eps, abs=0.0)


def test_few_outputs_let_no_event_pass(gapped):
    few = po.simulate(gapped.scene, gapped.duration, outputs=3)
    assert few.mount_force == pytest.approx(gapped.mount_force[::20], rel=0, abs=1e-8 * gapped.peak_force)
    assert len(few.time) == len(few.mode) == len(few.opening) == 4


@pytest.mark.parametrize(("contact", "duration"), [("resisting", 4.0), (po.StickSlip(2.0), 12.0)], ids=str)
def test_a_motion_too_sensitive_to_be_predicted_carries_a_warning(contact, duration):
    # Each wave stops the undamped share, and deviations grow about tenfold from one to the next.
    effects = {"strength_wave": po.StrengthWave(0.95, 0.1), "inertial_drag": False, "contact": contact}
    scene = scene_of(stiffness=2e4, tow_speed=1.0, start="rest", **effects)
    run = po.simulate(scene, duration, outputs=50)
    (warning,) = [text for text in run.warnings if "too sensitive to be predicted" in text]
    assert f"better than {run.error_estimate:.1e}" in warning
    assert run.error_estimate > 1e-6
    beside = dataclasses.replace(scene, stiffness=scene.stiffness * (1.0 + 1e-12))
    assert difference(run, po.simulate(beside, duration, outputs=50)) > 1e-8


# --- failure ---


def test_failure_names_scene_time_and_cause_and_its_advice_works(r1_scene):
    scene = r1_scene(stiffness=5e5, start="rest")
    with pytest.raises(po.IntegrationError) as caught:
        po.simulate(scene, 50.0, accuracy=po.Accuracy("dop853", steps=4), outputs=2)
    message = str(caught.value)
    scene_in_words = ("half angle 8.93 deg and height 0.25 m", "500 kN/m", "at 2 m/s")
    for words in (*scene_in_words, "4 steps are too few for"):
        assert words in message
    steps = int(message.rsplit("use steps=", 1)[1])
    run = po.simulate(scene, 50.0, accuracy=po.Accuracy("dop853", steps=steps), outputs=2)
    # Phase errors accumulate over the oscillations, so the error is above that of a single one.
    assert run.error_estimate < 1e-6
    with pytest.raises(po.IntegrationError, match="steps are too few"):
        po.simulate(scene, 50.0, accuracy=po.Accuracy("rk", steps=4), outputs=2)


def test_coefficients_of_order_8_are_scipys():
    assert (DOP853.nodes, DOP853.weights) == (tuple(SCIPYS.C), tuple(SCIPYS.B))
    assert DOP853.stages == tuple(tuple(row[:k]) for k, row in enumerate(SCIPYS.A))
