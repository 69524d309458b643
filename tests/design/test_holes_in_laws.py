"""Designs under a law that is undefined in a part of the box: an optimum where it is defined, or an honest status."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from helpers.scenes import scene_of
from helpers.small_designs import design
from scipy.optimize import minimize

import plough_opt as po
from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import is_symbolic, where
from plough_opt.expressions import Expression, cos

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
