"""The waves that a record of strength holds, with their intervals, as a result that draws itself."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from plough_opt.core.files import COLOURS, save_figure
from plough_opt.soil.random_strength import Spectrum
from plough_opt.soil.waves import StrengthWave


@dataclass(frozen=True)
class FoundWave:
    """A strength wave of a record with its 95 % interval.

    Attributes:
        wave: amplitude [-], wavelength [m], phase [rad] at the record's first position.
        amplitude: half width of its interval [-].
        wavelength: half width [m].
        phase: half width [rad].
        part: of the record's variance that it carries.
    """

    wave: StrengthWave
    amplitude: float
    wavelength: float
    phase: float
    part: float


@dataclass(frozen=True)
class RecordWaves:
    """The contents of a record.

    Attributes:
        found: waves, the largest first.
        spectrum: of the record.
        variance: of relative strength [-].
        left_out: part of the variance that the waves do not carry.
        notes: what a reader must know.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> x = np.linspace(0.0, 8.0, 161)
        >>> record = po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x))
        >>> found = po.strength_waves(record)
        >>> 0.69 < found.found[0].wave.wavelength < 0.71
        True
    """

    found: tuple[FoundWave, ...]
    spectrum: Spectrum
    variance: float
    left_out: float
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def waves(self) -> tuple[StrengthWave, ...]:
        """The waves, as `Effects` takes them."""
        return tuple(one.wave for one in self.found)

    def plot(self, path: str | Path) -> Path:
        """Draw the spectrum with its confidence band and the waves; the file's ending chooses the format.

        Raises:
            InputError: an ending that is not a picture format, or a place that cannot be written.
        """
        from matplotlib.figure import Figure  # slow to import, and rarely needed

        figure = Figure(figsize=(7.0, 4.2), layout="constrained")
        axes, s = figure.subplots(), self.spectrum
        length = 2.0 * math.pi / s.wave_number
        axes.fill_between(length, s.lower, s.upper, color=COLOURS[5], alpha=0.4, label="95 % band")
        axes.loglog(length, s.density, color=COLOURS[0], label="spectrum")
        for number, one in enumerate(self.found, start=1):
            label = f"{number}: {one.wave.wavelength:.3g} m, amplitude {one.wave.amplitude:.2g}"
            axes.axvline(float(one.wave.wavelength), color=COLOURS[1], lw=1.0, ls=(0, (4, number)), label=label)
        axes.set_xlabel("wavelength [m]")
        axes.set_ylabel("spectrum of relative strength [m/rad]")
        axes.legend(fontsize=8)
        return save_figure(figure, path)
