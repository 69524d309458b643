"""The best is the best: random problems of one to eight variables, against truths from independent code.

The problems and their truths are in `independent/*_problems.json`, which `independent/make_truth.py` makes. An answer
is right if it meets the requirements and is as good as the truth, bare or over the tolerance box: see
`independent/study.py`.
"""

import pytest
from independent import study
from independent.build import as_design
from independent.problem import evaluate

import plough_opt as po

# Problems that are solved by default, of each number of variables those that take the least time; all are with the slow
# tests. Of the hardly feasible ones some whose objective falls steeply beyond the edge, and of the infeasible ones some
# whose largest deflection or force has its least value at a kink.
DEFAULT = {
    "search": (
        2, 5, 6, 7, 10, 11, 16, 20, 22, 23, 25, 28, 31, 34, 35, 36, 39, 47, 50, 55, 58, 66, 70, 87, 90, 94, 97, 99, 102,
        107, 110, 111, 112, 113, 115, 116, 118, 132, 133, 140, 143, 145, 147, 148, 151, 152, 155, 159, 162, 163, 164,
        166, 168, 170, 171, 175, 188, 189, 193, 198,
    ),
    "edge": (5, 8),
    "infeasible": (7, 13),
}  # fmt: skip
# Problems in one test: the runner's processes share the tests.
BLOCK = 3
# Number of a problem -> why its answer may be wrong; at most one in a hundred, and one of fewer.
EXPLAINED = {
    "search": {},
    "edge": {},
    "infeasible": {},
}
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


def _answer(problem, **how):
    """Return the optimum, or the error in its place."""
    try:
        return as_design(problem)[0].solve(**how)
    except po.PloughError as error:
        return error


@pytest.mark.parametrize("kind", sorted(DEFAULT))
def test_few_answers_need_an_explanation(kind):
    assert len(EXPLAINED[kind]) <= max(1, len(KNOWN[kind]) // 100)


def _without_explanation(kind, misses):
    return {number: miss for number, miss in misses.items() if number not in EXPLAINED[kind]}


def _misses(kind, numbers):
    misses = {}
    for number in numbers:
        problem, truth = KNOWN[kind][number]
        verdict = _verdict(problem, truth)
        if isinstance(verdict, study.Verdict) and verdict.tied:
            # Preferred for a median that 64 designs cannot tell from the truth's.
            verdict = _verdict(problem, truth, judge="bare")
        if not (isinstance(verdict, study.Verdict) and verdict.right):
            misses[number] = verdict
    return _without_explanation(kind, misses)


def _verdict(problem, truth, **how):
    """Return the verdict on the answer, or in words why there is none."""
    best = _answer(problem, **how)
    if isinstance(best, po.PloughError):
        return f"{type(best).__name__}: {best}"
    return study.judge(problem, truth, best.variables)


@pytest.mark.parametrize("numbers", _blocks("search"))
def test_the_best_is_found(numbers):
    assert _misses("search", numbers) == {}


@pytest.mark.parametrize("numbers", _blocks("edge"))
def test_designs_beside_the_edge_of_the_feasible_are_found(numbers):
    assert _misses("edge", numbers) == {}


@pytest.mark.parametrize("numbers", _blocks("infeasible"))
def test_refusals_state_the_least_shortfall(numbers):
    misses = {}
    for number in numbers:
        problem, truth = KNOWN["infeasible"][number]
        answer = _answer(problem)
        if not isinstance(answer, po.InfeasibleDesign):
            misses[number] = repr(answer)[:200]
        elif not (verdict := study.judge_shortfall(problem, truth, answer.conflicts))[1]:
            misses[number] = verdict
    assert _without_explanation("infeasible", misses) == {}


@pytest.mark.parametrize("kind", ["search", "edge"])
def test_truths_are_what_the_simulator_says(kind):
    for number in sorted(KNOWN[kind])[:3]:
        problem, truth = KNOWN[kind][number]
        found = evaluate(problem, problem.positions([truth["design"]]))
        # Positions take the logarithm of a stiffness and back; the objective keeps twelve digits.
        assert found.objective[0] == pytest.approx(truth["objective"], rel=1e-10)
        assert found.worst[0] <= 1e-8
