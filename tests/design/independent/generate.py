"""Random design problems from seeds."""

import numpy as np
from scipy.stats import qmc

from independent.problem import PATHS, QUANTITIES, Limit, Problem, Variable, evaluate, measure

# Probabilities of one to eight variables, and weights with which the quantities are drawn.
_SIZES = (0.12, 0.15, 0.25, 0.15, 0.12, 0.09, 0.06, 0.06)
_OFTEN = np.array([3.0, 3.0, 4.0, 1.5, 1.5, 1.5, 1.0, 0.7])
# Measures, sides and probabilities of requirements. A requirement must leave at least 30 designs of the sample.
_REQUIREMENTS = (
    ("loosened radius", "at_least", 0.6),
    ("half angle", "at_most", 0.45),
    ("mean_deflection", "at_most", 0.3),
    ("deflection", "at_most", 0.3),
    ("mount force", "at_most", 0.15),
    ("tow_power", "at_most", 0.1),
    ("force_rms", "at_most", 0.1),
)
_SAMPLE, _LEAST_LEFT = 1024, 30


def draw(seed):
    """Return the problem of a seed. Its limits are quantiles of a sample of its designs."""
    for attempt in range(100):
        random = np.random.default_rng([seed, attempt])
        problem = _with_limits(_bare(f"search {seed}", random), random)
        if problem is not None:
            return problem
    raise AssertionError(f"no problem found for seed {seed}")


def draw_moving(number, first_seed, counts, stream, describe):
    """Return the description of the first problem that moves, has a suitable size and limits averages only.

    Args:
        number: number of the description.
        first_seed: first seed for number 0.
        counts: smallest and largest number of variables.
        stream: second seed of the random numbers.
        describe: (problem, random numbers) -> the description, or None if the problem is unsuitable.
    """
    for seed in range(first_seed + 1000 * number, first_seed + 1000 * (number + 1)):
        problem = draw(seed)
        still = problem.start == "equilibrium" and problem.wave is None
        paths = any(r.measure in PATHS for r in problem.limits)
        if still or paths or not counts[0] <= len(problem.variables) <= counts[1]:
            continue
        found = describe(problem, np.random.default_rng([seed, stream]))
        if found is not None:
            return found
    raise AssertionError(f"no problem found for number {number}")


def _digits(value, digits=6):
    return float(f"{value:.{digits}g}")


def _bare(name, random):
    """Return a random problem without requirements and objective."""

    def even(low, high):
        return _digits(random.uniform(low, high))

    def log(low, high):
        return _digits(np.exp(random.uniform(np.log(low), np.log(high))))

    count = int(random.choice(np.arange(1, 9), p=_SIZES))
    chosen = set(random.choice(QUANTITIES, size=count, replace=False, p=_OFTEN / _OFTEN.sum()))
    duration = even(0.6, 2.0)
    bounds = {
        "wedge angle": (even(0.09, 0.2), even(0.7, 1.2), False),
        "height": (0.1, even(0.3, 0.5), False),
        "stiffness": (log(3e3, 2e4), log(5e5, 5e6), True),
        "tow speed": (even(0.5, 1.0), even(2.0, 3.4), False),
        "frame mass": (even(5.0, 15.0), even(60.0, 200.0), False),
        "damping": (log(10.0, 40.0), log(400.0, 1800.0), True),
        "ramp time": (even(0.05, 0.15), even(0.4, 0.9), False),
        "chisel angle": (even(0.05, 0.2), even(0.35, 0.6), False),
    }
    fixed = {
        "wedge angle": even(0.15, 0.8),
        "height": even(0.12, 0.45),
        "stiffness": log(1e4, 1e6),
        "tow speed": even(0.6, 3.0),
        "frame mass": even(8.0, 120.0),
        "damping": 0.0 if random.random() < 0.4 else log(10.0, 1500.0),
        "ramp time": 0.0 if random.random() < 0.75 else even(0.1, 0.6),
        "chisel angle": even(0.15, 0.45),
    }
    variables = []
    for quantity in QUANTITIES:
        if quantity in chosen:
            lower, upper, logarithmic = bounds[quantity]
            guess = Variable(quantity, lower, upper, lower, logarithmic).unscaled(random.random())
            variables.append(Variable(quantity, lower, upper, _digits(guess), logarithmic))
    soil = (
        even(1250.0, 1700.0), even(0.7, 0.93), log(2e3, 4e4), even(0.2, 0.65), even(0.1, 0.7),
        float(random.choice([5e3, 2e4, 101325.0])),
    )  # fmt: skip
    wave = (even(0.1, 0.6), log(0.12, 1.0)) if random.random() < 0.75 else None
    start = str(random.choice(["equilibrium", "towed", "rest"], p=[0.75, 0.17, 0.08]))
    return Problem(
        name=name,
        soil=soil,
        fixed={quantity: value for quantity, value in fixed.items() if quantity not in chosen},
        wave=wave,
        start=start,
        duration=duration,
        steel=bool(random.random() < 0.8),
        variables=tuple(variables),
    )


def _with_limits(problem, random):
    """Return the problem with requirements that some designs meet and an objective of order 1, or None."""
    y = qmc.Sobol(len(problem.variables), seed=random).random(_SAMPLE)
    values = measure(problem, y, 1.0, paths=True)
    worst = {name: np.max(v, axis=0) if v.ndim == 2 else v for name, v in values.items()}
    left = np.isfinite(worst["mean_draft"])
    limits = []
    for name, side, often in _REQUIREMENTS:
        if random.random() > often or np.count_nonzero(left) < 2 * _LEAST_LEFT or _spread(worst[name][left]) < 1e-3:
            continue
        part = random.uniform(0.25, 0.9)
        limit = _digits(np.quantile(worst[name][left], part if side == "at_most" else 1.0 - part), 5)
        new = Limit(name, side, limit)
        still = left & (new.violation(worst[name]) <= 0.0)
        if limit > 0.0 and np.count_nonzero(still) >= _LEAST_LEFT:
            limits.append(new)
            left = still
    if np.count_nonzero(left) < _LEAST_LEFT:
        return None
    moves = problem.wave is not None or problem.start != "equilibrium" or _ramps(problem)
    names = ("mean_draft", "mean_deflection", "tow_power", *(("force_rms", "displacement_rms") if moves else ()))
    chosen = random.choice(names, size=int(random.integers(1, 4)), replace=False)
    objective = {str(name): _digits(random.uniform(0.2, 1.0) / np.median(worst[name][left])) for name in sorted(chosen)}
    made = Problem(**{**problem.__dict__, "limits": tuple(limits), "objective": objective})
    found = evaluate(made, y[left], phase=1.0).objective
    return made if np.all(np.isfinite(list(objective.values()))) and _spread(found) > 1e-2 else None


def _ramps(problem):
    return problem.fixed.get("ramp time", 1.0) > 0.0


def _spread(values):
    return float((np.max(values) - np.min(values)) / max(np.max(np.abs(values)), 1e-300))
