"""Hard designs against closed forms, brute force and SciPy: vanishing derivatives, needles, flat objectives."""

import itertools
import math
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import pytest
from helpers import equations
from helpers.differences import differences
from helpers.scenes import R1_SOIL, SHARP
from helpers.small_designs import design
from scipy.optimize import minimize, minimize_scalar

import plough_opt as po

# --- a share in the soil by closed forms, and design questions that a design, brute force and SciPy can all answer ---
# The scenes are quasi-static over whole waves, so that mean and RMS of the draft are closed forms, written here anew.

CHISEL, SPEED, AMPLITUDE, WAVELENGTH, DURATION = po.deg(15.0), 2.0, 0.3, 0.5, 2.0
NAMES = ("wedge angle", "height", "stiffness")
LOWER, UPPER = np.array([po.deg(5.0), 0.1, 5e3]), np.array([po.deg(60.0), 0.5, 5e5])


def half_angle(wedge_angle):
    """Return the equivalent cone's half angle."""
    return equations.half_angle(wedge_angle, CHISEL, math)


def forces(wedge_angle, height):
    """Return F0 [N] and Fd [N s^2/m^2]."""
    share = {"wedge_angle": wedge_angle, "chisel_angle": CHISEL, "height": height}
    return equations.forces(vars(R1_SOIL) | share, math)[:2]


def draft(x):
    """Return mean and RMS of the draft [N] over whole waves."""
    static, drag = forces(x[0], x[1])
    return static + drag * SPEED**2, static * AMPLITUDE / math.sqrt(2.0)


