"""First and second derivatives of every combination of effects, against differences of high order.

All quantities of a scene change together along a random direction, x = x0 (1 + t direction), so that one derivative by
t checks those by every quantity. A motion has no derivative where an event appears or vanishes. If the events differ
between the two ends of the differences, the test draws another place.
"""

import itertools
import zlib

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from test_effect_combinations import COVERING, VALID, choices, label, split, thinned

import plough_opt as po

# Quantities of every scene, SI. About two waves pass, and the mount makes one and a half oscillations.
SOIL = {
    "density": 1400.0, "density_ratio": 0.8, "cohesion": 15e3, "friction_angle": po.deg(30.0), "tool_friction": 0.5,
    "ambient_pressure": 1e4,
}  # fmt: skip
SHARE = {"angle": po.deg(45.0), "chisel_angle": po.deg(15.0), "height": 0.15}
NUMBERS = SOIL | SHARE | {"stiffness": 8e4, "mass": 24.0, "tow_speed": 1.2, "duration": 0.2}
# Those of effects. The ramp ends neither at an output nor at the end of a step.
OWN = {"tow_ramp": 0.061, "damping": 120.0, "rate_term": 0.08, "speed_term": 0.2}
OUTPUTS, INNER = 4, 2
STEP = 3e-4
# Intervals on which events are told apart, and the fewest of them between two events or an event and an output.
COURSE, NEAR = 400, 8
# A share that does not stop must keep this part of its largest speed.
GRAZES = 0.03


def numbers_of(effects):
    """Return the quantities, by name, around which the scenes of a combination are drawn."""
    found = NUMBERS | {name: value for name, value in OWN.items() if effects.get(name)}
    if effects.get("strength_wave"):
        found |= {"amplitude": 0.7, "wavelength": 0.1}
    found |= {po.Smooth: {"width": 0.3}, po.StickSlip: {"breakaway": 1.2}}.get(type(effects.get("contact")), {})
    if effects.get("formulation") == "printed":
        # Its spring repels: two e-foldings are enough. The share starts so far ahead that a short wave turns too fast.
        found |= {"stiffness": 2e4, "mass": 500.0} | ({"wavelength": 1.0} if "wavelength" in found else {})
    return found


def scene_of(effects, x):
    """Return the scene of a combination with the quantities x, floats or expressions."""
    effects = effects | {name: x[name] for name in OWN if name in x}
    if "amplitude" in x:
        effects["strength_wave"] = po.StrengthWave(x["amplitude"], x["wavelength"])
    for name, law in (("width", po.Smooth), ("breakaway", po.StickSlip)):
        if name in x:
            effects["contact"] = law(x[name])
    soil, share = po.Soil(**{name: x[name] for name in SOIL}), po.Wedge(**{name: x[name] for name in SHARE})
    return po.Scene(soil, share, x["stiffness"], x["mass"], x["tow_speed"], po.Effects(**effects))


def has_events(effects):
    return effects.get("entry", False) or isinstance(effects.get("contact"), po.StickSlip)


def is_smooth(effects):
    return isinstance(effects.get("contact"), po.Smooth)


def method_of(effects):
    if effects.get("motion") is False:
        return None
    if is_smooth(effects):
        return po.Accuracy("erk", tolerance=1e-13)
    return po.Accuracy("erk", tolerance=1e-12) if has_events(effects) else po.Accuracy("dop853", steps=200)


def simulated(effects, x, accuracy, outputs=OUTPUTS):
    duration = None if effects.get("orbit", "transient") != "transient" else x["duration"]
    return po.simulate(scene_of(effects, x), duration, accuracy=accuracy, outputs=outputs)


def results(run):
    return [run.mean_draft, run.force_rms, run.mount_force[INNER], run.mount_force[-1]]


