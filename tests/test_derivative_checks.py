"""The error of derivatives, as designs and components estimate and report it."""

import numpy as np
import pytest
from helpers.scenes import scene_of
from scipy.optimize import brentq

import plough_opt as po
from plough_opt.design.model.program import error_of_derivatives
from plough_opt.motion.derivatives import derivative_error, jets
from plough_opt.motion.equation import Structure, equation_of, parameters
from plough_opt.motion.integrators import integration
from plough_opt.motion.steps import Timeline, crossings, step

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
    assert "the wanted error 1.0e-06 of derivatives was not reached" in text


def test_a_step_is_cut_where_the_smooth_contacts_step_ends():
    """Against halving of the step itself, which reads no polynomial: a cubic errs by the fourth power of a step."""
    width, size = 0.4, 0.0025
    effects = {"contact": po.Smooth(width), "start": "towed", "damping": 100.0}
    own = scene_of(share=po.Cone("10 deg", "25 cm"), stiffness=2e4, mass=30.0, tow_speed=1.0, **effects)
    structure, known = Structure.of(own), parameters(own)
    p, one = [*(float(known[name]) for name in equation_of(structure).names), 1.0], step(equation_of(structure))

    def beyond(part, state, start):
        return 1.0 - float(one(state, [start, part * size], p)[0][1]) - width

    rises, state = [], np.zeros(2)
    for start in size * np.arange(120):
        after = np.asarray(one(state, [start, size], p)[0]).ravel()
        found = np.asarray(crossings(equation_of(structure), 2)(state, after, [start, size], p)).ravel()
        ends, wanted = [beyond(part, state, start) for part in (0.0, 1.0)], 1.0
        if (ends[0] < 0.0) != (ends[1] < 0.0):
            wanted = brentq(beyond, 0.0, 1.0, (state, start))
            rises.append(ends[1] > 0.0)
        # Ten bisections end up to 2^-10 below; the cubic misses twice as much where the share brakes hardest.
        assert found == pytest.approx([wanted, 1.0], rel=0, abs=3e-3), start
        state = after
    assert {*rises} == {False, True}
