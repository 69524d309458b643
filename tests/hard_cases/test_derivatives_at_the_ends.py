"""Value, gradient and Hessian of whole runs at the ends of the domain, against closed forms in 120 digits.

A share that starts steadily stays steady, and without drag its oscillation is that of a linear oscillator: mean draft,
RMS and last mount force are closed forms of every number of the scene, differentiated in 120 digits. Under a strength
wave differences of high order judge the derivatives.
"""

import itertools
import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.differences import differences
from helpers.equations import forces, mp

import plough_opt as po

# Ordinary numbers, and those to differentiate by, each with the size of a typical change.
FIXED = {"chisel_angle": 0.2, "density": 1400.0, "duration": 0.3, "wavelength": 0.5}
VARIED = {
    "wedge_angle": (0.5, 0.5), "height": (0.25, 0.25), "density_ratio": (0.8, 0.2), "friction_angle": (0.5, 0.5),
    "cohesion": (15e3, 1e4), "tool_friction": (0.45, 0.5), "ambient_pressure": (1e4, 1e4), "speed": (2.0, 2.0),
    "stiffness": (5e4, 5e4), "mass": (24.0, 24.0), "damping": (100.0, 100.0), "rate_term": (0.05, 0.05),
    "amplitude": (0.5, 0.5),
}  # fmt: skip
ORDINARY = FIXED | {name: value for name, (value, _) in VARIED.items()}
SIZES = {name: size for name, (_, size) in VARIED.items()}
RIGHT = math.pi / 2.0
# name: the numbers that differ from ordinary ones, and the sizes that differ
ENDS = {
    "ordinary": ({}, {}),
    "1 N/m": ({"stiffness": 1.0, "damping": 0.0}, {"stiffness": 1.0}),
    "1e12 N/m": ({"stiffness": 1e12, "duration": 1e-4}, {"stiffness": 1e12}),
    "1e-6 kg": ({"mass": 1e-6, "duration": 0.03}, {"mass": 1e-6}),
    "ratio 1e-12": ({"density_ratio": 1e-12}, {"density_ratio": 1e-12}),
    "ratio 1 - 1e-9": (
        # A power of two, of which changes are exact; softer mounts let the soil drive the share away.
        {"density_ratio": 1.0 - 2.0**-30, "stiffness": 5e7, "duration": 0.03},
        {"density_ratio": 2.0**-30},
    ),
    "no internal friction": ({"friction_angle": 0.0}, {}),
    "89.9 deg of friction": ({"friction_angle": po.deg(89.9)}, {"friction_angle": RIGHT - po.deg(89.9)}),
    "1e-8 rad": ({"wedge_angle": 1e-8}, {"wedge_angle": 1e-8}),
    "89.99 deg": ({"wedge_angle": po.deg(89.99), "stiffness": 1e10}, {"wedge_angle": RIGHT - po.deg(89.99)}),
    "no cohesion": ({"cohesion": 0.0}, {}),
    "no ambient pressure": ({"ambient_pressure": 0.0}, {}),
    "no tool friction": ({"tool_friction": 0.0}, {}),
    "no strength": ({"cohesion": 0.0, "ambient_pressure": 0.0, "friction_angle": 0.0, "tool_friction": 0.0}, {}),
    "a strut at rest": ({"speed": 0.0}, {}),
    "1000 m/s": ({"speed": 1e3, "wavelength": 300.0, "rate_term": 1e-7}, {"speed": 1e3, "rate_term": 1e-7}),
    "no damper": ({"damping": 0.0}, {}),
    "no rate term": ({"rate_term": 0.0}, {}),
    "no wave": ({"amplitude": 0.0}, {}),
    "nothing": (
        dict.fromkeys(("cohesion", "ambient_pressure", "friction_angle", "tool_friction", "speed", "damping"), 0.0)
        | {"rate_term": 0.0, "amplitude": 0.0},
        {},
    ),
}
# Ends at which the RMS has a kink, because nothing oscillates for exactly this value of a number.
KINKS = {
    "towed": ("no strength", "nothing"),
    "rest": ("nothing",),
    "waves": ("no strength", "no wave", "nothing"),
    "still waves": ("no strength", "a strut at rest", "no wave", "nothing"),
}
ALWAYS = ("wedge_angle", "cohesion", "speed", "stiffness", "mass")
NAMES, STEPS, RMS = tuple(SIZES), 120, 1


def in_turn(*kinds):
    """Parametrize by every end and kind."""
    return pytest.mark.parametrize(("end", "kind"), [*itertools.product(ENDS, kinds)])


def numbers_of(end):
    """Return the numbers at an end, and the sizes of typical changes there."""
    changed, sizes = ENDS[end]
    return ORDINARY | changed, np.array(list((SIZES | sizes).values()))


