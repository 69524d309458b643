"""The search for the global optimum: its extent, record and steps; conflicts, holes and unconfirmed optima."""

import dataclasses
import math
import re
import time
from dataclasses import dataclass
from unittest.mock import Mock

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import scene_of
from helpers.small_designs import design, sticking
from scipy.optimize import minimize
from scipy.stats.qmc import Sobol, discrepancy

import plough_opt as po
from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import is_symbolic, where
from plough_opt.design import confirmation
from plough_opt.design.confirmation import boxes
from plough_opt.design.model import ipopt, population, program, tight_integration
from plough_opt.design.search import effort
from plough_opt.design.search.landscape import even_points
from plough_opt.expressions import Expression, cos


@pytest.fixture
def waves():
    """A design whose objective has four basins in x on [0, 1], the deepest at the left."""
    d, x, y = design(x=(0.9, 0.0, 1.0), y=(0.9, -1.0, 1.0))
    d.minimise(3.0 + x + ca.sin(20.0 * x) + (y - 0.25) ** 2)
    return d


def _basins():
    """Return the minima of x + sin(20 x) inside [0, 1], where 20 cos(20 x) = -1 and the slope rises."""
    return [(math.pi * (1 + 2 * k) + math.acos(1.0 / 20.0)) / 20.0 for k in range(3)]


# --- extent ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_all_basins_of_a_multimodal_objective_are_found(waves, seed):
    best = waves.solve(seed=seed)
    found = [optimum.variables["x"] for optimum in best.local_optima]
    # Over 1e-7 the objective changes by about 1e-12, which is the optimiser's accuracy.
    assert found[: len(_basins())] == pytest.approx(_basins(), abs=1e-7)
    assert [o.objective for o in best.local_optima] == sorted(o.objective for o in best.local_optima)
    assert best.name == "optimum 1"
    assert best.search.variables == ("x", "y")
    assert best.search.basins >= len(_basins())
    assert best.search.basins >= best.search.reached >= 2
    assert best.search.followed >= best.search.reached


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 2, 3, 4, 5))])
def test_ripples_over_a_small_feasible_region_are_searched_in_every_way(seed):
    d, x0, *others = design(**{f"x{k}": (0.3, 0.0, 1.0) for k in range(5)})
    offsets = ca.vertcat(*others) - np.array([0.513, 0.583, 0.653, 0.723])
    waves = 1.0
    for offset in ca.vertsplit(offsets):
        waves *= ca.cos(2.0 * math.pi * (offset + 0.3 * x0) / 0.02)
    d.minimise(1.0 + x0 + ca.sumsqr(offsets) + 0.02 * (1.0 - waves))
    # A ball that contains one design in 5000.
    d.require("ball", ca.sumsqr(offsets), at_most=0.08**2)
    # A higher ripple is found without boxes around the best, translations between ripples, or the scan for dips.
    assert d.solve(seed=seed).objective == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(("search", "most", "basin"), [("near", 1.0, 2), ("local", 1.0, 2), ("near", 0.7, 1)])
def test_a_near_search_stays_in_the_basin_of_its_guess_or_of_the_nearest_feasible_design(waves, search, most, basin):
    waves.require("most", waves.declared.variables[0].symbol, at_most=most)
    best = waves.solve(search=search)
    # The guess lies beyond the last barrier, where the objective falls towards the third minimum. At 0.7 it falls
    # towards the second.
    assert best.variables["x"] == pytest.approx(_basins()[basin], abs=1e-7)
    assert len(best.local_optima) == 1
    assert (best.search.designs, best.search.variables) == (0, ())
    assert str(best.search) == "Only the basin of the guess was searched."


