"""Derivatives carried along with a run are those of the run."""

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.expressions import as_number
from plough_opt.motion.derivatives import jets, jets_of
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import integration
from plough_opt.motion.runge_kutta import pairs, run_map
from plough_opt.motion.terms import Structure, parameters
from plough_opt.motion.timeline import Timeline

DURATION = 0.4


def test_pairs_are_the_upper_triangle_row_by_row():
    assert pairs(3) == [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]


def numbers_of(scene):
    """Return structure, names and values of the parameters of a run, the duration last."""
    structure, p = Structure.of(scene), parameters(scene)
    names = signals(structure).parameters
    return structure, names, [*(float(as_number(p[name])) for name in names), DURATION]


def differentiated(function, values, varying):
    """Return value, first and second derivatives of a Function's stacked results by CasADi, relative to values."""
    e = ca.MX.sym("e", len(varying))
    p = ca.MX(ca.DM(values))
    for i, position in enumerate(varying):
        p[position] = values[position] * (1.0 + e[i])
    stacked = ca.vertcat(*(ca.vec(result) for result in function.call([p])))
    slopes = ca.jacobian(stacked, e)
    second = [ca.jacobian(slopes[:, a], e)[:, a:] for a in range(len(varying))]
    return ca.Function("whole", [e], [ca.densify(ca.horzcat(stacked, slopes, *second))])(0).full()


def scaled(result, values, varying):
    """Make a jet's columns derivatives by relative changes of the parameters."""
    sizes = [values[position] for position in varying]
    return result * np.array([1.0, *sizes, *(sizes[a] * sizes[b] for a, b in pairs(len(varying)))])


def assert_alike(found, expected, outputs, allowed=1e-10):
    """Compare each kind of output, column by column, to a fraction of its largest value."""
    assert found.shape == expected.shape
    w, rate = slice(0, 2 * outputs + 2, 2), slice(1, 2 * outputs + 2, 2)
    averages = [slice(i, i + 1) for i in range(2 * outputs + 2, len(expected))]
    for rows in (w, rate, *averages):
        for column in range(expected.shape[1]):
            truth = expected[rows, column]
            # The two sum the same steps in another order; what cancels in them is of the size of the whole kind.
            size = max(np.max(np.abs(truth)), 1e-2 * np.max(np.abs(expected[rows])))
            assert found[rows, column] == pytest.approx(truth, rel=0, abs=allowed * size), (rows, column)


def test_jets_equal_derivatives_of_the_run(r1_scene, effects):
    structure, names, values = numbers_of(r1_scene(**effects))
    timeline = Timeline(outputs=4, steps=24, kink=0.137 / DURATION if structure.ramp else None)
    varying = tuple(range(min(4, len(names))))
    found = scaled(jets(structure, timeline, varying, 2)(values).full(), values, varying)
    expected = differentiated(run_map(structure, timeline), values, varying)
    assert_alike(found, expected, timeline.outputs)


def everything(r1_scene):
    wave = po.StrengthWave(0.3, 0.6)
    return r1_scene(strength_wave=wave, rate_term=0.05, damping=250.0, tow_ramp=0.137, start="rest")


@pytest.mark.parametrize(
    "chosen",
    [("wave_amplitude", "wavelength"), ("damping", "rate_term"), ("stiffness", "tow_speed"), ("static", "duration")],
    ids="-".join,
)
@pytest.mark.parametrize("aligned", [True, False])
def test_any_parameters_may_vary(r1_scene, chosen, aligned):
    structure, names, values = numbers_of(everything(r1_scene))
    timeline = Timeline(outputs=3, steps=24) if aligned else Timeline(outputs=7, steps=24, aligned=False)
    varying = tuple((*names, "duration").index(name) for name in chosen)
    found = scaled(jets(structure, timeline, varying, 2)(values).full(), values, varying)
    assert_alike(found, differentiated(run_map(structure, timeline), values, varying), timeline.outputs)


@pytest.mark.parametrize(
    ("effects", "chosen"),
    [
        ({"tow_ramp": 0.137}, ("ramp_time", "duration", "stiffness")),
        ({"tow_ramp": 0.1}, ("ramp_time", "static")),
        ({"tow_ramp": 0.137, "contact": po.Smooth(0.5)}, ("ramp_time", "width")),
        ({"contact": po.Smooth(0.5), "start": "rest"}, ("width", "duration")),
    ],
    ids=["ramp", "ramp to an output", "smooth under a ramp", "smooth"],
)
def test_steps_that_end_at_moving_kinks_too(r1_scene, effects, chosen):
    structure, names, values = numbers_of(r1_scene(damping=250.0, **effects))
    timeline = Timeline(outputs=4, steps=24, moving=True)
    varying = tuple((*names, "duration").index(name) for name in chosen)
    found = scaled(jets(structure, timeline, varying, 2)(values).full(), values, varying)
    assert_alike(found, differentiated(run_map(structure, timeline), values, varying), timeline.outputs)


def test_order_1_is_the_front_of_order_2(r1_scene):
    structure, _, values = numbers_of(everything(r1_scene))
    timeline, varying = Timeline(outputs=3, steps=24), (0, 1, 2)
    first = jets(structure, timeline, varying, 1)(values).full()
    both = jets(structure, timeline, varying, 2)(values).full()
    assert first.shape[1] == 4
    assert both.shape[1] == 4 + 6
    size = np.max(np.abs(both[:, :4]), axis=0)
    # The same operations, which CasADi may order in another way.
    assert np.max(np.abs(first - both[:, :4]) / size) < 1e-13


def test_value_is_the_run_itself(r1_scene):
    structure, _, values = numbers_of(everything(r1_scene))
    timeline = Timeline(outputs=3, steps=24)
    run = np.concatenate([result.full().ravel("F") for result in run_map(structure, timeline).call([values])])
    value = jets(structure, timeline, (1,), 1)(values).full()[:, 0]
    assert value == pytest.approx(run, rel=1e-13, abs=1e-16)


@pytest.mark.parametrize("method", ["auto", "dop853", "erk", "cvodes"])
@pytest.mark.parametrize("order", [1, 2])
def test_jets_of_any_method_are_those_of_the_run(r1_scene, method, order):
    structure, names, values = numbers_of(r1_scene(strength_wave=po.StrengthWave(0.3, 0.6), damping=250.0))
    adaptive = method in ("erk", "cvodes")
    setting = {"tolerance": 1e-12} if adaptive else {}
    timeline, varying = Timeline(outputs=4, steps=80), (names.index("stiffness"), names.index("static"))
    # Of an adaptive method the steps are the most that it takes.
    own = Timeline(outputs=4, steps=100_000) if adaptive else timeline
    solver = integration(structure, po.Accuracy(method, **setting), own)
    found = jets_of(solver, varying, order)(values).full()
    expected = jets(structure, timeline, varying, order)(values).full()
    # Tolerances of 1e-12, lost digits in second derivatives of cvodes included.
    assert_alike(found, expected, timeline.outputs, allowed=2e-8)