def scene_of(v, **effects):
    names = ("density", "density_ratio", "cohesion", "friction_angle", "tool_friction", "ambient_pressure")
    share = po.Wedge(v["wedge_angle"], v["chisel_angle"], v["height"])
    if effects.pop("waves", False):
        effects["strength_wave"] = po.StrengthWave(v["amplitude"], v["wavelength"])
    own = {name: v[name] for name in ("damping", "rate_term") if effects.pop(name, False)}
    soil = po.Soil(*(v[name] for name in names))
    return po.Scene(soil, share, v["stiffness"], v["mass"], v["speed"], po.Effects(**effects, **own))


def of_steady(run):
    return [run.mean_draft, run.mount_force[-1], run.mean_deflection, run.force_rms]


def of_oscillation(run):
    return [run.mean_draft, run.force_rms, run.mount_force[-1]]


KINDS = {
    "moving": ({"rate_term": True, "damping": True}, of_steady),
    "quasi-static": ({"rate_term": True, "motion": False}, of_steady),
    "rest": ({"inertial_drag": False, "damping": True, "start": "rest"}, of_oscillation),
    "towed": ({"inertial_drag": False, "damping": True, "start": "towed"}, of_oscillation),
    "waves": ({"rate_term": True, "damping": True, "waves": True}, of_oscillation),
    "still waves": ({"rate_term": True, "motion": False, "waves": True}, of_oscillation),
}


@cache
def built(kind):
    """Return numbers -> values and Jacobian, and (numbers, weights) -> Hessian of the weighted sum, by `NAMES`."""
    effects, results = KINDS[kind]
    symbols = {name: ca.MX.sym(name) for name in ORDINARY}
    moving = effects.get("motion", True)
    accuracy = po.Accuracy("dop853", steps=STEPS) if moving else None
    run = po.simulate(scene_of(symbols, **effects), symbols["duration"], accuracy=accuracy, outputs=4 if moving else 80)
    x, values = ca.vertcat(*(symbols[name] for name in NAMES)), ca.vertcat(*results(run))
    weights = ca.MX.sym("weights", values.numel())
    total = ca.dot(weights, values)
    given = list(symbols.values())
    first = ca.Function("first", given, [values, ca.jacobian(values, x)])
    return first, ca.Function("second", [*given, weights], [ca.jacobian(ca.gradient(total, x), x)])


def first_of(numbers, sizes, kind):
    """Return values and slopes by the toolkit, in changes of the sizes."""
    values, slopes = (np.asarray(part) for part in built(kind)[0].call(list(numbers.values())))
    return values.ravel(), slopes * sizes


def second_of(numbers, sizes, kind, weights):
    """Return the Hessian of the weighted sum by the toolkit, in changes of the sizes."""
    return np.asarray(built(kind)[1](*numbers.values(), weights)) * np.outer(sizes, sizes)


@cache
def exact(end, function):
    """Return the numbers of the names that matter at an end, and a closed form's values, gradients and Hessians.

    The derivatives are with respect to these names alone, in changes of the sizes.
    """
    numbers, sizes = numbers_of(end)
    chosen = [k for k, name in enumerate(NAMES) if name in ALWAYS or name in ENDS[end][0]]
    names, sizes = [NAMES[k] for k in chosen], sizes[chosen]
    fixed = {name: mp.mpf(float(number)) for name, number in numbers.items()}

    def of(*point):
        return np.array(function(fixed | dict(zip(names, point, strict=True))))

    # Each has the entries of the answer in its first axis.
    found = hp.derivatives(of, [fixed[name] for name in names])
    values, slopes, bends = (np.moveaxis(np.array(part, dtype=float), -1, 0) for part in found)
    return chosen, values, slopes * sizes, bends * np.outer(sizes, sizes)


def largest(values):
    return float(np.max(np.abs(values), initial=0.0))


# --- a share that starts steadily ---------------------------------------------------------------------------


def steady(v):
    static, drag, _ = forces(v)
    force = static * (1 + v["rate_term"] * v["speed"] ** 2) + drag * v["speed"] ** 2
    return [force, force, force / v["stiffness"]]


def compared(end, kind, function, results):
    """Yield (name, result, toolkit's, exact) for values, slopes and curvatures by the names that matter at an end."""
    numbers, sizes = numbers_of(end)
    values, slopes = first_of(numbers, sizes, kind)
    chosen, *exactly = exact(end, function)
    for k in range(results):
        bends = second_of(numbers, sizes, kind, np.eye(len(values))[k])
        assert np.all(np.isfinite(bends))
        found = values[k], slopes[k][chosen], bends[np.ix_(chosen, chosen)]
        yield from ((order, k, found[order], exactly[order]) for order in range(3))


