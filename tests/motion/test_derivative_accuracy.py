"""First and second derivatives at default accuracy, against differences of simulators that share no code with them."""

import casadi as ca
import numpy as np
import pytest
from helpers import gauss_motion, three_modes
from helpers.differences import WEIGHTS

import plough_opt as po

# Weights of the second central difference of order 8, and that of its middle value.
BENDS, MIDDLE = np.array([8 / 5, -1 / 5, 8 / 315, -1 / 560]), -205 / 72
NAMES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
WAVE = {"amplitude": 0.5, "wavelength": 0.4}
PLAIN = {"stiffness": 5e4, "mass": 45.0, "speed": 2.0, "damping": 400.0, "duration": 1.0}
# Steps of the differences other than 4e-3.
STEPS = {"smooth": 2e-2}


def scene_of(x, **effects):
    """Return the scene of numbers or symbols."""
    if "amplitude" in x:
        effects["strength_wave"] = po.StrengthWave(x["amplitude"], x["wavelength"])
    if "ramp" in x:
        effects["tow_ramp"] = x["ramp"]
    if "width" in x:
        effects["contact"] = po.Smooth(x["width"])
    if "breakaway" in x:
        effects["contact"] = po.StickSlip(x["breakaway"])
    share = po.Wedge(po.deg(30.0), po.deg(15.0), x.get("height", 0.25))
    chosen = po.Effects(damping=x["damping"], **effects)
    return po.Scene(po.named_soil("serozem"), share, x["stiffness"], x["mass"], x["speed"], chosen)


CASES = {
    "ramp": (PLAIN | {"ramp": 0.301}, {}, gauss_motion.follow),
    "ramp to the end of a step": (PLAIN | {"ramp": 0.3}, {}, gauss_motion.follow),
    "ramp beyond the end": (PLAIN | {"ramp": 1.2}, {"start": "rest"}, gauss_motion.follow),
    "smooth": (PLAIN | {"width": 0.2, "speed": 1.5}, {"start": "rest"}, three_modes.follow),
    "smooth under a ramp": (PLAIN | WAVE | {"width": 0.2, "ramp": 0.301}, {"start": "towed"}, three_modes.follow),
    "stick and slip under a ramp": (
        PLAIN | WAVE | {"breakaway": 1.2, "ramp": 0.2, "speed": 1.5, "duration": 0.5},
        {"start": "rest"},
        three_modes.follow,
    ),
    "entry under a ramp": (
        PLAIN | WAVE | {"ramp": 0.2, "speed": 1.5, "duration": 0.5, "height": 0.25},
        {"start": "towed", "entry": True},
        three_modes.follow,
    ),
}


def symbolic(case, name):
    """Return results with their first and second derivatives by relative changes of one quantity."""
    x, effects, _ = CASES[case]
    t, weights = ca.MX.sym("t"), ca.MX.sym("weights", len(NAMES))
    moved = x | {name: x[name] * (1.0 + t)}
    run = po.simulate(scene_of(moved, **effects), moved["duration"], outputs=7)
    found = ca.vertcat(*(getattr(run, result) for result in NAMES))
    first = ca.Function("first", [t], [found, ca.jacobian(found, t)])
    second = ca.Function("second", [t, weights], [ca.hessian(ca.dot(weights, found), t)[0]])
    value, slope = (np.asarray(part).ravel() for part in first(0.0))
    return value, slope, np.array([float(second(0.0, unit)) for unit in np.eye(len(NAMES))])


def by_differences(case, name, step):
    """Return the same by differences of order 8 with an independent simulator."""
    x, effects, follow = CASES[case]

    def results(t):
        moved = x | {name: x[name] * (1.0 + t)}
        motion = follow(scene_of(moved, **effects), moved["duration"])
        return np.array([getattr(motion, result) for result in NAMES])

    here, pairs = results(0.0), [(results(k * step), results(-k * step)) for k in range(1, 5)]
    slopes = sum(w * (a - b) for w, (a, b) in zip(WEIGHTS, pairs, strict=True)) / step
    bends = (MIDDLE * here + sum(w * (a + b) for w, (a, b) in zip(BENDS, pairs, strict=True))) / step**2
    return here, slopes, bends