def events(effects, x):
    """Return the events of a motion in order, with the outputs between them, or None if two nearly coincide."""
    run = simulated(effects, x, po.Accuracy("erk", tolerance=1e-9), COURSE)
    before, here, after = run.speed[:-2], run.speed[1:-1], run.speed[2:]
    turns = (run.mode[1:-1] == 0) & ((here - before) * (after - here) < 0.0)
    if np.any(turns & (np.abs(here) < GRAZES * np.max(run.speed))):
        return None
    marks = [np.round(run.mode)]
    if effects.get("entry"):
        # A share that turns back while it enters leaves the soil that it has passed.
        marks += [np.maximum.accumulate(run.travel) >= x["height"], run.speed < 0.0]
    marks = np.column_stack(marks).astype(int)
    at = np.flatnonzero(np.any(np.diff(marks, axis=0), axis=1))
    outputs = [INNER * COURSE // OUTPUTS, COURSE]
    if np.any(np.diff(np.sort([*at, *outputs])) < NEAR):
        return None
    return [(int(k > outputs[0]), *marks[k], *marks[k + 1]) for k in at]


def along(at, direction, t):
    """Return the quantities at the place t along a direction."""
    return {name: value * (1.0 + t * direction[name]) for name, value in at.items()}


def is_clear(effects, at, direction):
    """Return whether the events of a motion stay the same, and apart, over the differences along a direction."""
    if not has_events(effects):
        return True
    middle = events(effects, at)
    ends = (along(at, direction, t) for t in (-4.0 * STEP, 4.0 * STEP))
    return middle is not None and all(events(effects, end) == middle for end in ends)


def drawn(effects):
    """Return a place and a direction along which nothing about the events changes."""
    for attempt in range(40):
        base = numbers_of(effects)
        # Some shares nearly stop in every oscillation, so their runs end before the first one.
        base["duration"] *= (1.0, 0.8, 0.65, 0.5)[attempt // 10]
        random = np.random.default_rng([zlib.crc32(title(effects).encode()), attempt])
        at = {name: value * random.uniform(0.92, 1.08) for name, value in base.items()}
        direction = {name: random.choice([-1.0, 1.0]) * random.uniform(0.3, 1.0) for name in base}
        if is_clear(effects, at, direction):
            return at, direction
    pytest.fail("no place without coincidence")


def derivatives(effects, at, direction, accuracy):
    """Return the Functions t -> (results, slopes) and (t, weights) -> curvature of the weighted sum."""
    t, weights = ca.MX.sym("t"), ca.MX.sym("weights", 4)
    found = ca.vertcat(*results(simulated(effects, along(at, direction, t), accuracy)))
    first = ca.Function("first", [t], [found, ca.jacobian(found, t)])
    second = ca.Function("second", [t, weights], [ca.hessian(ca.dot(weights, found), t)[0]])
    return first, second


def title(effects):
    """Return the name of a combination in the list of tests."""
    if "entry" in effects:
        return label(effects)
    return "+".join(f"{name}={effects[name]}" for name in sorted(effects))


def meetings(effects):
    """Return the choices of a combination, and the pairs of those that bring events, kinks and waves."""
    found = choices(effects)
    meet = sorted(choice for choice in found if choice[0] in ("contact", "entry", "tow_ramp", "strength_wave"))
    return found | set(itertools.combinations(meet, 2))


def products(**choices):
    return [dict(zip(choices, values, strict=True)) for values in itertools.product(*choices.values())]


ON = {"inertial_drag": (True, False), "ambient_pressure": (True, False), "rate_term": (None, 0.08)}
WAVE, RAMP, DAMPER, MASS = (None, po.StrengthWave(0.7, 0.1)), (None, 0.1), (None, 120.0), (True, False)
STARTS = ("equilibrium", "rest", "towed")
THIN = thinned(COVERING, meetings)
STILL = products(motion=(False,), strength_wave=WAVE, tow_ramp=RAMP, **ON)
SHAPES = ("periodic", "linearised", po.HarmonicBalance(3))
ORBITS = products(orbit=SHAPES, strength_wave=WAVE[1:], damping=DAMPER, added_mass=MASS, **ON)
PRINTED = products(
    formulation=("printed",), start=STARTS, strength_wave=WAVE, tow_ramp=RAMP, damping=DAMPER, added_mass=MASS, **ON
)


CASES = [(VALID, THIN), *((rows, thinned(rows)) for rows in (STILL, ORBITS, PRINTED))]


@pytest.mark.parametrize("combinations", [case for both in CASES for case in split(*both, title)])
def test_slope_and_curvature_are_those_of_differences(combinations):
    for effects in combinations:
        check_slope_and_curvature(effects, *drawn(effects))


def check_slope_and_curvature(effects, at, direction):
    first, second = derivatives(effects, at, direction, method_of(effects))
    values, slopes = (np.asarray(result).ravel() for result in first(0.0))
    run = simulated(effects, at, None)
    # A numeric run promises 1e-8.
    assert values == pytest.approx(results(run), rel=0, abs=2e-8 * np.max(np.abs(run.mount_force)))
    size = max(abs(values[0]), values[1])
    weights = np.cos(np.arange(4)) / size

    def beside(t):
        value, slope = (np.asarray(result).ravel() for result in first(*t))
        return np.append(value / size, slope @ weights)

    *expected, bend = differences(beside, np.zeros(1), STEP).ravel()
    if is_smooth(effects):
        # Tolerance 1e-13 over the step. Where a step of integration meets an end of the smooth contact's step, a fifth
        # derivative jumps: a local error of 1e-13, differentiated twice by its place in the step. It leaves 1e-9 to
        # 1e-7 of the curvature, and 5e-5 for one combination in five hundred.
        allowed = 1e-7, (1e-6 if effects in THIN else 1e-4)
    elif has_events(effects):
        # Tolerance 1e-12 over the step is 3e-9, which unstable motions amplify about a hundred times.
        allowed = 2e-6, 2e-6
    else:
        # Rounding, about 1e-14 over the step, amplified by unstable motions.
        allowed = 1e-9, 1e-9
    assert np.max(np.abs(slopes / size - expected) / np.maximum(1.0, np.abs(expected))) < allowed[0]
    assert abs(float(second(0.0, weights)) - bend) < allowed[1] * max(1.0, abs(bend))
    if effects in THIN and not is_smooth(effects) and not effects["entry"]:
        # The default accuracy gives derivatives to 1e-6.
        default = derivatives(effects, at, direction, None)
        found, truth = (
            np.array([one(0.0)[1].full().ravel(), [float(two(0.0, unit)) for unit in np.eye(4)]])
            for one, two in (default, (first, second))
        )
        assert np.max(np.abs(found - truth) / np.maximum(size, np.abs(truth))) < 1e-6


def test_slope_and_curvature_of_a_share_that_leaves_a_gap():
    effects = {**VALID[0], "contact": po.StickSlip(1.2), "start": "rest", "strength_wave": WAVE[1]}
    numbers = {"angle": po.deg(25.0), "height": 0.25, "stiffness": 1e4, "tow_speed": 2.0, "wavelength": 0.6}
    at, direction = drawn(effects)
    at |= numbers | {"amplitude": 0.95, "duration": 0.5}
    assert 2.0 in simulated(effects, at, None, COURSE).mode
    assert is_clear(effects, at, direction)
    check_slope_and_curvature(effects, at, direction)


@pytest.mark.parametrize("law", ["resisting", po.StickSlip(1.2)], ids=["resisting", "stick_slip"])
def test_entry_under_a_ramp_is_smooth_in_its_numbers(law):
    # The share's speed is 0 at the start, and rounding must not make that an event.
    effects = {**VALID[0], "contact": law, "start": "rest", "entry": True, "tow_ramp": 0.1}
    at = numbers_of(effects)
    direction = {name: 1.0 - 0.1 * k for k, name in enumerate(at)}
    places = np.linspace(-1.0, 1.0, 61)
    t = ca.MX.sym("t")
    run = simulated(effects, along(at, direction, 2e-3 * t), po.Accuracy("erk", tolerance=1e-10))
    value = ca.Function("value", [t], [run.mean_draft])
    values = np.array([float(value(place)) for place in places])
    smooth = np.polynomial.Chebyshev.fit(places, values, 8)(places)
    assert values == pytest.approx(smooth, rel=1e-7)
