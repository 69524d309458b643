"""Solve the study's problems and say how many answers are right, and what they took.

python tests/design/study_search.py --first 0 --count 60
python tests/design/study_search.py --only 3 17 --search thorough
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from independent import study
from independent.build import as_design, as_trade_off
from independent.problem import evaluate

import plough_opt as po


def main():
    """Print a line for each problem, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", default="search", help="search, edge, infeasible, front or surface")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of problems")
    parser.add_argument("--search", default="auto")
    given = parser.parse_args()
    known = study.problems(given.kind)
    numbers = given.only or [k for k in known if given.first <= k < given.first + given.count]
    rights, seconds = [], []
    for number in numbers:
        problem, truth = known[number]
        began, cpu = time.perf_counter(), time.process_time()
        text, right = _answer(problem, truth, given.search)
        took = time.perf_counter() - began
        rights.append(right)
        seconds.append(took)
        names = ", ".join(v.name for v in problem.variables)
        kind = "needle" if truth.get("needle") else ""
        own = time.process_time() - cpu
        print(
            f"{number:4d} {'right' if right else 'WRONG'} {len(problem.variables)} variables {took:6.2f} s"
            f" ({own:6.2f} s cpu, judging included) {text} {kind} [{names}]",
            flush=True,
        )
    wrong = [number for number, right in zip(numbers, rights, strict=True) if not right]
    print(
        f"{sum(rights)} of {len(rights)} right; seconds: median {np.median(seconds):.2f}, most {max(seconds):.2f};"
        f" wrong: {wrong}"
    )


def _front(problem, truth, search):
    began = time.perf_counter()
    design, goals = as_trade_off(problem, truth["names"])
    try:
        front = po.trade_off(design, *goals, points=study.POINTS[len(goals)], search=search)
    except Exception as error:  # whatever goes wrong is an answer, too
        return f"{type(error).__name__}: {str(error)[:150]}", False
    took = time.perf_counter() - began
    v = study.judge_front(problem, truth, front)
    return f"front of {len(front.points)} points in {took:.2f} s: {v} {' / '.join(truth['names'])}", v.right


def _answer(problem, truth, search):
    if "names" in truth:
        return _front(problem, truth, search)
    began = time.perf_counter()
    try:
        best = as_design(problem)[0].solve(search=search)
    except po.InfeasibleDesign as error:
        if "shortfall" not in truth:
            return f"refused: {str(error)[:150]}", False
        excess, right = study.judge_shortfall(problem, truth, error.conflicts)
        return f"solve {time.perf_counter() - began:.2f} s, excess of the shortfall {excess:+.1e}", right
    except Exception as error:  # whatever goes wrong is an answer, too
        return f"{type(error).__name__}: {str(error)[:150]}", False
    took = time.perf_counter() - began
    if "shortfall" in truth:
        y = problem.positions([[best.variables[v.name] for v in problem.variables]])
        return f"solved, though {truth['shortfall']:.2g} is lacking, {evaluate(problem, y).worst[0]:.2g} here", False
    v = study.judge(problem, truth, best.variables)
    tied = ""
    if v.tied:
        tied = f" (tied over the tolerances: excess {v.excess:+.1e}, median {v.median_excess:+.1e})"
        best = as_design(problem)[0].solve(search=search, judge="bare")
        v = study.judge(problem, truth, best.variables)
    median = "" if np.isnan(v.median_excess) else f" median {v.median_excess:+.1e}"
    return f"solve {took:.2f} s, excess {v.excess:+.1e}{median} violation {v.violation:.0e}{tied}", v.right


if __name__ == "__main__":
    main()
