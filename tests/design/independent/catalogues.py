"""Random problems with catalogues for some variables, and their best combination by brute force.

python tests/design/independent/catalogues.py
"""

import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from independent import generate, truth
from independent.problem import Problem, evaluate

FILE = Path(__file__).with_name("catalogue_problems.json")
# Sample size of each combination as a power of 2, starts that are polished of each, and combinations polished.
_SAMPLE = 12
_STARTS = 6
_POLISHED = 12
_MOST_VARIABLES = 5
_LEAST_COMBINATIONS = 25


def problems():
    """Return problems, catalogues by variable, and truths, by number."""
    data = json.loads(FILE.read_text(encoding="utf-8"))
    return {int(k): (Problem.of_plain(v["problem"]), v["catalogues"], v["truth"]) for k, v in data.items()}


def catalogues_of(problem, random):
    """Return catalogues for one or two of a problem's variables; at least one variable remains free."""
    count = min(int(random.integers(1, 3)), len(problem.variables) - 1)
    chosen = random.choice(len(problem.variables), size=count, replace=False)
    found = {}
    for k in sorted(chosen):
        v = problem.variables[k]
        size = int(random.integers(5, 12)) if count > 1 else int(random.integers(25, 40))
        values = [float(f"{v.unscaled(y):.3g}") for y in random.random(size)]
        found[v.name] = sorted({x for x in values if v.lower <= x <= v.upper})
    return found


def held(problem, values):
    """Return a problem with some variables, by name, fixed at values."""
    left = tuple(v for v in problem.variables if v.name not in values)
    return replace(problem, variables=left, fixed={**problem.fixed, **values})


def truth_of(problem, catalogues):
    """Return the best objective and its catalogue values, or None if no combination is feasible."""
    looks = []
    for number, values in enumerate(itertools.product(*catalogues.values())):
        one = held(problem, dict(zip(catalogues, values, strict=True)))
        y = truth.sample(one, _SAMPLE, np.random.default_rng([number, 3]))
        worth = truth.Question().roughly(one, y)
        starts = truth.spread_starts(y, worth, _STARTS, 0.1)
        looks.append((float(np.min(worth)), values, one, starts))
    found = []
    for _, values, one, starts in sorted(looks, key=lambda look: look[0])[:_POLISHED]:
        ends = truth.polished(one, starts, phase=0.5)
        worth = truth.Question().worth(evaluate(one, ends, phase=0.5))
        found.append((float(np.min(worth)), values))
    objective, values = min(found)
    return {"objective": objective, "values": values} if objective < 1e6 else None


def main():
    """Write ten random problems and one with a narrow basin."""
    made = {}
    for seed in range(5000, 5200):
        problem = generate.draw(seed)
        random = np.random.default_rng([seed, 77])
        if not 2 <= len(problem.variables) <= _MOST_VARIABLES:
            continue
        catalogues = catalogues_of(problem, random)
        if np.prod([len(values) for values in catalogues.values()]) < _LEAST_COMBINATIONS:
            continue
        best = truth_of(problem, catalogues)
        if best is None:
            continue
        made[len(made)] = {"problem": problem.plain(), "catalogues": catalogues, "truth": best}
        print(seed, list(catalogues), len(problem.variables), best, flush=True)
        if len(made) == 10:
            break
    # The best basin of the free variables is so narrow that the lowest designs of a sample do not lead to it.
    problem, heights = generate.draw(6002), [0.119, 0.136, 0.14, 0.181, 0.251, 0.283, 0.303, 0.354]
    best = truth_of(problem, {"height": heights})
    made[len(made)] = {"problem": problem.plain(), "catalogues": {"height": heights}, "truth": best}
    lines = ",\n".join(f'"{k}":{json.dumps(v, separators=(",", ":"))}' for k, v in made.items())
    FILE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
