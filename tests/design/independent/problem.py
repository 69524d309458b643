"""Design problems as plain data, and the evaluation of their designs by formulas and a simulator of their own."""

from dataclasses import dataclass, field

import numpy as np
from helpers.equations import SOIL, forces, half_angle
from scipy.stats import qmc

from independent.motion import PATHS, simulate


def sign_of(name):
    """Return -1 for a measure that is maximised, else 1."""
    return -1.0 if name == "loosened radius" else 1.0


@dataclass(frozen=True)
class Variable:
    """A design variable."""

    name: str
    lower: float
    upper: float
    guess: float
    log: bool

    def unscaled(self, y):
        """Return the value at a position between the bounds, 0 to 1."""
        if self.log:
            return self.lower * (self.upper / self.lower) ** y
        return self.lower + (self.upper - self.lower) * y

    def scaled(self, x):
        """Return the position of a value."""
        if self.log:
            return np.log(x / self.lower) / np.log(self.upper / self.lower)
        return (x - self.lower) / (self.upper - self.lower)


@dataclass(frozen=True)
class Limit:
    """A requirement that a measure is "at_least" or "at_most" a limit; a path is limited at every output time."""

    measure: str
    side: str
    limit: float

    def violation(self, values):
        """Return by what fraction of the limit values exceed it; negative inside."""
        away = (values - self.limit) / abs(self.limit)
        return away if self.side == "at_most" else -away


@dataclass(frozen=True)
class Problem:
    """A problem; SI units and radians.

    Attributes:
        name: kind and seed.
        soil: density, density ratio, cohesion, friction angle, tool friction, ambient pressure.
        fixed: values of the other quantities.
        wave: amplitude and wavelength of the strength wave, or None.
        start: "equilibrium", "rest" or "towed".
        duration: of the run [s].
        steel: whether the mass of a solid steel cone is added to the frame's.
        variables: the variables.
        limits: the requirements.
        objective: weights of the run's averages in the sum to minimise.
    """

    name: str
    soil: tuple[float, ...]
    fixed: dict[str, float]
    wave: tuple[float, float] | None = None
    start: str = "equilibrium"
    duration: float = 1.0
    steel: bool = True
    variables: tuple[Variable, ...] = ()
    limits: tuple[Limit, ...] = ()
    objective: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of_plain(cls, data):
        """Return a problem from JSON data."""
        own = dict(data, soil=tuple(data["soil"]), wave=data["wave"] and tuple(data["wave"]))
        own["variables"] = tuple(Variable(*v) for v in data["variables"])
        own["limits"] = tuple(Limit(*r) for r in data["limits"])
        return cls(**own)

    def values(self, y):
        """Return the variables in their units at positions, a row for each design."""
        return np.array([v.unscaled(column) for v, column in zip(self.variables, np.atleast_2d(y).T, strict=True)]).T

    def positions(self, values):
        """Return the positions of variables in their units."""
        return np.array([v.scaled(column) for v, column in zip(self.variables, np.atleast_2d(values).T, strict=True)]).T


@dataclass(frozen=True)
class Found:
    """Results of designs, arrays over them.

    Attributes:
        objective: objective; infinite if a share runs away.
        violations: a row for each requirement, as a fraction of its limit; the largest one of a path.
    """

    objective: np.ndarray
    violations: np.ndarray

    @property
    def worst(self):
        """Return each design's largest violation, 0 if all requirements are met."""
        return np.max(self.violations, axis=0, initial=0.0)


def evaluate(problem, y, phase=0.5):
    """Return objective and violations of designs at positions, a row each; see `simulate` for the phase."""
    objective, gaps = gaps_of(problem, y, phase)
    violations = np.array([np.max(own, axis=0) for own in gaps]).reshape(len(gaps), len(objective))
    bad = ~(np.isfinite(objective) & np.all(np.isfinite(violations), axis=0))
    return Found(np.where(bad, np.inf, objective), np.where(bad, np.inf, violations))


def gaps_of(problem, y, phase):
    """Return the objective of designs, and the violations of each requirement, a row for each output of a path."""
    measures = measure(problem, y, phase, paths=any(r.measure in PATHS for r in problem.limits))
    objective = sum(weight * measures[name] for name, weight in problem.objective.items())
    return objective, [np.atleast_2d(r.violation(measures[r.measure])) for r in problem.limits]


def measure(problem, y, phase=0.5, *, paths=False):
    """Return all measures of designs by name; paths have a row for each output."""
    y = np.atleast_2d(y)
    x = {name: np.full(len(y), value) for name, value in problem.fixed.items()}
    x |= dict(zip((v.name for v in problem.variables), problem.values(y).T, strict=True))
    shares = {name.replace(" ", "_"): x[name] for name in ("wedge angle", "chisel angle", "height")}
    soil = dict(zip(SOIL, problem.soil, strict=True))
    static, drag, added = forces(soil | shares, np)
    half = half_angle(x["wedge angle"], x["chisel angle"], np)
    base = x["height"] * np.tan(half)
    mass = x["frame mass"] + added + (7850.0 * np.pi / 3.0 * x["height"] * base**2 if problem.steel else 0.0)
    found = simulate(
        static, drag, mass, x["stiffness"], x["damping"], x["tow speed"], *(problem.wave or (0.0, 1.0)), x["ramp time"],
        problem.start, problem.duration, phase=phase, paths=paths,
    )  # fmt: skip
    return found | {"loosened radius": base / np.sqrt(1.0 - soil["density_ratio"]), "half angle": half}


def box_sample(problem, y, count=256, half_width=3e-3, seed=0):
    """Return designs in the tolerance box of one, clipped at the bounds; half widths are fractions of the ranges."""
    low, high = (np.clip(np.ravel(y) + side * half_width, 0.0, 1.0) for side in (-1.0, 1.0))
    return low + (high - low) * np.random.default_rng(seed).random((count, len(problem.variables)))


def box_quartiles(problem, y, **options):
    """Return the quartiles of the objective over the tolerance box of a design; the second is the median."""
    values = np.sort(evaluate(problem, box_sample(problem, y), **options).objective)
    # Interpolation could meet infinite values, so only the median is interpolated.
    return values[len(values) // 4], float(np.median(values)), values[3 * len(values) // 4]


def objectives_of(problem, names, y, phase=1.6):
    """Return the objectives of designs, a row each, all to be minimised; infinite if a requirement is violated."""
    measures = measure(problem, y, phase)
    values = np.array([sign_of(name) * measures[name] for name in names]).T
    values[~(evaluate(problem, y, phase).worst <= 1e-9) | ~np.all(np.isfinite(values), axis=1)] = np.inf
    return values


def sample(problem, power, random):
    """Return a scrambled Sobol sample; half of it is stretched and clipped, to include bounds and corners."""
    y = qmc.Sobol(len(problem.variables), seed=random).random(2**power)
    y[::2] = np.clip(0.5 + 1.15 * (y[::2] - 0.5), 0.0, 1.0)
    return y
