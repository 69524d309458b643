"""A share in the soil by closed forms, and design questions that a design, brute force and SciPy can all answer.

The scenes are quasi-static over whole waves, so that mean and RMS of the draft are closed forms, written here anew.
"""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.optimize import minimize

import plough_opt as po
from helpers import equations
from helpers.differences import differences
from helpers.scenes import R1_SOIL as SOIL

CHISEL, SPEED, AMPLITUDE, WAVELENGTH, DURATION = po.deg(15.0), 2.0, 0.3, 0.5, 2.0
NAMES = ("wedge angle", "height", "stiffness")
LOWER, UPPER = np.array([po.deg(5.0), 0.1, 5e3]), np.array([po.deg(60.0), 0.5, 5e5])


def half_angle(wedge_angle):
    """Return the equivalent cone's half angle."""
    return equations.half_angle(wedge_angle, CHISEL, math)


def forces(wedge_angle, height):
    """Return F0 [N] and Fd [N s^2/m^2]."""
    share = {"wedge_angle": wedge_angle, "chisel_angle": CHISEL, "height": height}
    return equations.forces(vars(SOIL) | share, math)[:2]


def draft(x):
    """Return mean and RMS of the draft [N] over whole waves."""
    static, drag = forces(x[0], x[1])
    return static + drag * SPEED**2, static * AMPLITUDE / math.sqrt(2.0)


def radius(x):
    """Return the loosened radius [m] by equation (16)."""
    return x[1] * math.tan(half_angle(x[0])) / math.sqrt(1.0 - SOIL.density_ratio)


def angle_for(wanted, height):
    """Return the wedge angle [rad] at which a share loosens a radius, by equations (7) and (16)."""
    slope = wanted * math.sqrt(1.0 - SOIL.density_ratio) / height
    sine = slope / math.hypot(1.0, slope)
    return math.atan(math.pi * math.cos(CHISEL) ** 2 * sine / (1.0 - sine**2))


BY_HAND = {
    "loosened radius": radius,
    "largest half angle": lambda x: half_angle(x[0]),
    "mean deflection": lambda x: draft(x)[0] / x[2],
}
USUAL = {"loosened radius": (0.12, math.inf), "largest half angle": (0.0, po.deg(15.0)), "mean deflection": (0.0, 0.02)}
OBJECTIVES = {
    # name: of (mean draft, RMS, height, stiffness), for numbers and expressions alike
    "drafts": lambda mean, rms, _h, k: (mean + rms) / 1e3 + k / 1e6,
    "a height wanted": lambda mean, _rms, h, k: mean / 1e3 + 3.0 * (h / 0.25 - 1.0) ** 2 + k / 1e6,
    "a draft and a height wanted": lambda mean, _rms, h, k: (mean / 500.0 - 1.0) ** 2 + (h / 0.25 - 1.0) ** 2 + k / 1e6,
}


