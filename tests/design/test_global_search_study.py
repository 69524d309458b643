"""Searches, catalogues and fronts on random problems, compared with truths from independent code.

The problems and their truths are in `independent/*_problems.json`; `independent/truth.py` finds a truth again.
`reproduction_problems.json` holds problems on which searches have gone wrong. An answer is right if it meets the
requirements and is as good as the truth, bare or over the tolerance box: see `independent/study.py`.
"""

from itertools import pairwise

import numpy as np
import pytest
from independent import study, truth
from independent.build import as_design, verdict_on
from independent.problem import box_sample, evaluate, measure, objectives_of, sign_of

import plough_opt as po

# Problems that are solved by default; the slow tests solve all, of up to eight variables. The search problems cover all
# starts and kinds of limits. In the edge problems the objective falls steeply beyond the edge; in the infeasible ones
# the largest deflection or force is least at a kink.
DEFAULT = {
    "search": (112, 162, 164, 25, 102, 39, 143, 151, 155, 6),
    "edge": (5, 8),
    "infeasible": (7,),
    "reproduction": (2, 5),
}
# Problems in one test: the runner's processes share the tests.
BLOCK = 3
KNOWN = {kind: {k: own for k, own in study.problems(kind).items() if own[1]} for kind in DEFAULT}


# By default each problem is solved with one of these seeds, by its number; the slow tests solve all problems with all.
SEEDS = range(5)


def _blocks():
    """Yield kinds, numbers of problems and shifts of their seeds."""
    for kind, default in DEFAULT.items():
        for shift in SEEDS:
            rest = sorted(KNOWN[kind].keys() - (set() if shift else set(default)))
            for numbers, marks in (((), ()) if shift else (default, ()), (rest, pytest.mark.slow)):
                for begin in range(0, len(numbers), BLOCK):
                    block = numbers[begin : begin + BLOCK]
                    name = f"{kind} {'-'.join(map(str, block))} shift {shift}"
                    yield pytest.param(kind, block, shift, id=name, marks=marks)


def seed_of(number, shift=0):
    return SEEDS[(number + shift) % len(SEEDS)]


@pytest.mark.parametrize(("kind", "numbers", "shift"), [*_blocks()])
def test_the_best_or_the_least_shortfall_is_found(kind, numbers, shift):
    verdicts = {number: verdict_on(*KNOWN[kind][number], seed=seed_of(number, shift)) for number in numbers}
    assert {number: own for number, own in verdicts.items() if not getattr(own, "right", False)} == {}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "number"), [("search", 22), ("edge", 6), ("infeasible", 7)])
def test_a_truth_is_found_again(kind, number):
    problem, known = KNOWN[kind][number]
    wanted = known["shortfall" if kind == "infeasible" else "objective"]
    assert truth.optima(problem, giving=kind == "infeasible")[1][0] == pytest.approx(wanted, rel=1e-7)


# --- catalogues of which every combination was optimised ------------------------------------------------------


PROBLEMS = study.problems("catalogue")
# One that takes a second; the rest take half a minute.
QUICK = (6,)


def _cases(numbers, quick, kind=()):
    """Return problems with all seeds, of which the quick ones with the seed of their number are not slow."""
    return [
        pytest.param(
            *kind,
            number,
            seed,
            marks=[] if number in quick and seed == seed_of(number) else [pytest.mark.slow],
            id=f"{' '.join((*kind, str(number)))} seed {seed}",
        )
        for number in numbers
        for seed in SEEDS
    ]


@pytest.mark.parametrize(("number", "seed"), _cases(PROBLEMS, QUICK))
def test_no_combination_of_the_catalogue_is_better(number, seed):
    problem, truth, offered = PROBLEMS[number]
    best = as_design(problem)[0].solve(search="near", judge="bare", seed=seed)
    found = best.rounded(offered)
    y = problem.positions([[found.variables[v.name] for v in problem.variables]])
    seen = evaluate(problem, y)
    assert seen.worst[0] <= study.RELATIVE
    assert (seen.objective[0] - truth["objective"]) / abs(truth["objective"]) <= study.RELATIVE
    assert found.screened == np.prod([len(values) for values in offered.values()])


@pytest.mark.slow
def test_the_best_combination_of_a_catalogue_is_found_again():
    problem, known, offered = PROBLEMS[6]
    objective, values = truth.best_of_catalogue(problem, offered)
    assert objective == pytest.approx(known["objective"], rel=1e-7)
    assert list(values) == known["values"]


# --- fronts of two objectives and of three, by brute force --------------------------------------------------