REGIONS = [
    # A local search leads to the narrow region, into which no design of a sample falls.
    (lambda x, _: ca.fmin((x - 0.75) ** 2 - 1e-9, x - 0.3), 0.75 + 1e-9**0.5, 0.25),
    # It leads to the far region.
    (lambda x, _: ca.fmin(100.0 * ((x - 0.75) ** 2 - 1e-3), x - 0.3), 0.75 + 1e-3**0.5, 0.25),
    # It leads nowhere, and no design of a sample falls into the only region, a circle whose rim is lowest here.
    (lambda x, y: ca.fmin(0.1, (x - 0.1) ** 2 + (y + 0.5) ** 2 - 1e-6), 0.1 + 9.8e-4, -0.5 + 2e-4),
]


@pytest.mark.parametrize(("either", "x", "y"), REGIONS)
def test_of_two_feasible_regions_a_near_search_takes_the_nearest(waves, either, x, y):
    waves.require("either", either(*(v.symbol for v in waves.declared.variables)), at_most=0.0)
    assert waves.solve(search="near").variables == pytest.approx({"x": x, "y": y}, abs=2e-5)


def test_a_near_search_is_never_worse_than_a_guess_whose_run_has_events():
    d, x = design(x=(0.0, 0.0, 1.0))
    # IPOPT first moves away from a bound, and thereby leaves the deeper basin at this bound.
    d.minimise(2.0 + 4.0 * (x - 0.9) ** 2 - 4.0 * ca.exp(-((x / 0.003) ** 2)) + 1e-9 * sticking(x))
    assert d.solve(search="near").variables["x"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("search", ["x", ("x",), ["x"]])
def test_only_a_named_variable_is_sampled(waves, search):
    best = waves.solve(search=search)
    assert best.search.variables == ("x",)
    assert np.ptp(best.search.values[:, 0]) == 1.0
    assert best.search.values[:, 1] == pytest.approx(0.9, rel=1e-15)  # its guess
    assert best.variables["x"] == pytest.approx(_basins()[0], abs=1e-7)


def test_a_number_of_designs_and_a_time_are_respected(waves):
    many = waves.solve(search=30_000).search
    assert 30_000 <= many.designs < 60_000
    began = time.perf_counter()
    waves.solve(search="0.5 s")
    assert time.perf_counter() - began > 0.5


@pytest.mark.parametrize("objective", [None, sticking])
@pytest.mark.parametrize("search", ["auto", "thorough"])
def test_an_automatic_search_without_time_names_what_it_left_out(waves, monkeypatch, objective, search):
    if objective is not None:
        waves, x = design(x=(0.9, 0.0, 1.0))
        waves.minimise(objective(x))
    monkeypatch.setattr(effort, "AUTO_SECONDS", 0.0)
    best = waves.solve(search=search)
    told = " ".join(best.warnings)
    left_out = ["sample"] if objective is sticking else ["descents from low designs", "closer look"]
    for part in [*left_out, "processor time"]:
        assert (part in told) == (search == "auto")
    assert np.isfinite(best.objective)
    assert (best.search.designs < 100) == (search == "auto" and objective is sticking)


def test_the_same_search_gives_the_same_bits(r1, build_r1, monkeypatch):
    again = r1.design.solve()
    # More processors, and less memory for the results of a call.
    monkeypatch.setattr(population, "available", lambda: 3)
    monkeypatch.setattr(population, "_MOST_RESULTS", 1000)
    for other in (again, build_r1().design.solve()):
        assert other.local_optima == r1.best.local_optima
        np.testing.assert_array_equal(other.search.objective, r1.best.search.objective)


# --- record -------------------------------------------------------------------------------------------------


def test_the_expected_number_of_unseen_basins(r1):
    search = r1.best.search
    n, w = search.followed, search.reached
    assert n > w + 2
    assert search.unseen_basins == pytest.approx(w * (w + 1) / (n - w - 2), rel=1e-15)
    assert search.unseen_volume == pytest.approx(w * (w + 1) / (n * (n - 1)), rel=1e-15)
    assert "Boender" in str(search)
    few = dataclasses.replace(search, followed=w + 2, basins=9)
    assert few.unseen_basins is None
    assert f"9 basins found, of which the {search.polished} that could be best were optimised" in str(few)
    assert "cannot be estimated" in str(few)


def test_progress_names_the_sample_and_the_basins(waves):
    told = []
    waves.solve(progress=lambda stage, fraction: told.append((stage, fraction)))
    stages = [stage for stage, _ in told]
    assert (stages[0], stages[-1]) == ("preparing the model", "checking")
    assert "trying 2048 designs" in stages
    assert any(stage.startswith("optimising basin 1 of") for stage in stages)
    assert all(0.0 <= fraction <= 1.0 for _, fraction in told)


# --- steps of integration ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seconds", [1e6, 1e-9])
def test_steps_are_refined_until_the_objective_is_right(monkeypatch, build_r1, seconds):
    build_nlp = Mock(wraps=program.build_nlp)
    monkeypatch.setattr(program, "build_nlp", build_nlp)
    # Quadratic programs find the optimum. Without time to solve it again, it is evaluated by the finer steps.
    monkeypatch.setitem(ipopt.FROM_BOTTOM, "ipopt.max_cpu_time", seconds)
    monkeypatch.setattr(tight_integration.Steps, "phase_per_step", 2.5)
    # The tolerance on derivatives is loose, because they would demand more steps at the start already.
    best = build_r1(accuracy=po.Accuracy(derivatives=0.1)).design.solve()
    steps = [call.args[3][0] for call in build_nlp.call_args_list]
    assert len(steps) > 1
    assert steps == sorted(steps)
    assert all(optimum.gap <= 1e-8 for optimum in best.local_optima)
    assert best.objective == pytest.approx(0.8250057092, rel=2e-10)
    assert not any("not reached" in warning for warning in best.warnings)


# With the fewest steps the optimiser's objective has no value.
LIMITS = [{"refinements": 0}, {"steps": 60}, {"steps": 24}]


@pytest.mark.parametrize("limit", LIMITS)
def test_steps_that_stay_too_coarse_are_reported(monkeypatch, build_r1, limit):
    monkeypatch.setattr(tight_integration.Steps, "phase_per_step", 40.0)
    monkeypatch.setattr(tight_integration.Steps, "most", limit.get("steps", 50_000))
    monkeypatch.setattr(confirmation, "_MOST_REFINEMENTS", limit.get("refinements", 4))
    best = build_r1().design.solve(search="local")
    assert not best.gap <= 1e-8
    assert any("was not reached" in warning for warning in best.warnings)


def test_coarse_steps_that_the_user_chose_show_in_the_gap(build_r1):
    coarse = build_r1(accuracy=po.Accuracy("dop853", steps=20), outputs=20, guess=(25.0, 0.25, 5e3))
    best = coarse.design.solve(search="local")
    methods = (po.Accuracy("dop853", steps=steps) for steps in (1000, 20))
    runs = (po.simulate(best(coarse.scene), 2.0, outputs=1, accuracy=method) for method in methods)
    tight, seen = ((run.mean_draft + run.force_rms) / 1e3 for run in runs)
    # The objective comes from a tight integration; the gap is its difference from what the optimiser saw.
    assert best.objective == pytest.approx(tight, rel=1e-9)
    assert best.gap > 1e-6
    assert best.gap == pytest.approx(abs(seen - tight) / tight, rel=1e-6)
    assert best.error_estimate < 1e-10


def test_an_objective_of_zero_needs_no_relative_accuracy(r1_scene, r1_wave):
    d, height = design(height=(0.25, 0.2, 0.4, "m"))
    run = po.simulate(r1_scene(height=height, strength_wave=r1_wave), 0.5, outputs=5)
    d.minimise((run.mean_draft / 600.0 - 1.0) ** 2)
    best = d.solve()
    # The objective is zero except for rounding, so that a relative difference is meaningless.
    assert best(run.mean_draft) == pytest.approx(600.0, rel=1e-7)
    assert not any("not reached" in warning for warning in best.warnings)


@pytest.mark.parametrize("run", [ca.sqrt, sticking])
def test_designs_that_cannot_be_evaluated_are_skipped(run):
    d, x, y = design(x=(0.9, 0.0, 1.0), y=(0.9, 0.0, 1.0))
    # Near y = 0.2 the run has no value either, and its bounds do not show it.
    d.minimise((ca.log(x - 0.5) + 1.0) ** 2 + (y - 0.5) ** 2 + 1e-9 * run(ca.sqrt((y - 0.2) ** 2 - 0.01)))
    best = d.solve()
    assert best.variables["x"] == pytest.approx(0.5 + math.exp(-1.0), abs=1e-6)
    assert np.any(np.isnan(best.search.objective))
    assert np.all(np.isinf(best.search.violation[np.isnan(best.search.objective)]))


# --- stiff undamped mounts: even few steps must keep their amplitude -----------------------------------------


def test_few_steps_and_the_spread_over_tolerances_agree_with_exact_runs():
    share = po.Wedge(po.deg(25), po.deg(15), 0.25)

    def rms(stiffness):
        effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6), start="towed")
        scene = po.Scene(po.named_soil("firm sandy loam"), share, stiffness, 6.0, 1.5, effects)
        return po.simulate(scene, 0.5).force_rms

    d, k0 = design(stiffness=(1e6, 8e5, 5e7, "N/m", True))
    d.minimise(rms(k0))
    best = d.solve()
    # A run covers 200 to 1400 rad. Steps in proportion to the phase alone lost up to 20 % of the RMS.
    chosen = np.linspace(0, len(best.search.values) - 1, 8).astype(int)
    exact = [rms(float(stiffness)) for stiffness in best.search.values[chosen, 0]]
    assert best.search.objective[chosen] == pytest.approx(exact, rel=6e-3)
    (v,) = d.declared.variables
    box = boxes([v], np.array([[v.scaled(best.variables["stiffness"])]]))[:, 0]
    exact = [rms(float(v.unscaled(y))) for y in box]
    # Twice a search's steps leave an error of about 1e-5.
    assert best.spread.median == pytest.approx(np.median(exact), rel=3e-5)
    assert best.spread.worst == pytest.approx(np.max(exact), rel=3e-5)
    # The estimate is relative: the objective is about 1200 N.
    assert 0.0 < best.error_estimate < 1e-10


