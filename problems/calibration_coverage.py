"""Print how often the intervals of a calibration hold the truth, in synthetic trials, as a table in Markdown.

python problems/calibration_coverage.py [TRIALS]
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import plough_opt as po

BOUNDS = {
    "soil.cohesion": (1e3, 80e3),
    "soil.friction_angle": (po.deg(10.0), po.deg(45.0)),
    "soil.density_ratio": (0.6, 0.95),
    "soil.tool_friction": (0.05, 1.5),
    "soil.ambient_pressure": (1e3, 200e3),
    "effects.rate_term": (0.0, 0.2),
}
TRUTH = {
    "soil.cohesion": 20e3,
    "soil.friction_angle": po.deg(28.0),
    "soil.density_ratio": 0.794,
    "soil.tool_friction": 0.5,
    "soil.ambient_pressure": 60e3,
    "effects.rate_term": 0.02,
}
SPEEDS = np.linspace(0.8, 3.0, 6)
ANGLES = np.radians([25.0, 35.0, 45.0, 55.0])
TRIALS, SEED = 500, 1


@dataclass(frozen=True)
class Covered:
    """How often the intervals of one unknown contain its true value, over fits to many synthetic sets.

    Attributes:
        name: the unknown.
        truth: its true value, SI.
        trials: number of sets.
        identifiable: number of sets that determined it.
        covered: number of those sets in which the interval contained the truth.
        relative_error: their standard deviation over the truth.
    """

    name: str
    truth: float
    trials: int
    identifiable: int
    covered: int
    relative_error: float

    @property
    def rate(self) -> float:
        """The covered part of the trials in which the unknown was identifiable."""
        return self.covered / self.identifiable if self.identifiable else math.nan


def coverage(
    calibration: po.Calibration, truth: Mapping[str, float], sigma: np.ndarray, trials: int, seed: int
) -> list[Covered]:
    """Fit many synthetic sets: the model's own values at the truth with independent normal errors.

    Args:
        calibration: model, conditions and unknowns; its measured values are not used.
        truth: unknown -> true value, SI.
        sigma: standard deviation of each row's error, SI.
        trials: number of sets.
        seed: of the errors.
    """
    exact = calibration.predict(truth)
    errors = np.random.default_rng(seed).standard_normal((trials, len(exact)))
    fits = [calibration.fit(exact + sigma * error) for error in errors]
    found = []
    for name, true in truth.items():
        values = np.array([fit.values[name] for fit in fits])
        determined = [fit for fit in fits if fit.standard_errors[name] < math.inf]
        covered = sum(true in fit.intervals()[name] for fit in determined)
        found.append(Covered(name, true, trials, len(determined), covered, float(np.std(values)) / abs(true)))
    return found


@dataclass(frozen=True)
class Trial:
    """Conditions of a synthetic experiment that is repeated many times.

    Attributes:
        name: of the row in the table.
        unknown: what is to be found.
        conditions: measured result -> conditions.
        error: standard deviation of the errors, relative to each value, or to the mean where sigma is not stated.
        stated: whether sigma is stated to the calibration.
        loss: name of the loss.
        errors: model of errors whose sigma is not stated: "constant", or "relative", as they then are.
    """

    name: str
    unknown: tuple[str, ...]
    conditions: Mapping[str, Mapping[str, np.ndarray]]
    error: float = 0.03
    stated: bool = True
    loss: str = "squares"
    errors: str = "constant"

    def run(self, trials: int, seed: int = SEED) -> list[Covered]:
        """Return the coverage of every unknown."""
        calibration, sigma = self.calibration()
        truth = {name: TRUTH[name] for name in self.unknown}
        return coverage(calibration, truth, sigma, trials, seed)

    def calibration(self) -> tuple[po.Calibration, np.ndarray]:
        """Return the calibration to exact values, which each trial replaces, and the errors' standard deviations."""
        truth = {name: TRUTH[name] for name in self.unknown}
        blank = [po.Measurements(result, np.ones(len(next(iter(own.values())))), own)
                 for result, own in self.conditions.items()]  # fmt: skip
        exact = po.Calibration(scene(), blank, self._unknown()).predict(truth)
        proportional = self.stated or self.errors == "relative"
        sigma = self.error * (exact if proportional else np.full(len(exact), exact.mean()))
        ends = np.cumsum([len(m.values) for m in blank])[:-1]
        data = [
            po.Measurements(m.result, values, m.conditions, sigma=own if self.stated else None)
            for m, values, own in zip(blank, np.split(exact, ends), np.split(sigma, ends), strict=True)
        ]
        options = {"loss": self.loss, "errors": self.errors, "starts": 1}
        return po.Calibration(scene(), data, self._unknown(), **options), sigma

    def _unknown(self) -> dict[str, tuple[float, float, float]]:
        return {name: (*BOUNDS[name], TRUTH[name]) for name in self.unknown}


