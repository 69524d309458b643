"""The best is the best: random problems, catalogues and fronts, against truths from independent code.

The problems and their truths are in `independent/*_problems.json`, which `independent/make_truth.py` and
`independent/catalogues.py` make. An answer is right if it meets the requirements and is as good as the truth, bare or
over the tolerance box: see `independent/study.py`.
"""

from itertools import pairwise

import numpy as np
import pytest
from independent import catalogues, study
from independent.build import as_design, as_trade_off, verdict_on
from independent.fronts import objectives_of
from independent.problem import Limit, Problem, Variable, box_sample, evaluate, measure
from independent.truth import sample

import plough_opt as po

# Problems that are solved by default, of each number of variables those that take the least time; all are with the slow
# tests. Of the hardly feasible ones some whose objective falls steeply beyond the edge, and of the infeasible ones some
# whose largest deflection or force has its least value at a kink.
DEFAULT = {
    "search": (
        2, 6, 10, 16, 22, 25, 31, 35, 39, 50, 58, 70, 90, 97, 102, 110, 112, 115, 118, 133, 143, 147, 151, 155, 162,
        164, 168, 171, 188, 193,
    ),
    "edge": (5, 8),
    "infeasible": (7, 13),
}  # fmt: skip
# Problems in one test: the runner's processes share the tests.
BLOCK = 3
KNOWN = {kind: study.problems(kind) for kind in DEFAULT}


def _blocks(kind):
    numbers = sorted(KNOWN[kind])
    blocks = []
    for by_default, marks in ((True, ()), (False, pytest.mark.slow)):
        own = [number for number in numbers if (number in DEFAULT[kind]) == by_default]
        for begin in range(0, len(own), BLOCK):
            block = own[begin : begin + BLOCK]
            blocks.append(pytest.param(block, id="-".join(map(str, block)), marks=marks))
    return blocks


def _misses(kind, numbers):
    """Return the verdicts, or in words why there is none, on answers that are wrong."""
    verdicts = {number: verdict_on(*KNOWN[kind][number]) for number in numbers}
    return {number: own for number, own in verdicts.items() if not getattr(own, "right", False)}


@pytest.mark.parametrize("numbers", _blocks("search"))
def test_the_best_is_found(numbers):
    assert _misses("search", numbers) == {}


@pytest.mark.parametrize("numbers", _blocks("edge"))
def test_designs_beside_the_edge_of_the_feasible_are_found(numbers):
    assert _misses("edge", numbers) == {}


@pytest.mark.parametrize("numbers", _blocks("infeasible"))
def test_refusals_state_the_least_shortfall(numbers):
    assert _misses("infeasible", numbers) == {}


@pytest.mark.parametrize("kind", ["search", "edge"])
def test_truths_are_what_the_simulator_says(kind):
    for number in sorted(KNOWN[kind])[:3]:
        problem, truth = KNOWN[kind][number]
        found = evaluate(problem, problem.positions([truth["design"]]))
        # Positions take the logarithm of a stiffness and back; the objective keeps twelve digits.
        assert found.objective[0] == pytest.approx(truth["objective"], rel=1e-10)
        assert found.worst[0] <= 1e-8


# --- catalogues, every combination of which was optimised ---------------------------------------------------


PROBLEMS = catalogues.problems()
# One that takes a second; the rest take half a minute.
QUICK = (6,)


@pytest.mark.parametrize(
    "number", [number if number in QUICK else pytest.param(number, marks=pytest.mark.slow) for number in PROBLEMS]
)
def test_no_combination_of_the_catalogue_is_better(number):
    problem, offered, truth = PROBLEMS[number]
    best = as_design(problem)[0].solve(search="near", judge="bare")
    found = best.rounded(offered)
    y = problem.positions([[found.variables[v.name] for v in problem.variables]])
    seen = evaluate(problem, y)
    assert seen.worst[0] <= study.RELATIVE
    assert (seen.objective[0] - truth["objective"]) / abs(truth["objective"]) <= study.RELATIVE
    assert found.screened == np.prod([len(values) for values in offered.values()])


# --- fronts of two objectives and of three, by brute force --------------------------------------------------


# Of a range: straight lines between the points of a curve lie so little beside what is curved between them.
BESIDE = 2e-3
# Some that take little time; of the curves one has a dip of the force that is a part of the front by itself.
FRONTS_BY_DEFAULT = {"front": (5, 6), "surface": ()}
FRONTS = {(kind, number): case for kind in FRONTS_BY_DEFAULT for number, case in study.problems(kind).items()}


def case(kind, number):
    """Return a parameter with its marks."""
    marks = [] if number in FRONTS_BY_DEFAULT[kind] else [pytest.mark.slow]
    return pytest.param(kind, number, marks=marks, id=f"{kind} {number}")


