"""What pictures and pages show of a run over time, without the means to draw it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.files import COLOURS
from plough_opt.core.units import Display
from plough_opt.design import Limit
from plough_opt.motion import Run
from plough_opt.motion.equation import Structure, parameters
from plough_opt.motion.vocabulary import called

SHARE, LIMIT, SOIL, STRUT = COLOURS[0], COLOURS[1], COLOURS[4], COLOURS[6]
"""Colours in every picture: the share's motion and force, limits, the soil, and the strut."""
CONSTANT: Final = 1e-6
"""Relative change below which a result counts as constant: smaller changes are rounding."""


@dataclass(frozen=True)
class Panel:
    """Results of a run over time that share one pair of axes, in a picture or on a page.

    Attributes:
        name: name of the quantity, such as "force".
        unit: the unit in which it is shown.
        lines: label -> (values in SI, colour, whether the line is dashed), the most important first.
        limits: (name, value in SI) of each limit.
        mean: (name, mean in SI, RMS about the mean in SI), or None.
    """

    name: str
    unit: Display
    lines: dict[str, tuple[NDArray[np.float64], str, bool]]
    limits: Sequence[tuple[str, float]]
    mean: tuple[str, float, float] | None = None

    @property
    def changes(self) -> bool:
        """Whether any line changes over time."""
        return any(np.ptp(values) > CONSTANT * np.max(np.abs(values)) for values, _, _ in self.lines.values())


def force_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return mount force and soil resistance over time, with mean draft, its RMS, and limits."""
    draft, deviation = float(run.mean_draft), float(run.force_rms)
    unit = run.origin.common("N", {"mount_force": run.peak_force, "mean_draft": draft})
    lines = {"mount force": (run.mount_force, SHARE, False), "soil resistance": (run.soil_resistance, SOIL, False)}
    mean = ("mean draft", draft, deviation)
    return Panel("force", unit, lines, limits_of(run, limits, "mount_force", "mean_draft"), mean)


def deflection_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return the spring's deflection over time, with its mean, RMS, and limits."""
    mean = ("mean", float(run.mean_deflection), float(run.displacement_rms))
    unit = run.origin.common("m", {"deflection": run.peak_deflection, "mean_deflection": mean[1]})
    lines = {"deflection": (run.deflection, SHARE, False)}
    return Panel("deflection", unit, lines, limits_of(run, limits, "deflection", "mean_deflection"), mean)


def speed_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return the speeds of share and strut over time, with the limits of the share's."""
    structure, p = Structure.of(run.scene), parameters(run.scene)
    strut_speed = structure.towed(p, run.time)[1] + 0.0 * run.time
    lines = {"share": (run.speed, SHARE, False), "strut": (strut_speed, STRUT, True)}
    return Panel("speed", run.origin.display("scene.tow_speed", "m/s"), lines, limits_of(run, limits, "speed"))


def changing(run: Run, limits: Sequence[Limit] = ()) -> list[Panel]:
    """Return the panels of a run (force, deflection, speed) that change over time."""
    return [panel for panel in (of(run, limits) for of in (force_of, deflection_of, speed_of)) if panel.changes]


def subject(run: Run) -> str:
    """Return the heading of a picture: the file's title, the soil and the tow speed."""
    speed = run.origin.display("scene.tow_speed", "m/s").text(float(run.scene.tow_speed), 4)
    return "\n".join(part for part in (run.origin.title, f"{run.scene.soil.name}, {speed}") if part)


def limits_of(run: Run, limits: Sequence[Limit], *names: str) -> list[tuple[str, float]]:
    """Return (name in words, value in SI) of each limit of some results, from the run's file and from ``limits``."""
    given = {limit.name: (limit.low, limit.high) for limit in limits if limit.kind == "requirement"}
    every = {**run.origin.limits, **given}
    return [(called(name), end) for name in names for end in every.get(name, ()) if end is not None]