def scene() -> po.Scene:
    """Return the share whose draft is measured, in a serozem with the true values."""
    soil = po.Soil(
        density=1350.0,
        density_ratio=TRUTH["soil.density_ratio"],
        cohesion=TRUTH["soil.cohesion"],
        friction_angle=TRUTH["soil.friction_angle"],
        tool_friction=TRUTH["soil.tool_friction"],
        ambient_pressure=TRUTH["soil.ambient_pressure"],
    )
    effects = po.Effects(motion=False, rate_term=TRUTH["effects.rate_term"])
    return po.Scene(soil, po.Wedge(po.deg(40.0), po.deg(15.0), 0.25), 5e4, 25.0, 2.0, effects)


def grid(**axes: np.ndarray) -> dict[str, np.ndarray]:
    """Return all combinations of conditions, one column each; two underscores in a name mean a dot."""
    columns = np.meshgrid(*axes.values(), indexing="ij")
    return {name.replace("__", "."): column.ravel() for name, column in zip(axes, columns, strict=True)}


PLANE = {"mean_draft": grid(scene__tow_speed=SPEEDS, share__wedge_angle=ANGLES)}
DEPTHS = {
    "mean_draft": grid(
        scene__tow_speed=SPEEDS[::2], share__wedge_angle=ANGLES[::1], soil__ambient_pressure=np.array([2e3, 2e4, 6e4])
    ),
    "loosened_radius": grid(share__wedge_angle=np.repeat(ANGLES, 2)),
}
STRENGTH = ("soil.cohesion", "soil.tool_friction", "effects.rate_term")
CASES = (
    Trial("24 drafts over speed and wedge angle", STRENGTH, PLANE),
    Trial("the same, sigma estimated", ("soil.ambient_pressure", *STRENGTH[1:]), PLANE, stated=False),
    Trial("the same, the loss soft_l1", STRENGTH, PLANE, stated=False, loss="soft_l1"),
    Trial("the same, errors proportional to the draft", STRENGTH, PLANE, stated=False, errors="relative"),
    Trial("36 drafts over speed, angle and ambient pressure, 8 loosened radii",
          tuple(name for name in BOUNDS if name != "soil.ambient_pressure"), DEPTHS),
    Trial("as in the first row, ambient pressure unknown too", ("soil.ambient_pressure", *STRENGTH), PLANE),
)  # fmt: skip


def table(cases: tuple[Trial, ...], trials: int) -> str:
    """Return the table."""
    lines = [
        f"| measured ({trials} trials each) | unknown | identifiable | held the truth | error of one fit |",
        "|---|---|---|---|---|",
    ]
    for case in cases:
        for number, own in enumerate(case.run(trials)):
            name = case.name if number == 0 else ""
            if 2 * own.identifiable < trials:
                lines.append(f"| {name} | `{own.name}` | in {own.identifiable} | not identifiable | |")
                continue
            rate, error = f"{100 * own.rate:.1f} %", f"{100 * own.relative_error:.2g} %"
            lines.append(f"| {name} | `{own.name}` | in {own.identifiable} | {rate} | {error} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(CASES, int(sys.argv[1]) if len(sys.argv) > 1 else TRIALS))
