"""`BatchResult`: the results of a batch, as arrays over its designs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.files import drawn
from plough_opt.core.plain_data import Array
from plough_opt.core.saving import Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import customary
from plough_opt.motion.vocabulary import called

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

# Array of a batch -> its unit.
_UNITS: Final = {
    "mean_draft": "N", "force_rms": "N", "mean_deflection": "m", "displacement_rms": "m", "tow_power": "W",
    "error_estimate": "", "steps": "",
}  # fmt: skip
# A multiplier that exceeds 1 by less may be that of an undamped mount: multipliers follow from differences of states.
_MARGINAL: Final = 1e-5
UNSTABLE: Final = "the orbit is unstable: a deviation grows in every wavelength, so no share stays on it"
"""Warning of a design with such an orbit."""
# Failures that a table quotes.
_QUOTED: Final = 3


@dataclass(frozen=True, eq=False, repr=False)
class BatchResult(Saveable):
    """Results of a batch, an element for each design in the order of the call.

    Attributes:
        mean_draft: time average of the mount force P [N].
        force_rms: standard deviation of P about its mean [N].
        mean_deflection: time average of the spring's deflection [m].
        displacement_rms: its standard deviation [m].
        tow_power: mean of P s' [W].
        error_estimate: estimated error of mean draft and RMS force, relative to the larger of them [-]. It adds up the
            truncated terms of all steps as if they pointed the same way, and lets the sum grow or decay by the
            linearised equation of motion. It is usually about a hundred times larger than the error, and infinite for a
            chaotic motion.
        largest_multiplier: absolute value of the largest Floquet multiplier of a periodic orbit [-], by which a small
            deviation grows over one wavelength; NaN for a motion from a start.
        steps: number of steps of each design.
        reasons: position of a design without results -> the reason. Its results are NaN.
        wanted: the relative error that was requested [-].
        seconds: time taken [s].
        warnings: about the batch as a whole.

    Example:
        >>> import casadi as ca
        >>> import plough_opt as po
        >>> mass = ca.MX.sym("mass")
        >>> cone = po.Cone("10 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), cone, 5e4, mass, 2.0, po.Effects(damping=400.0))
        >>> found = po.Batch(scene, 0.1, [mass])([[20.0], [-1.0]])
        >>> list(found.reasons)
        [1]
    """

    mean_draft: Array
    force_rms: Array
    mean_deflection: Array
    displacement_rms: Array
    tow_power: Array
    largest_multiplier: Array
    error_estimate: Array
    steps: Array
    reasons: dict[int, str]
    wanted: float
    seconds: float
    warnings: tuple[str, ...]
    kind = "batch"

    def __repr__(self) -> str:
        """Return a summary in one line, without the arrays."""
        return f"<BatchResult: {self._heading()}>"

    def _heading(self) -> str:
        return (
            f"{len(self)} designs in {self.seconds:.3g} s, {len(self.reasons)} without results,"
            f" {np.count_nonzero(self.missed)} with an estimated error above {self.wanted:g}"
        )

    def page(self) -> Page:
        """Return the range of every result, and why designs failed.

        Example:
            >>> import casadi as ca
            >>> import plough_opt as po
            >>> mass = ca.MX.sym("mass")
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), cone, 5e4, mass, 2.0, po.Effects(damping=400.0))
            >>> found = po.Batch(scene, 0.1, [mass])([[20.0], [-1.0]])
            >>> found.page().parts[0].rows[0]
            ('mean draft', '2.1452 kN', '2.1452 kN', '2.1452 kN')
        """
        table = Grid.of("", "result", "least", "median", "largest")
        for name, unit in _UNITS.items():
            values = getattr(self, name)[~self.failed]
            if unit and len(values):
                ends = [float(x) for x in (np.min(values), np.median(values), np.max(values))]
                table.row(called(name), *(customary(unit, *ends).text(x) for x in ends))
        reasons = dict(itertools.islice(self.reasons.items(), _QUOTED))
        lost = [f"design {number} has no result: {reason}" for number, reason in reasons.items()]
        lost += [f"... and {len(self.reasons) - _QUOTED} more: see reasons"] if len(self.reasons) > _QUOTED else []
        return Page(self._heading(), (*([table] if table.rows else []), *lost), self.warnings)

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw the RMS of the mount force against the mean draft, a point for each design.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name with an unknown ending, or a path that cannot be written.

        Example:
            >>> import casadi as ca
            >>> import plough_opt as po
            >>> stiffness = ca.MX.sym("stiffness")
            >>> cone, wave = po.Cone("10 deg", "25 cm"), po.StrengthWave(0.3, "0.2 m")
            >>> scene = po.Scene(po.named_soil("serozem"), cone, stiffness, 30.0, 2.0, po.Effects(strength_wave=wave))
            >>> found = po.Batch(scene, 0.1, [stiffness])([[4e4], [5e4], [6e4]])
            >>> found.plot().axes[0].get_ylabel()
            'RMS of the mount force [kN]'
        """
        return drawn("plot_batch", self, target=target)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each design in SI units, NaN where it failed; multipliers only of orbits.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import casadi as ca
            >>> import plough_opt as po
            >>> mass = ca.MX.sym("mass")
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), cone, 5e4, mass, 2.0, po.Effects(damping=400.0))
            >>> table = po.Batch(scene, 0.1, [mass])([[20.0], [-1.0]]).to_dataframe()
            >>> [bool(failed) for failed in table["mean_draft"].isna()]
            [False, True]
        """
        units = _UNITS | ({} if np.isnan(self.largest_multiplier).all() else {"largest_multiplier": ""})
        return data_frame({name: getattr(self, name) for name in units}, units)

    def __len__(self) -> int:
        return len(self.mean_draft)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Mask of the designs without results: see `reasons`."""
        mask = np.zeros(len(self), dtype=bool)
        mask[list(self.reasons)] = True
        return mask

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """Mask of the designs whose periodic orbit is unstable."""
        return np.asarray(self.largest_multiplier > 1.0 + _MARGINAL)

    @property
    def missed(self) -> NDArray[np.bool_]:
        """Mask of the designs whose estimated error is larger than requested."""
        return np.asarray(self.error_estimate > self.wanted)
