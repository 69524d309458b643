"""The motion to which a share settles, as a run of a lasting orbit reports it: see `plough_opt.motion.settling`."""

from dataclasses import dataclass


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