def drawn(front):
    """Return points of a curve, and of the straight lines between neighbours."""
    rows = [front.objectives]
    for part in front.parts:
        for a, b in pairwise(front.objectives[list(part)]):
            rows.append(a + np.linspace(0.0, 1.0, 50)[:, None] * (b - a))
    return np.vstack(rows)


@pytest.mark.parametrize(("kind", "number"), [case(*key) for key in sorted(FRONTS)])
def test_the_whole_front_is_found(kind, number):
    problem, truth = FRONTS[kind, number]
    design, goals = as_trade_off(problem, truth["names"])
    front = po.trade_off(design, *goals, points=study.POINTS[len(goals)])
    verdict = study.judge_front(problem, truth, front)
    assert verdict.right, (verdict, front.failures)
    assert np.all(np.isfinite(front.objectives))
    if len(goals) == 2:
        wanted = np.array(truth["objectives"])
        behind = (drawn(front)[:, None, :] - wanted[None, :, :]) / np.ptp(wanted, axis=0)
        assert np.max(np.min(np.max(behind, axis=2), axis=0)) <= BESIDE


# --- conflicts that are there, and conflicts that are not ---------------------------------------------------


# Of a range: by so much a design of the sample may be better.
BEATEN = 1e-3
_NEEDLE = 0.05


def mount(variables, limits, *, chisel, speed, damping, mass=0.0, **others):
    """Return a problem of a share under a wave, from equilibrium."""
    fixed = {"chisel angle": chisel, "tow speed": speed, "damping": damping, "ramp time": 0.0, "frame mass": mass}
    fixed = {k: v for k, v in fixed.items() if k not in [own.name for own in variables]}
    names = {"force_rms": 1.0, "mean_deflection": 1.0}
    return Problem("mount", fixed=fixed, variables=variables, limits=limits, objective=names, **others)


ANGLE = Variable("wedge angle", np.radians(5.0), np.radians(60.0), np.radians(25.0), False)
HEIGHT = Variable("height", 0.1, 0.5, 0.25, False)
FLAT = Limit("half angle", "at_most", np.radians(15.0))


def test_no_conflict_is_said_only_where_needles_alone_conflict():
    problem = mount(
        (ANGLE, HEIGHT, Variable("stiffness", 2e4, 5e6, 1e5, True)),
        (Limit("loosened radius", "at_least", 0.14), FLAT),
        soil=(1600.0, 0.914, 35e3, np.radians(32.0), 0.5, 101325.0),
        chisel=np.radians(12.0), speed=1.2, wave=(0.4, 0.25), damping=100.0, mass=60.0,
    )  # fmt: skip
    design, run = as_design(problem)
    front = po.trade_off(design, po.Goal("deflection", run.mean_deflection), po.Goal("force", run.force_rms))
    best = np.array(front.points[0].objectives)
    assert len(front.points) == 1
    assert front.notes[0] == "'deflection' and 'force' do not conflict: one design is best in both"
    y = sample(problem, 15, np.random.default_rng(0))
    y = np.vstack([y, problem.positions([[0.6545926, 0.1692840, 20000.0]])])
    found = objectives_of(problem, ("mean_deflection", "force_rms"), y)
    assert np.all(found[:, 0] >= best[0] * (1.0 - BEATEN))
    less = np.flatnonzero(found[:, 1] < best[1] * (1.0 - BEATEN))
    assert len(less) > 0
    for k in less:
        box = measure(problem, box_sample(problem, y[k], 64), 1.6)["force_rms"]
        assert np.median(box) > found[k, 1] * (1.0 + _NEEDLE)


@pytest.mark.slow
def test_more_mass_on_a_softer_mount_conflicts():
    problem = mount(
        (ANGLE, HEIGHT, Variable("stiffness", 1e4, 1e6, 1e5, True), Variable("frame mass", 10.0, 120.0, 50.0, False)),
        (FLAT, Limit("loosened radius", "at_least", 0.1), Limit("mean_deflection", "at_most", 0.06)),
        soil=(1300.0, 0.722, 5e3, np.radians(30.0), 0.4, 5e3),
        chisel=np.radians(10.0), speed=1.5, wave=(0.3, 0.4), damping=150.0, duration=1.5, steel=False,
    )  # fmt: skip
    design, run = as_design(problem)
    (mass,) = [v.symbol for v in design.declared.variables if v.name == "frame mass"]
    front = po.trade_off(design, po.Goal("force", run.force_rms), po.Goal("mass", mass))
    found = objectives_of(problem, ("force_rms", "mean_deflection"), sample(problem, 15, np.random.default_rng(0)))
    least = front.points[0]
    assert least.variables["frame mass"] == pytest.approx(120.0)
    assert least.objectives[0] <= np.min(found[:, 0])
    assert len(front.points) > 20
