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
from independent.build import verdict_on


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
    wrong, seconds = [], []
    for number in numbers:
        problem, truth = known[number]
        began, cpu = time.perf_counter(), time.process_time()
        verdict = verdict_on(problem, truth, search=given.search)
        seconds.append(time.perf_counter() - began)
        right = getattr(verdict, "right", False)
        wrong += [] if right else [number]
        own, names = time.process_time() - cpu, ", ".join(v.name for v in problem.variables)
        print(
            f"{number:4d} {'right' if right else 'WRONG'} {seconds[-1]:6.2f} s ({own:6.2f} s cpu), judging included,"
            f" {str(verdict)[:200]} [{names}]",
            flush=True,
        )
    print(
        f"{len(numbers) - len(wrong)} of {len(numbers)} right; seconds: median {np.median(seconds):.2f}, most"
        f" {max(seconds):.2f}; wrong: {wrong}"
    )


if __name__ == "__main__":
    main()
