"""Accuracy of derivatives, compiled steps, and tableaus added by name."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from helpers.differences import order_4
from helpers.scenes import assert_alike, results_of, scene_of

import plough_opt as po
from plough_opt.design.model.program import error_of_derivatives
from plough_opt.motion.compiled_steps import compiled_steps
from plough_opt.motion.derivatives import derivative_error, jets
from plough_opt.motion.equation import Structure, equation_of, parameters
from plough_opt.motion.integrators import integration
from plough_opt.motion.methods import METHODS, Tableau
from plough_opt.motion.steps import Timeline

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


@pytest.mark.parametrize("case", SUDDEN)
def test_a_symbolic_ramp_of_no_time_has_the_limit_of_short_ones(case):
    x = ca.MX.sym("x")
    draft = po.simulate(scene_of(tow_ramp=x, **SUDDEN[case]), 1.0, outputs=4).mean_draft
    found = ca.Function("found", [x], [draft, ca.gradient(draft, x)])
    there, beside = (np.array([float(part) for part in found(ramp)]) for ramp in (0.0, 1e-7))
    # In 1e-7 s the strut falls behind by 1e-7 m. Event times have errors of 1e-12 of the run, which are a tenth of the
    # slope for so short a ramp.
    assert there[0] == pytest.approx(beside[0], rel=2e-7)
    assert there[1] == pytest.approx(beside[1], rel=0.2 if "contact" in SUDDEN[case] or case == "entry" else 1e-3)


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


def test_a_failure_is_the_same(r1_scene):
    scene, accuracy = r1_scene(stiffness=5e5, start="rest"), po.Accuracy("dop853", steps=4)
    messages = []
    for compiled in (False, True):
        with pytest.raises(po.IntegrationError, match="beyond t = ") as caught:
            po.simulate(scene, 200.0, accuracy=accuracy, outputs=2, compiled=compiled)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


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


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbolic_run_has_the_derivatives_of_its_steps(kind):
    x = kind.sym("k")
    accuracy = po.Accuracy("three_eighths", steps=400)
    run = simulated(accuracy, stiffness=x)
    both = ca.Function("f", [x], [run.force_rms, ca.jacobian(run.force_rms, x)])
    value, slope = map(float, both(5e4))
    # Up to rounding of a mean square of deviations.
    assert value == pytest.approx(simulated(accuracy).force_rms, rel=1e-10)
    assert slope == pytest.approx(order_4(lambda k: float(both(k)[0]), 5e4, 5.0), rel=1e-6)


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


@pytest.mark.parametrize(
    "effects", [{}, {"tow_ramp": 0.2}, {"contact": po.Smooth(1.0)}], ids=["rest", "ramp", "smooth"]
)
@pytest.mark.parametrize(("outputs", "steps"), [(1, 16), (1, 24), (1, 48), (24, 8)])
def test_the_error_is_that_of_the_means_from_many_steps(effects, outputs, steps):
    own = scene(**effects)
    structure, p = Structure.of(own), parameters(own)
    names = equation_of(structure).names
    given = np.array([*(float(p[name]) for name in names), DURATION])
    varying = tuple(names.index(name) for name in ("stiffness", "static"))
    solvers = [
        integration(structure, po.Accuracy("dop853", steps=n), Timeline(outputs, n, moving=True)) for n in (steps, 800)
    ]
    averages = 2 * (outputs + 1)
    found = derivative_error(solvers[0], averages, varying, given[:, None])
    coarse, exact = (np.asarray(jets(equation_of(structure), one.timeline, varying, 2)(given)) for one in solvers)
    scales = given[list(varying)]
    sizes = np.array([1.0, *scales, scales[0] ** 2, scales[0] * scales[1], scales[1] ** 2])
    wrong, large = (np.max(np.abs(part[averages:]) * sizes, axis=1) for part in (coarse - exact, exact))
    rows = wrong / large
    # The estimate compares with half as many steps again, which leave a twenty-fifth of the error, and more across
    # kinks; and it covers both parameters together.
    assert np.max(rows) / 2.0 < found < 2.0 * np.max(rows)


def test_the_error_of_derivatives_that_a_finer_run_does_not_find_is_infinite():
    # A tenth of the tolerance takes more steps than are allowed.
    structure, p = Structure.of(scene()), parameters(scene())
    solver = integration(structure, po.Accuracy("erk", tolerance=1e-4), Timeline(1, 48))
    given = np.array([[*(float(p[name]) for name in solver.names), DURATION]]).T
    assert solver.function(given)[0].is_regular()
    assert derivative_error(solver, 0, (0,), given) == np.inf


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


def test_a_component_takes_as_many_steps_as_derivatives_need():
    def made(accuracy):
        return po.component(
            scene(), DURATION, inputs=["scene.stiffness"], outputs=["mean_draft", "force_rms"], accuracy=accuracy
        )

    few, many = (made(po.Accuracy(derivatives=wanted)) for wanted in (1e-2, 1e-10))
    assert about_derivatives(few.warnings) == about_derivatives(many.warnings) == []
    assert few.accuracy.steps < many.accuracy.steps
    (text,) = about_derivatives(made(po.Accuracy("dop853", steps=6)).warnings)
    assert "not the wanted 1.0e-06" in text


def test_derivatives_by_machine_code_are_those_of_interpreted_steps():
    structure, p = Structure.of(scene()), parameters(scene())
    equation = equation_of(structure)
    given, names = equation.column(p, DURATION), equation.names
    varying = tuple(names.index(name) for name in ("stiffness", "static"))
    made = [jets(equation, Timeline(1, 48, aligned=True), varying, 1, compiled=own) for own in (False, True)]
    interpreted, compiled = (np.asarray(one(given)) for one in made)
    # The compiler may contract products and sums: rounding over 48 steps.
    np.testing.assert_allclose(compiled, interpreted, rtol=1e-12)
