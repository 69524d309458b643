"""Requirements that conflict, feasible designs that are hard to find, and optima that cannot be confirmed."""

import math
import re
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import scene_of
from helpers.small_designs import design, sticking
from scipy.optimize import minimize

import plough_opt as po
from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import is_symbolic, where
from plough_opt.design.model import ipopt
from plough_opt.design.search import local
from plough_opt.expressions import Expression, cos


def test_the_shortfall_of_an_impossible_radius(build_r1):
    problem = build_r1(radius=0.9)
    with pytest.raises(po.InfeasibleDesign) as caught:
        problem.design.solve()
    error = caught.value
    # The largest share: half a metre high, at the largest half angle. A cone of slope 1 has a base of radius 1.
    shortfall = 0.9 - 0.5 * math.tan(po.deg(15.0)) * po.loosened_radius(po.Cone(math.pi / 4, 1.0), problem.soil)
    assert error.conflicts == {"loosened radius": pytest.approx(shortfall, rel=1e-7)}
    assert len(error.blockers) == 2
    assert any("requirement 'half angle'" in blocker for blocker in error.blockers)
    assert any("upper bound 0.5 m of 'height'" in blocker for blocker in error.blockers)
    assert re.search(r"'loosened radius' \(at least 0.9 m\) fails by 0.600\d* m", str(error))
    assert "height = 0.5 m" in str(error)


UNIT = (0.5, 0.0, 1.0, "m")
# Variables, requirements, conflicts by hand, and the limits that block them.
CONFLICTS = {
    # Violations are scaled by the limits, so that the smaller limit costs more.
    "contradiction": (
        {"x": UNIT},
        {"large": (lambda x: 10.0 * x, {"at_least": 8.0}), "small": (lambda x: 10.0 * x, {"at_most": 2.0})},
        {"large": 6.0},
        ["requirement 'small' at most 2 m"],
    ),
    "no variable": ({"x": UNIT}, {"fixed": (lambda x: 0.0 * x + 2.0, {"at_most": 1.0})}, {"fixed": 1.0}, []),
    "valley": ({"x": UNIT}, {"low": (lambda x: 1.0 + (x - 0.3) ** 2, {"at_most": 0.9})}, {"low": 0.1}, []),
    "kink": ({"x": UNIT}, {"low": (lambda x: 1.0 + ca.fabs(x - 0.3), {"at_most": 0.9})}, {"low": 0.1}, []),
    "equality": (
        {"x": UNIT},
        {"exact": (lambda x: x, {"at_least": 1.5, "at_most": 1.5})},
        {"exact": 0.5},
        ["upper bound 1 m of 'x'"],
    ),
    "bystander": (
        {"x": UNIT, "y": UNIT},
        {"long": (lambda x, _: x, {"at_least": 2.0}), "easy": (lambda _, y: y, {"at_least": 0.25})},
        {"long": 1.0},
        ["upper bound 1 m of 'x'"],
    ),
    "limit of zero": (
        {"x": UNIT},
        {"margin": (lambda x: 1e6 * (x - 1.25), {"at_least": 0.0})},
        {"margin": 0.25e6},
        ["upper bound 1 m of 'x'"],
    ),
}


@pytest.mark.parametrize("case", CONFLICTS)
def test_conflicts_known_by_hand(case):
    variables, requirements, conflicts, blockers = CONFLICTS[case]
    d, *symbols = design(**variables)
    d.minimise(1.0 + ca.sumsqr(ca.vertcat(*symbols)))
    for name, (expression, limits) in requirements.items():
        d.require(name, expression(*symbols), unit="m", **limits)
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    # IPOPT stops within 1e-8 of the least violation.
    assert caught.value.conflicts == pytest.approx(conflicts, rel=1e-7)
    assert caught.value.blockers == blockers
    assert blockers or "no variable of this design makes it smaller" in str(caught.value)