EVERY = [(case, name) for case in CASES for name in CASES[case][0]]
FEW = [
    ("ramp", "ramp"),
    ("ramp to the end of a step", "ramp"),
    ("smooth", "width"),
    ("stick and slip under a ramp", "ramp"),
    ("entry under a ramp", "ramp"),
]


@pytest.mark.parametrize(
    ("case", "name"),
    [pytest.param(*pair, id="-".join(pair), marks=[] if pair in FEW else [pytest.mark.slow]) for pair in EVERY],
)
def test_derivatives_are_those_of_differences(case, name):
    found, expected = symbolic(case, name), by_differences(case, name, STEPS.get(case, 4e-3))
    size = np.max(np.abs(expected), axis=0)
    # The motion is right to 1e-8. Differences of rounding, 1e-15, leave 1e-10; those of steps to 1e-12 leave 3e-8.
    for order, allowed in enumerate((1e-8, 1e-8, 1e-7)):
        assert np.max(np.abs(found[order] - expected[order]) / size) < allowed, order


@pytest.mark.parametrize("case", ["stick and slip under a ramp", "entry under a ramp"])
def test_second_derivatives_through_events_are_those_of_a_gradient(case):
    x, effects, _ = CASES[case]
    t = ca.MX.sym("t", 2)
    moved = x | {"stiffness": x["stiffness"] * (1.0 + t[0]), "ramp": x["ramp"] * (1.0 + t[1])}
    draft = po.simulate(scene_of(moved, **effects), x["duration"], outputs=4).mean_draft
    gradient = ca.gradient(draft, t)
    ways = [
        ca.hessian(draft, t)[0],
        ca.jacobian(gradient, t),
        ca.horzcat(*(ca.jtimes(gradient, t, unit) for unit in ca.horzsplit(ca.DM.eye(2)))),
        ca.horzcat(*(ca.jtimes(gradient, t, unit, True) for unit in ca.horzsplit(ca.DM.eye(2)))),
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
    scene = scene_of(PLAIN | {"ramp": x}, start="rest")
    draft = po.simulate(scene, 1.0, accuracy=po.Accuracy(method, tolerance=1e-11), outputs=7).mean_draft
    run = po.simulate(scene, 1.0, outputs=7)
    first, second = ca.gradient(draft, x), ca.gradient(ca.gradient(draft, x), x)
    expected = ca.gradient(run.mean_draft, x), ca.gradient(ca.gradient(run.mean_draft, x), x)
    found = ca.Function("found", [x], [draft, first, second, run.mean_draft, *expected])(0.301)
    value, slope, bend, *truth = (float(part) for part in found)
    assert value == pytest.approx(truth[0], rel=1e-10)
    # Without a step that ends there the slope has an error of 1e-5.
    assert slope == pytest.approx(truth[1], rel=1e-7)
    assert bend == pytest.approx(truth[2], rel=1e-5)


SUDDEN = {
    "motion": {"damping": 400.0},
    "stick and slip": {"damping": 400.0, "start": "rest", "contact": po.StickSlip(1.2)},
    "entry": {"damping": 400.0, "start": "towed", "entry": True},
    "quasi-static": {"motion": False, "strength_wave": po.StrengthWave(0.5, 0.4)},
}


@pytest.mark.parametrize("case", SUDDEN)
def test_a_ramp_that_symbols_make_0_has_the_limit_of_short_ones(case):
    x = ca.MX.sym("x")
    share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.25)
    scene = po.Scene(po.named_soil("serozem"), share, 5e4, 45.0, 2.0, po.Effects(tow_ramp=x, **SUDDEN[case]))
    draft = po.simulate(scene, 1.0, outputs=4).mean_draft
    found = ca.Function("found", [x], [draft, ca.gradient(draft, x)])
    there, beside = (np.array([float(part) for part in found(ramp)]) for ramp in (0.0, 1e-7))
    # In 1e-7 s the strut falls behind by 1e-7 m. Event times have errors of 1e-12 of the run, which are a tenth of the
    # slope for so short a ramp.
    assert there[0] == pytest.approx(beside[0], rel=2e-7)
    assert there[1] == pytest.approx(beside[1], rel=0.2 if "contact" in SUDDEN[case] or case == "entry" else 1e-3)