@pytest.mark.parametrize("n", [1, 3, 8])
def test_sampled_points_are_nearly_as_even_as_those_of_sobol(n):
    uneven = [discrepancy(even_points(n, 1024, np.random.default_rng(seed)), method="L2-star") for seed in range(5)]
    sobol = [discrepancy(Sobol(n, rng=np.random.default_rng(seed)).random(1024), method="L2-star") for seed in range(5)]
    random = discrepancy(np.random.default_rng(5).random((1024, n)), method="L2-star")
    assert np.mean(uneven) < min(random, 3.0 * np.mean(sobol))


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


@pytest.mark.parametrize("seed", range(3))
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
    # The end of a model, for one, is not reported as a bound.
    assert best.active == ()
    assert all(limit.multiplier == 0.0 for limit in best.limits)
    assert "at its bound" not in str(best)


def test_noise_is_not_exploited():
    size, frequency = 1e-3, 1e7
    d, symbol = design(x=(0.1, 0.0, 1.0))
    d.minimise(1.0 + symbol + size * ca.sin(frequency * symbol))
    best = d.solve()
    # Whichever dip of the noise is found.
    assert best.variables["x"] == pytest.approx(0.0, abs=2e-3)
    assert best.objective <= 1.0
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
            d.solve()
        return
    best = d.solve()
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


@pytest.mark.parametrize("slope", [1.0, 0.01, 1e-4])
def test_every_bound_in_conflict_is_named_however_little_it_helps(slope):
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    d.minimise(x + y)
    d.require("sum", 1.0 + x + slope * y * y, at_least=4.0)
    with pytest.raises(po.InfeasibleDesign, match="upper bound 1 of 'x' and upper bound 1 of 'y'"):
        d.solve()
