"""Results of a run beside its arrays: averages, error estimate, warnings, and the motion to which a share settles."""

from dataclasses import dataclass

from plough_opt.core.expressions import Expression


@dataclass(frozen=True)
class Settled:
    """To which motion a share comes that starts from equilibrium.

    Attributes:
        orbit: whether it is the orbit; None where it has come to none after the wavelengths followed.
        wavelengths: number that were followed.
        period: of the motion that it comes to [wavelengths]; None where that does not repeat itself.
        force_rms: RMS of the mount force [N] of that motion.
        averaged: wavelengths over which that is averaged: its period, else the last ones that were followed.
        distance: of the share from the orbit at the end, in parts of the orbit's half range [-].
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
        """The motion that a share which starts from equilibrium comes to, as a clause."""
        after, back = f"after {self.wavelengths} wavelengths", ", in which it retreats" if self.retreats else ""
        if self.orbit:
            return f"comes to this orbit ({after} it is within {100.0 * self.distance:.1g} % of the orbit's range)"
        if self.orbit is None:
            return f"has not settled {after}, over the last {self.averaged} of RMS {self.force_rms:.4g} N{back}"
        if self.period is None:
            return f"is driven away without end ({after})"
        kind = "another motion of the wave's own period" if self.period == 1 else f"a period-{self.period} motion"
        return f"comes to {kind} of RMS {self.force_rms:.4g} N{back} ({after})"


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