@pytest.mark.parametrize("seed", range(4))
def test_the_least_shortfall_lies_on_a_kink(seed):
    rng = np.random.default_rng(seed)
    at, other, guess = rng.uniform(0.05, 0.95, 3)
    falls, rises = 10.0 ** rng.uniform(-1.0, 1.0, 2)
    d, x, y = design(x=(guess, 0.0, 1.0), y=(guess, 0.0, 1.0))
    d.minimise(1.0 + x**2)
    d.require("low", 1.0 + ca.fmax(rises * (x - at), falls * (at - x)) + ca.fabs(y - other), at_most=0.9)
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    assert caught.value.conflicts == {"low": pytest.approx(0.1, rel=1e-6)}


def test_a_path_that_cannot_be_kept(r1_scene):
    d, k0 = design(stiffness=(5e4, 5e3, 5e5, "N/m", True))
    run = po.simulate(r1_scene(stiffness=k0), 0.5, outputs=50)
    d.minimise(run.mean_draft / 1e3)
    force = r1_scene().steady_resistance
    limit = 0.5 * force / 5e5
    d.require("deflection", run.deflection, at_most=limit, unit="m")
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    # Without a wave the share stays at equilibrium, and the stiffest mount deflects least.
    assert caught.value.conflicts == {"deflection": pytest.approx(force / 5e5 - limit, rel=1e-6)}
    assert caught.value.blockers == ["upper bound 500 kN/m of 'stiffness'"]


def test_the_least_shortfall_is_found_beside_a_higher_hill_than_the_guess():
    d, x = design(x=(0.2, 0.0, 1.0))
    d.minimise(sticking(x))
    hills = 0.5 * ca.exp(-(((x - 0.2) / 0.1) ** 2)) + 0.8 * ca.exp(-(((x - 0.8) / 0.1) ** 2))
    d.require("high", hills, at_least=1.0)
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    assert caught.value.conflicts == {"high": pytest.approx(0.2, rel=1e-6)}


def test_feasible_designs_behind_a_bend_are_found():
    d, x, y = design(x=(-0.9, -1.0, 1.0), y=(-0.9, -1.0, 1.0))
    d.minimise((x + 1.0) ** 2 + (y + 1.0) ** 2)
    d.require("inside", (x - 0.5) ** 2 + (y - 0.5) ** 2, at_most=0.04)
    d.require("outside", (x - 0.5) ** 2 + (y - 0.5) ** 2, at_least=0.01)
    best = d.solve()
    # The point of the circle of radius 0.2 about (0.5, 0.5) that is nearest to (-1, -1).
    wanted = 0.5 - 0.2 / math.sqrt(2.0)
    assert best.variables == {"x": pytest.approx(wanted, rel=1e-8), "y": pytest.approx(wanted, rel=1e-8)}


# --- unconfirmed --------------------------------------------------------------------------------------------


# Most quadratic programs, an option of IPOPT nearby, and the status. Without any time for iterations nearby, it is
# solved from afar; a few quadratic programs confirm the optimum by its exact slopes without IPOPT.
LITTLE = [
    (0, "ipopt.max_iter", 0, "unconfirmed"),
    (0, "ipopt.max_cpu_time", 1e-9, "solved"),
    (5, "ipopt.max_iter", 0, "solved"),
]


@pytest.mark.parametrize("required", [False, True])
@pytest.mark.parametrize(("programs", "option", "value", "status"), LITTLE)
def test_near_an_optimum_too_little_is_done_to_confirm_it(monkeypatch, required, programs, option, value, status):
    monkeypatch.setattr(local, "_MOST_QUADRATIC_PROGRAMS", programs)
    for options in (ipopt.NEAR, ipopt.FROM_BOTTOM):
        monkeypatch.setitem(options, option, value)
    d, x, y = design(x=(-1.2, -2.0, 2.0), y=(1.0, -2.0, 2.0))
    d.minimise((1.0 - x) ** 2 + 100.0 * (y - x**2) ** 2)
    if required:
        d.require("sum", x + y, at_least=1.0)
    best = d.solve()
    assert best.status == status
    if status == "solved":
        assert best.variables == {"x": pytest.approx(1.0, abs=1e-7), "y": pytest.approx(1.0, abs=1e-7)}