def radius(x):
    """Return the loosened radius [m] by equation (16)."""
    return x[1] * math.tan(half_angle(x[0])) / math.sqrt(1.0 - R1_SOIL.density_ratio)


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
        run = po.simulate(po.Scene(R1_SOIL, share, k0, 24.0, SPEED, effects), DURATION)
        d.minimise(OBJECTIVES[self.objective](run.mean_draft, run.force_rms, height, k0))
        found = {
            "loosened radius": po.loosened_radius(share.equivalent_cone(), R1_SOIL),
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


# --- starts ------------------------------------------------------------------------------------

# Guesses (deg, m, N/m), by the requirements that they break.
STARTS = {
    "radius": (6.0, 0.3, 4e5),
    "none": (35.0, 0.25, 3e5),
    "angle": (55.0, 0.3, 4e5),
    "radius and angle": (50.0, 0.11, 4e5),
    "deflection": (35.0, 0.25, 5.1e3),
    "at the lower bounds": (5.0, 0.1, 5e3),
    "all": (50.0, 0.12, 5.1e3),
    "at the upper bounds": (60.0, 0.5, 5e5),
}


@pytest.mark.parametrize("guess", STARTS.values(), ids=STARTS)
def test_any_start_leads_to_the_optimum(guess):
    question = Question(guess=(po.deg(guess[0]), *guess[1:]))
    best = question.design().solve()
    assert_is_the_optimum(question, best)
    assert set(best.active) == set(USUAL)


def test_a_start_at_the_end_of_the_domain_is_refused():
    question = Question(guess=(0.0, 0.25, 5e4), lower=np.array([0.0, 0.1, 5e3]))
    with pytest.raises(po.DomainError, match="at the guess: wedge angle = 0 rad must be above 0 rad"):
        question.design().solve()


# --- optima at bounds ---------------------------------------------------------------------------------------

WIDE = USUAL["loosened radius"]
# A share of the least wedge angle and height that loosens just as much as is required.
CORNER = {"loosened radius": (radius((po.deg(20.0), 0.2)), math.inf)}
AT_BOUNDS = {
    "one bound": (Question("a draft and a height wanted", {}), {"stiffness"}),
    "two bounds": (Question("a height wanted", {}), {"wedge angle", "stiffness"}),
    "all bounds": (Question("drafts", {}), set(NAMES)),
    "all bounds but one, and a requirement": (
        Question(limits={"loosened radius": WIDE}, upper=np.array([po.deg(60.0), 0.16, 5e5])),
        {"loosened radius", "wedge angle", "stiffness"},
    ),
    "a bound and two requirements": (
        Question(upper=np.array([po.deg(36.0), 0.5, 5e5])), {"loosened radius", "mean deflection", "wedge angle"}
    ),
    "a requirement that is no more than the bounds": (
        Question(limits=CORNER, lower=np.array([po.deg(20.0), 0.2, 5e3])), {*NAMES, *CORNER}
    ),
}  # fmt: skip


@pytest.mark.parametrize(("question", "active"), AT_BOUNDS.values(), ids=AT_BOUNDS)
def test_optima_at_bounds(question, active):
    best = question.design().solve()
    assert_is_the_optimum(question, best)
    assert set(best.active) == active
    for k, name in enumerate(NAMES):
        if name in active:
            assert min(abs(best.variables[name] - end[k]) for end in (question.lower, question.upper)) < 1e-8 * UPPER[k]


# --- redundant, nearly infeasible and infeasible requirements -----------------------------------------------


@pytest.mark.parametrize("times", [2, 5, 10])
def test_a_repeated_requirement_counts_once_and_one_that_another_implies_not_at_all(times):
    limits = USUAL | {f"loosened radius again {k}": USUAL["loosened radius"] for k in range(times - 1)}
    once, often = Question(), Question(limits=limits | {"loosened radius again": (0.1, math.inf)})
    best = often.design().solve()
    assert_is_the_optimum(often, best)
    *pulls, weaker = (limit for limit in best.limits if limit.name.startswith("loosened"))
    (alone,) = (limit.multiplier for limit in once.design().solve().limits if limit.name.startswith("loosened"))
    assert sum(pull.multiplier for pull in pulls) == pytest.approx(alone, rel=1e-6)
    assert weaker.margin == pytest.approx(0.02, rel=1e-7)
    assert weaker.multiplier < 1e-7
    assert not weaker.active


# Height at which the largest half angle allowed loosens just as much as is required.
JUST = 0.12 * math.sqrt(0.2) / math.tan(po.deg(15.0))


def up_to(height):
    return Question(guess=(po.deg(25.0), 0.15, 5e4), upper=np.array([po.deg(60.0), height, 5e5]))


@pytest.mark.parametrize("width", [1e-6, 1e-3, 1e-9, 0.0, 1e-12])
def test_a_feasible_set_of_almost_no_width(width):
    question = up_to(JUST * (1.0 + width))
    best = question.design().solve()
    x = np.array([best.variables[name] for name in NAMES])
    assert max(question.violations(x).values()) < 1e-9
    # Nearly one point is left, and the least stiffness there.
    assert x[1] == pytest.approx(JUST, rel=1e-8)
    assert half_angle(x[0]) == pytest.approx(po.deg(15.0), rel=1e-8)
    assert x[2] == pytest.approx(draft(x)[0] / 0.02, rel=1e-8)
    assert best.objective == pytest.approx(question.value(x), rel=1e-11)
    # Where several limits meet in a point their multipliers are not unique, but together they balance the gradient.
    assert_is_balanced(question, best, x)


@pytest.mark.parametrize("lack", [1e-2, 1e-4, 1e-6])
def test_a_small_conflict_is_reported_with_its_size(lack):
    with pytest.raises(po.InfeasibleDesign) as caught:
        up_to(JUST * (1.0 - lack)).design().solve()
    needed = math.atan(0.12 * math.sqrt(0.2) / (JUST * (1.0 - lack))) - po.deg(15.0)
    # Relative to its limit the angle must give way by 0.955 of the lack, the radius by all of it. Both are met to 1e-8.
    assert caught.value.conflicts == {"largest half angle": pytest.approx(needed, abs=1e-8)}
    assert set(caught.value.blockers) == {
        "requirement 'loosened radius' at least 0.12", f"upper bound {JUST * (1.0 - lack):.6g} m of 'height'"
    }  # fmt: skip


# --- designs with singularities: vanishing oscillation, flat objectives, and trials outside the domain of a theory ---

# Whole waves for a share that moves with the strut: RMS is amplitude F0/sqrt(2).
MOTIONS = {"quasi-static": (False, 2.0), "moving": (True, 0.5)}
motions = pytest.mark.parametrize(("motion", "duration"), MOTIONS.values(), ids=MOTIONS)


def sharp_scene(amplitude=None, share=SHARP, stiffness=5e4, mass=24.0, **effects):
    wave = None if amplitude is None else po.StrengthWave(amplitude, 0.5)
    return po.Scene(R1_SOIL, share, stiffness, mass, 2.0, po.Effects(strength_wave=wave, **effects))


def rms(amplitude, motion, duration):
    return po.simulate(sharp_scene(amplitude, motion=motion), duration, outputs=10).force_rms


def by_scipy(function, lower, upper):
    """Return the least value of a function on an interval: a grid with both ends, its best place polished."""
    grid = np.linspace(lower, upper, 41)
    values = [function(float(x)) for x in grid]
    k = int(np.argmin(values))
    around = grid[max(k - 1, 0)], grid[min(k + 1, 40)]
    return min(values[k], minimize_scalar(function, bounds=around, method="bounded", options={"xatol": 1e-10}).fun)


# --- RMS where nothing oscillates ---------------------------------------------------------------------------


@motions
def test_derivatives_where_the_amplitude_vanishes(motion, duration):
    x = ca.MX.sym("amplitude")
    run = po.simulate(sharp_scene(x, motion=motion), duration, outputs=10 if motion else 400)
    hessian, gradient = ca.hessian(run.force_rms, x)
    of = ca.Function("of", [x], [run.force_rms, gradient, hessian])
    value, slope, bend = map(float, of(0.0))
    limit = rms(1e-7, motion, duration) / 1e-7
    if not motion:
        assert limit == pytest.approx(sharp_scene().reaction.static / math.sqrt(2.0), rel=1e-9)
    # The root is rounded off within 1e-12 of the force: there its slope is that of an even function. What a
    # quadrature's weights lack of one is below that.
    force = sharp_scene().steady_resistance
    assert 0.0 <= value <= 1e-15 * force
    assert abs(slope) <= 1e-15 * force
    assert math.isfinite(bend)
    assert bend > 0.0
    for amplitude in (1e-10, 1e-8, 1e-6, 1e-4):
        value, slope, bend = map(float, of(amplitude))
        # By closed form sqrt((slope x)^2 + r^2) - r with r = 1e-12 of the force, and what the wave's square adds.
        rounded = 1e-12 * force / (limit * amplitude)
        allowed = 2.0 * rounded + 10.0 * amplitude + 1e-6
        assert value == pytest.approx(limit * amplitude, rel=allowed)
        assert slope == pytest.approx(limit, rel=allowed)
        assert math.isfinite(bend)


@pytest.mark.parametrize(
    ("gain", "guess"), [(0.0, 0.3), (0.9, 0.0), (1.1, 1.0), pytest.param(2.0, 0.0, marks=pytest.mark.slow)]
)
@motions
def test_an_amplitude_is_driven_to_zero_or_away_from_it(motion, duration, gain, guess):
    slope = rms(1e-7, motion, duration) / 1e-7 / 1e3
    d, amplitude = design(amplitude=(guess, 0.0, 1.0))
    run = po.simulate(sharp_scene(amplitude, motion=motion), duration)
    d.minimise(1.0 + run.force_rms / 1e3 - gain * slope * amplitude)
    best = d.solve(search="local")
    x = best.variables["amplitude"]
    (limit,) = best.limits
    truth = by_scipy(lambda e: 1.0 + rms(e, motion, duration) / 1e3 - gain * slope * e, 0.0, 1.0)
    assert best.objective == pytest.approx(truth, abs=1e-9)
    if gain < 1.0:
        assert x < 1e-9
        # The barrier stops at some 3e-11, where rounding the root off still takes a thousandth of its slope.
        assert limit.multiplier == pytest.approx((1.0 - gain) * slope, abs=2e-3 * slope)
    else:
        assert x > 0.4
        assert limit.active == (min(x, 1.0 - x) < 1e-6)


# --- flat objectives ----------------------------------------------------------------------------------------


def steady_draft(variables):
    share = po.Wedge(variables["wedge angle"], po.deg(15.0), variables["height"])
    return sharp_scene(share=share).steady_resistance / 1e3


# --- designs without a value -------------------------------------------------------

PARTLY = {
    # the objective, for expressions and numbers: numbers without a value count as infinite
    "root": lambda h, sqrt, _log: 1.0 - sqrt(h - 0.2) + 2.0 * h,
    "steep root": lambda h, sqrt, _log: 1.0 - 0.2 * sqrt(h - 0.2) + 2.0 * h,
    "logarithm": lambda h, _sqrt, log: 3.0 - log(h - 0.2) / 10.0 + 2.0 * h,
    "inverse": lambda h, sqrt, _log: 1.0 + 1e-3 / sqrt(h - 0.2) + h,
}


@pytest.mark.parametrize("lower", [0.1, 0.2], ids=["beyond", "up to it"])
@pytest.mark.parametrize("guess", [0.2001, 0.5])
@pytest.mark.parametrize("objective", PARTLY.values(), ids=PARTLY)
def test_designs_without_a_value_do_not_stop_a_solve(objective, guess, lower):
    d, h = design(h=(guess, lower, 0.5))
    d.minimise(objective(h, ca.sqrt, ca.log))
    best = d.solve()
    truth = by_scipy(lambda x: objective(x, math.sqrt, math.log), 0.2 + 1e-12, 0.5)
    assert best.objective == pytest.approx(truth, rel=1e-9)


def test_an_optimum_at_a_bound_with_an_infinite_slope_is_found():
    d, h = design(h=(0.3, 0.2, 0.5))
    d.minimise(1.0 + ca.sqrt(h - 0.2))
    best = d.solve()
    # The square root of the bound's rounding.
    assert best.objective == pytest.approx(1.0, abs=1e-8)
    assert best.variables["h"] == pytest.approx(0.2, rel=1e-15)
    assert "h" in best.active


@pytest.mark.parametrize("upper", [89.0, 89.99, 90.0 * (1.0 - 1e-12)])
@pytest.mark.parametrize("guess", [10.0, 88.0])
def test_a_share_between_bounds_that_reach_the_end_of_the_angles(upper, guess):
    d, angle = design(**{"wedge angle": (po.deg(guess), 1e-8, po.deg(upper), "rad")})
    run = po.simulate(sharp_scene(share=po.Wedge(angle, po.deg(15.0), 0.25), motion=False), 1.0)
    d.minimise(1.0 + (run.mean_draft / 2e3 - 1.0) ** 2)
    best = d.solve()
    # The start's objective of up to a thousand scales the tolerance.
    assert steady_draft({"wedge angle": best.variables["wedge angle"], "height": 0.25}) == pytest.approx(2.0, rel=1e-6)
    assert best.objective == pytest.approx(1.0, abs=1e-12)