@dataclass(frozen=True)
class Question:
    """A design question about a share that both a design and this file can solve."""

    objective: str = "drafts"
    limits: dict = field(default_factory=lambda: USUAL)
    lower: np.ndarray = field(default_factory=lambda: LOWER)
    upper: np.ndarray = field(default_factory=lambda: UPPER)
    guess: tuple = (po.deg(25.0), 0.25, 5e4)
    clipped: bool = True

    def design(self):
        """Return the design."""
        d = po.Design()
        guess = np.clip(self.guess, self.lower, self.upper) if self.clipped else self.guess
        bounds = zip(NAMES, guess, self.lower, self.upper, ("rad", "m", "N/m"), strict=True)
        angle, height, k0 = (
            d.variable(name, guess=guess, lower=low, upper=high, unit=unit, log=unit == "N/m")
            for name, guess, low, high, unit in bounds
        )
        share = po.Wedge(angle, CHISEL, height)
        effects = po.Effects(motion=False, strength_wave=po.StrengthWave(AMPLITUDE, WAVELENGTH))
        run = po.simulate(po.Scene(SOIL, share, k0, 24.0, SPEED, effects), DURATION)
        d.minimise(OBJECTIVES[self.objective](run.mean_draft, run.force_rms, height, k0))
        found = {
            "loosened radius": po.loosened_radius(share.equivalent_cone(), SOIL),
            "largest half angle": share.equivalent_cone().half_angle,
            "mean deflection": run.mean_deflection,
        }
        for name, (low, high) in self.limits.items():
            sides = {"at_least": low} if math.isinf(high) else {"at_most": high}
            d.require(name, found[name.split(" again")[0]], **sides)
        return d

    def value(self, x):
        return OBJECTIVES[self.objective](*draft(x), x[1], x[2])

    def limited(self, x, name):
        return BY_HAND[name.split(" again")[0]](x)

    def violations(self, x):
        """Return how far each requirement is violated, in parts of its limit; below 0 inside."""
        return {
            name: max(low - self.limited(x, name), self.limited(x, name) - high) / (low or high)
            for name, (low, high) in self.limits.items()
        }

    # In t every variable goes from 0 to 1, the stiffness by its logarithm.
    def at(self, t):
        x = self.lower + (self.upper - self.lower) * np.asarray(t)
        x[2] = self.lower[2] * (self.upper[2] / self.lower[2]) ** t[2]
        return x

    def place(self, x):
        t = (np.asarray(x) - self.lower) / (self.upper - self.lower)
        t[2] = math.log(x[2] / self.lower[2]) / math.log(self.upper[2] / self.lower[2])
        return t

    def slope(self, function, x):
        """Return the gradient in t by differences that stay in the bounds' neighbourhood."""
        return differences(lambda t: function(self.at(t)), self.place(x), 5e-4).ravel()

    def least(self, points=7):
        """Return the least objective of feasible designs: a grid with all its ends, polished by SLSQP."""
        grid = [self.at(t) for t in itertools.product(np.linspace(0.0, 1.0, points), repeat=3)]
        feasible = [x for x in grid if max(self.violations(x).values(), default=0.0) <= 0.0]
        starts = sorted(feasible, key=self.value)[:3] or [self.at((0.5, 0.5, 0.5)), self.at((0.7, 0.3, 0.6))]
        keep = [
            {"type": "ineq", "fun": lambda t, name=name: -self.violations(self.at(t))[name]} for name in self.limits
        ]
        found = [
            minimize(
                lambda t: self.value(self.at(t)), self.place(x), bounds=[(0, 1)] * 3, constraints=keep,
                method="SLSQP", options={"ftol": 1e-14, "maxiter": 300},
            )
            for x in starts
        ]  # fmt: skip
        kept = [one.fun for one in found if max(self.violations(self.at(one.x)).values(), default=0.0) < 1e-8]
        return min([*kept, *map(self.value, starts[:1] if feasible else [])])


def assert_is_balanced(question, best, x):
    """Check that the limits' multipliers balance the gradient of the objective, all by differences."""
    pull, strongest = np.zeros(3), 0.0
    for limit in best.limits:
        if limit.kind == "requirement":
            side = 1.0 if math.isinf(question.limits[limit.name][1]) else -1.0
            direction = question.slope(lambda x, n=limit.name: question.limited(x, n), x)
        else:
            k = NAMES.index(limit.name)
            side = 1.0 if question.place(x)[k] < 0.5 else -1.0
            direction = question.slope(lambda x, k=k: x[k], x)
        assert limit.multiplier >= 0.0
        pull += side * limit.multiplier * direction
        strongest = max(strongest, limit.multiplier * np.max(np.abs(direction)))
    gradient = question.slope(question.value, x)
    # Differences over 5e-4 of the range leave 1e-8 at most; of limits that leave one point only, the pulls are
    # a billion times the gradient and cancel to 1e-9 of themselves.
    assert gradient == pytest.approx(pull, rel=0, abs=1e-6 * np.max(np.abs(gradient)) + 1e-9 * strongest)


def assert_is_the_optimum(question, best):
    """Check a design against brute force, SciPy and the conditions of an optimum from differences."""
    x = np.array([best.variables[name] for name in NAMES])
    assert np.all((question.lower <= x) & (x <= question.upper))
    # IPOPT keeps requirements to 1e-10 of their limit.
    assert max(question.violations(x).values(), default=0.0) < 1e-9
    assert best.objective == pytest.approx(question.value(x), rel=1e-11)
    # SLSQP stops some 1e-9 from it, on either side of its limits, and a barrier of 1e-10 is left here.
    assert best.objective == pytest.approx(question.least(), rel=2e-8)
    assert_is_balanced(question, best, x)
    assert best.status == "solved"