# The straight lines between neighbouring points deviate from the curve by at most this fraction of a range, but on four
# curves, where they cut a bend, or the corner where a branch begins (9), halfway between two of 40 points.
BESIDE = 2e-3
BESIDE_A_BEND = {9: 4.6e-3, 14: 2.2e-3, 29: 2.1e-3, 30: 2.3e-3}
# One that takes little time. In one of 5 and 6 a dip of the force is a part of the front by itself; among the slow ones
# part of 22 is found by predictions of second order only, and part of 8 by crossing branches only.
FRONTS_BY_DEFAULT = {"front": (5,), "surface": ()}
FRONTS = {(kind, number): case for kind in FRONTS_BY_DEFAULT for number, case in study.problems(kind).items()}


def drawn(front):
    """Return points of a curve, and of the straight lines between neighbours."""
    rows = [front.objectives]
    for part in front.parts:
        for a, b in pairwise(front.objectives[list(part)]):
            rows.append(a + np.linspace(0.0, 1.0, 50)[:, None] * (b - a))
    return np.vstack(rows)


@pytest.mark.parametrize(
    ("kind", "number", "seed"),
    [case for kind, quick in FRONTS_BY_DEFAULT.items() for case in _cases(study.problems(kind), quick, (kind,))],
)
def test_the_whole_front_is_found(kind, number, seed):
    problem, truth = FRONTS[kind, number]
    design, run, geometry = as_design(problem)
    goals = [
        po.Goal(name, geometry[name] if name in geometry else getattr(run, name), maximise=sign_of(name) < 0.0)
        for name in truth["names"]
    ]
    front = po.trade_off(design, *goals, points=study.POINTS[len(goals)], seed=seed)
    verdict = study.judge_front(problem, truth, front)
    assert verdict.right, (verdict, front.failures)
    assert np.all(np.isfinite(front.objectives))
    if len(goals) == 2:
        wanted = np.array(truth["objectives"])
        behind = (drawn(front)[:, None, :] - wanted[None, :, :]) / np.ptp(wanted, axis=0)
        assert np.max(np.min(np.max(behind, axis=2), axis=0)) <= BESIDE_A_BEND.get(number, BESIDE)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "number", "row"), [("front", 6, 16), ("surface", 0, 0)])
def test_a_point_of_a_front_is_the_optimum_that_its_other_objectives_leave(kind, number, row):
    problem, known = study.problems(kind)[number]
    *others, last = known["objectives"][row]
    found = truth.least_of(problem, known["names"][-1], dict(zip(known["names"], others, strict=False)))
    size = np.ptp(np.array(known["objectives"])[:, -1])
    # The sample of a surface leaves more than that of a curve.
    assert found == pytest.approx(last, abs=(1e-6 if kind == "front" else 1e-4) * size)


# --- conflicts that exist, and conflicts that do not ----------------------------------------------------------


# A design of the sample may be better by this fraction of a range.
BEATEN = 1e-3
NEEDLE = 0.05
HARDPAN, FREE_MASS = (study.problems("reproduction")[number][0] for number in (0, 6))


@pytest.mark.slow
def test_objectives_do_not_conflict_if_only_needles_do():
    design, run, _ = as_design(HARDPAN)
    front = po.trade_off(design, po.Goal("deflection", run.mean_deflection), po.Goal("force", run.force_rms))
    best = np.array(front.points[0].objectives)
    assert len(front.points) == 1
    assert front.notes[0] == "'deflection' and 'force' do not conflict: one design is best in both"
    y = truth.sample(HARDPAN, 15, np.random.default_rng(0))
    y = np.vstack([y, HARDPAN.positions([[0.6545926, 0.1692840, 20000.0]])])
    found = objectives_of(HARDPAN, ("mean_deflection", "force_rms"), y)
    assert np.all(found[:, 0] >= best[0] * (1.0 - BEATEN))
    less = np.flatnonzero(found[:, 1] < best[1] * (1.0 - BEATEN))
    assert len(less) > 0
    for k in less:
        box = measure(HARDPAN, box_sample(HARDPAN, y[k], 64), 1.6)["force_rms"]
        assert np.median(box) > found[k, 1] * (1.0 + NEEDLE)


@pytest.mark.slow
def test_more_mass_on_a_softer_mount_conflicts():
    design, run, _ = as_design(FREE_MASS)
    (mass,) = [v.symbol for v in design.declared.variables if v.name == "frame mass"]
    front = po.trade_off(design, po.Goal("force", run.force_rms), po.Goal("mass", mass))
    y = truth.sample(FREE_MASS, 15, np.random.default_rng(0))
    found = objectives_of(FREE_MASS, ("force_rms", "mean_deflection"), y)
    least = front.points[0]
    assert least.variables["frame mass"] == pytest.approx(120.0)
    assert least.objectives[0] <= np.min(found[:, 0])
    assert len(front.points) > 20
