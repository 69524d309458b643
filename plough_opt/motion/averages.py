"""Averages of a run, and its error estimate and warnings."""

from dataclasses import dataclass

from plough_opt.core.expressions import Expression
from plough_opt.motion.settled import Settled


@dataclass(frozen=True)
class Averages:
    """Time averages of a run; every RMS is the standard deviation about the mean.

    Attributes:
        mean_draft: mean of the mount force P [N].
        force_rms: RMS of P [N].
        mean_deflection: mean of the spring's deflection z [m].
        displacement_rms: RMS of z [m].
        tow_power: mean of P s' [W].
    """

    mean_draft: Expression
    force_rms: Expression
    mean_deflection: Expression
    displacement_rms: Expression
    tow_power: Expression


@dataclass(frozen=True)
class Checks:
    """Error estimate, time and warnings of a numeric run.

    Attributes:
        error_estimate: estimated relative error [-] of every result: see `plough_opt.simulate`.
        seconds: time taken [s].
        notes: sentences on this run for whoever reads its results.
        floquet: multipliers of a lasting orbit [-].
        settles: to which motion a share comes from equilibrium, of a lasting orbit.
    """

    error_estimate: float
    seconds: float
    notes: tuple[str, ...]
    floquet: tuple[complex, ...] = ()
    settles: Settled | None = None
