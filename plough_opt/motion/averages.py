"""Scalar results of a run: averages, error estimate, warnings, and the motion to which a share settles."""

from dataclasses import dataclass

from plough_opt.core.expressions import Expression
from plough_opt.core.plain_data import Complex, MaybeInfinite


@dataclass(frozen=True)
class Settled:
    """Motion to which a share settles from equilibrium.

    Attributes:
        orbit: whether it is the periodic orbit; None if the share has not settled within the simulated wavelengths.
        wavelengths: number of simulated wavelengths.
        period: period of the motion in wavelengths; None if it does not repeat itself.
        force_rms: RMS of the mount force [N] of that motion.
        averaged: number of wavelengths in that RMS: the period, or the last simulated ones without a period.
        distance: distance from the orbit at the end, relative to half the range of the orbit [-].
        retreats: whether the share moves backwards in that motion.
    """

    orbit: bool | None
    wavelengths: int
    period: int | None
    force_rms: float
    averaged: int
    distance: float
    retreats: bool

    @property
    def text(self) -> str:
        """Predicate of a sentence about a share that starts from equilibrium."""
        after, back = f"after {self.wavelengths} wavelengths", ", in which it retreats" if self.retreats else ""
        if self.orbit:
            return f"comes to this orbit ({after} it is within {100.0 * self.distance:.1g} % of the orbit's range)"
        if self.orbit is None:
            return f"has not settled {after}; RMS over the last {self.averaged}: {self.force_rms:.4g} N{back}"
        if self.period is None:
            return f"is driven away without bound (within {self.wavelengths} wavelengths)"
        kind = "another motion of the wave's own period" if self.period == 1 else f"a period-{self.period} motion"
        return f"comes to {kind} of RMS {self.force_rms:.4g} N{back} ({after})"


@dataclass(frozen=True)
class Averages:
    """Time averages of a run. Each RMS is the standard deviation about the mean.

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
    """Error estimate, computing time and warnings of a numeric run.

    Attributes:
        error_estimate: estimated relative error [-] of every result: see `plough_opt.simulate`.
        seconds: computing time [s].
        notes: warnings about this run, besides those about its scene.
        floquet: Floquet multipliers of a periodic orbit [-].
        settles: for a periodic orbit, the motion to which a share settles from equilibrium.
    """

    error_estimate: MaybeInfinite
    seconds: float
    notes: tuple[str, ...]
    floquet: tuple[Complex, ...] = ()
    settles: Settled | None = None