@in_turn("moving", "quasi-static")
def test_a_steady_start(end, kind):
    # Some tens of roundings; a sum over hundreds of panels takes more, and beside 90 degrees the tangent is known
    # to 1e-14 only.
    allowed = 1e-13 if end == "89.99 deg" or kind == "quasi-static" else 1e-14
    size = 0.0
    for _, k, found, true in compared(end, kind, steady, 3):
        assert found == pytest.approx(true[k], rel=0, abs=allowed * largest(true[k]))
        size = max(size, largest(true[0]))
    # Nothing oscillates, whatever the numbers. The weights of a quadrature sum to one but for rounding.
    numbers, sizes = numbers_of(end)
    values, slopes = first_of(numbers, sizes, kind)
    bends = second_of(numbers, sizes, kind, np.eye(4)[3])
    assert largest([largest(values[3]), largest(slopes[3]), largest(bends)]) <= 1e-14 * size


# --- a linear oscillation -----------------------------------------------------------------------------------


def oscillation(v, first):
    """Return mean, RMS and last value of P = F0 + Re(a exp(x t)) in closed form, and F0."""
    static, _, carried = forces(v)
    inertia, k, c, duration = v["mass"] + carried, v["stiffness"], v["damping"], v["duration"]
    at, d = static / k, c / (2 * inertia)
    w = mp.sqrt(k / inertia - d**2)
    x = mp.mpc(-d, w)
    a = mp.mpc(-at, -(first - d * at) / w) * (k + c * x)

    def average(exponent):
        return mp.expm1(exponent * duration) / (exponent * duration) if exponent else mp.mpf(1)

    mean = mp.re(a * average(x))
    square = mp.re(a * a * average(2 * x)) / 2 + abs(a) ** 2 * mp.re(average(x + mp.conj(x))) / 2
    return [static + mean, mp.sqrt(square - mean**2), static + mp.re(a * mp.exp(x * duration)), static]


FIRST = {"rest": lambda v: oscillation(v, v["speed"]), "towed": lambda v: oscillation(v, mp.mpf(0))}


@in_turn("rest", "towed")
def test_a_linear_oscillation(end, kind):
    for order, k, found, true in compared(end, kind, FIRST[kind], 3):
        if order == 0 or k != RMS or end not in KINKS[kind]:
            # Rounding over some twenty radians; the RMS is rounded off within 1e-12 of the steady force.
            assert found == pytest.approx(true[k], rel=0, abs=2e-11 * max(largest(true[k]), largest(true[3])))


# --- under a strength wave ----------------------------------------------------------------------------------


@in_turn("waves", "still waves")
def test_under_a_wave(end, kind):
    numbers, sizes = numbers_of(end)
    values, slopes = first_of(numbers, sizes, kind)
    scene = scene_of(numbers, motion=False)
    # The phase turns as the share moves by a wavelength. Steps are powers of two, which are exact beside 1.
    turn = 2.0 * math.pi * scene.steady_resistance / numbers["stiffness"] / numbers["wavelength"]
    step = 2.0 ** -(11 + math.ceil(math.log2(1.0 + turn)) * (kind == "waves"))
    direction = np.array([1.0, -0.75, 0.5, -1.0, 0.75, 1.0, -0.5, 1.0, 0.5, -0.75, 1.0, -1.0, 0.5])

    def beside(place):
        moves = zip(NAMES, direction, sizes, strict=True)
        moved = {name: numbers[name] + float(place[0]) * d * size for name, d, size in moves}
        return np.column_stack(first_of(numbers | moved, sizes, kind))

    changes = differences(beside, np.zeros(1), step).reshape(3, -1)
    all_bends = [second_of(numbers, sizes, kind, unit) for unit in np.eye(3)]
    assert all(np.all(np.isfinite(part)) for part in (values, slopes, *all_bends))
    # Rounding over the step. A soft mount takes steps of 1e-7, and changes beside 90 degrees are rounded themselves.
    allowed = {"1 N/m": 1e-7, "89.99 deg": 1e-6}.get(end, 3e-11)
    for k, bends in enumerate(all_bends):
        if k == RMS and end in KINKS[kind]:
            assert 0.0 <= values[k] <= 1e-14 * max(1.0, abs(values[0]))
            continue
        slope, row = changes[k, 0], changes[k, 1:]
        for got, true, size in ((slopes[k] @ direction, slope, slopes), (bends @ direction, row, all_bends)):
            # The RMS and its derivatives are known to 1e-12 of the force and of its own.
            least = largest(size[0]) * (0.1 if k == RMS else 0.0)
            assert got == pytest.approx(true, rel=0, abs=allowed * max(largest(size[k]), least))