# Objective, values that x and x + 1 must have, and the best x with its tolerance.
UNCONFIRMED = {
    "kink": (lambda x: 1.0 + ca.fabs(x - 0.3), (), 0.3, 1e-5),
    "more equalities than variables": (lambda x: 1.0 + x**2, (0.8, 1.8), 0.8, 1e-6),
    "the same near the guess": (sticking, (0.8, 1.8), 0.8, 1e-6),
    # Below 0.5 the objective is undefined, and at 0.5 its slope is infinite.
    "a model that ends between the bounds": (lambda x: ca.sqrt(x - 0.5) + x, (), 0.5, 2.5e-3),
}


@pytest.mark.parametrize(("objective", "values", "wanted", "near"), UNCONFIRMED.values(), ids=UNCONFIRMED)
def test_optima_that_derivatives_do_not_confirm(objective, values, wanted, near):
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(objective(x))
    for k, value in enumerate(values):
        d.require(f"x + {k}", x + k, at_least=value, at_most=value)
    best = d.solve(search="near" if objective is sticking else "auto")
    assert best.status == "unconfirmed"
    assert any("did not confirm" in warning for warning in best.warnings)
    assert best.variables["x"] == pytest.approx(wanted, abs=near)


@pytest.mark.parametrize(("search", "size", "frequency", "x"), [("auto", 1e-3, 1e7, 0.0), ("near", 1e-2, 1e6, 0.1)])
def test_noise_is_not_exploited(search, size, frequency, x):
    d, symbol = design(x=(0.1, 0.0, 1.0))
    d.minimise(1.0 + symbol + size * ca.sin(frequency * symbol))
    best = d.solve(search=search)
    # Whichever dip of the noise is found, a near search does not step from dip to dip.
    assert best.variables["x"] == pytest.approx(x, abs=2e-3)
    assert best.objective <= 1.0 + x + size * math.sin(frequency * x)
    assert best.status in ("solved", "unconfirmed")


# --- laws undefined in a part of the box: an optimum where they are defined, or an honest status ---

SEED = 20261124
SHAPES = ("half space", "disc", "strip", "all but a small part", "everywhere", "nowhere")
WAYS = ("nan", "raised", "declared")
EACH = 6  # problems of each shape and way: 108 in all


@dataclass(frozen=True)
class Problem:
    """A bowl with ripples over a unit square, and an expression that is at most 0 where it is defined."""

    shape: str
    way: str
    lowest: tuple[float, float]
    ripple: float
    centre: tuple[float, float]
    direction: tuple[float, float]
    size: float

    @classmethod
    def random(cls, shape, way, rng):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        size = {"disc": rng.uniform(0.1, 0.35), "strip": rng.uniform(0.05, 0.2)}.get(shape, rng.uniform(0.1, 0.2))
        direction = (math.cos(angle), math.sin(angle))
        return cls(
            shape, way, (*rng.uniform(0, 1, 2),), rng.choice([0.0, 0.1]), (*rng.uniform(0.2, 0.8, 2),), direction, size
        )

    def newtons(self, x, y, cosine):
        bowl = (x - self.lowest[0]) ** 2 + 2.0 * (y - self.lowest[1]) ** 2
        return 1e3 * (1.0 + bowl + self.ripple * (1.0 - cosine(9.0 * (x + 0.5 * y))))

    def beyond(self, x, y):
        """Return an expression that is above 0 where the law is undefined."""
        along = (x - self.centre[0]) * self.direction[0] + (y - self.centre[1]) * self.direction[1]
        squared = (x - self.centre[0]) ** 2 + (y - self.centre[1]) ** 2
        return {
            "half space": along,
            "disc": self.size**2 - squared,
            "strip": self.size**2 - along**2,
            "all but a small part": squared - self.size**2,
            "everywhere": 1.0 + squared,
            "nowhere": -1.0 - squared,
        }[self.shape]


