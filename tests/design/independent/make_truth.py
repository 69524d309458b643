"""Generate the study's problems and their truths.

    nice -n 10 python tests/design/independent/make_truth.py search --count 300 --processes 2

writes `search_problems.json` beside this file. Existing problems are kept, so that an interrupted run can continue;
delete the file to start afresh. A problem takes about ten seconds. A C compiler is needed.
"""

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

# The matrices are so small that threads would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from independent import edges, fronts, study, surfaces, truth
from independent.generate import draw


def search(seed):
    """Return the problem of a seed and its truth."""
    problem = draw(seed)
    return {"problem": problem.plain(), "truth": truth.truth_of(problem)}


KINDS = {
    "search": search,
    "edge": edges.edge,
    "infeasible": edges.infeasible,
    "front": fronts.front,
    "surface": surfaces.surface,
}


def main():
    """Add the missing problems to a kind's file, one on each line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=sorted(KINDS))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    path = study.path_of(given.kind)
    known = study.read_lines(path) if path.exists() else {}
    missing = [seed for seed in range(given.count) if seed not in known]
    with ProcessPoolExecutor(given.processes) as pool:
        for seed, line in zip(missing, pool.map(KINDS[given.kind], missing), strict=True):
            known[seed] = json.dumps(line, separators=(",", ":"))
            text = ",\n".join(f'"{k}": {known[k]}' for k in sorted(known))
            path.write_text("{\n" + text + "\n}\n", encoding="utf-8")
            print(seed, end=" ", flush=True)


if __name__ == "__main__":
    main()