@dataclass(frozen=True)
class Holed(po.ResistanceLaw):
    """A force that is undefined in a part of the plane."""

    x: Expression
    y: Expression
    problem: Problem

    label = "a law with holes"

    def reaction(self, at):
        del at
        force, beyond = self.problem.newtons(self.x, self.y, cos), self.problem.beyond(self.x, self.y)
        if self.problem.way == "declared":
            check_domain("distance beyond", beyond, at_most=0.0, why="there is a hole")
        if self.problem.way == "nan":
            force = where(beyond > 0.0, math.nan, force)
        if self.problem.way == "raised" and not is_symbolic(beyond) and beyond > 0.0:
            raise po.InputError("there is a hole")
        return po.SoilReaction(static=force)


def truth(problem):
    """Return the least force [kN] on a fine grid of the defined part, refined by SLSQP; None without such a part."""
    x, y = np.meshgrid(*[np.linspace(0.0, 1.0, 401)] * 2, indexing="ij")
    force = np.where(problem.beyond(x, y) <= 0.0, problem.newtons(x, y, np.cos), np.inf)
    if not np.any(np.isfinite(force)):
        return None
    found = []
    for k in np.argsort(force, axis=None)[:200:20]:
        if np.isfinite(force.flat[k]):
            refined = minimize(
                lambda at: problem.newtons(*at, np.cos) / 1e3, [x.flat[k], y.flat[k]], method="SLSQP",
                bounds=[(0.0, 1.0)] * 2, options={"ftol": 1e-14},
                constraints={"type": "ineq", "fun": lambda at: -problem.beyond(*at)},
            )  # fmt: skip
            if problem.beyond(*refined.x) <= 1e-9:
                found.append(refined.fun)
    return min([*found, float(force.min()) / 1e3])


def problems():
    rng = np.random.default_rng(SEED)
    return [Problem.random(shape, way, rng) for _ in range(EACH) for shape in SHAPES for way in WAYS]


@pytest.mark.parametrize("problem", problems(), ids=lambda one: f"{one.shape}-{one.way}")
def test_optimum_of_the_defined_part_or_an_honest_status(problem):
    def scene(x, y):
        return scene_of(medium=Holed(x, y, problem), motion=False)

    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    d.minimise(po.simulate(scene(x, y), 1.0).mean_draft / 1e3)
    expected = truth(problem)
    if expected is None:
        with pytest.raises(po.PloughError, match=r"a law with holes|distance beyond"):
            d.solve(judge="bare")
        return
    best = d.solve(judge="bare")
    at = best.variables["x"], best.variables["y"]
    # No answer lies outside of the domain, solved or not.
    assert po.simulate(scene(*at), 1.0).mean_draft / 1e3 == pytest.approx(best.objective, rel=1e-9)
    assert problem.beyond(*at) <= 0.0
    if best.status == "unconfirmed":
        assert problem.way != "declared"
        assert best.objective == pytest.approx(expected, rel=1e-2)
    else:
        assert best.objective == pytest.approx(expected, rel=1e-6)
    active = [name for name in best.active if "distance beyond" in name]
    assert bool(active) == (problem.way == "declared" and problem.beyond(*at) > -3e-9)
    skipped = [text for text in best.warnings if "could not be evaluated and were skipped" in text]
    holed = problem.shape not in ("everywhere", "nowhere")
    assert bool(skipped) == (holed and problem.way != "declared")


@dataclass(frozen=True)
class DefinedAbove40(po.ResistanceLaw):
    """A constant force that is undefined below 40 N."""

    newtons: Expression

    label = "a law with a hole"

    def reaction(self, at):
        del at
        if is_symbolic(self.newtons):
            return po.SoilReaction(static=where(self.newtons < 40.0, math.nan, self.newtons))
        return po.SoilReaction(static=math.nan if self.newtons < 40.0 else self.newtons)


def test_the_edge_of_a_hole_is_not_reported_as_a_bound():
    d, k = design(k=(50.0, 1.0, 200.0, "N"))
    d.minimise(po.simulate(scene_of(medium=DefinedAbove40(k)), 1.0).mean_draft)
    best = d.solve()
    limit = best.limits[0]
    assert best.variables["k"] == pytest.approx(40.0, rel=1e-6)
    assert (limit.active, limit.multiplier, limit.rounded) == (False, 0.0, best.variables["k"])
    assert "at its bound" not in str(best)
