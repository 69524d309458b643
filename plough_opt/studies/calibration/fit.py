"""What a calibration found: values, their uncertainty, residuals, sentences and files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from plough_opt.core.errors import InputError
from plough_opt.core.files import write_file
from plough_opt.core.tables import Page, Readable, data_frame
from plough_opt.exchange.results import SCHEMA, Saved, read_saved
from plough_opt.motion.scene import Scene
from plough_opt.soil.soil import Soil
from plough_opt.studies.calibration.candidates import NextMeasurement
from plough_opt.studies.calibration.caveats import caveats
from plough_opt.studies.calibration.cross_validation import CrossValidation
from plough_opt.studies.calibration.estimate import NOMINAL, Data, Estimate
from plough_opt.studies.calibration.fitted import Fitted, Live, Source
from plough_opt.studies.calibration.identifiability import Undetermined, undetermined
from plough_opt.studies.calibration.parts import (
    Correlation,
    Found,
    KnownInterval,
    Row,
    correlations_of,
    found_of,
    rows_of,
)
from plough_opt.studies.calibration.report import fit_page

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]


_UNSAVED: Final = ("source", "origin")


@dataclass(frozen=True, repr=False)
class Fit(Readable, Fitted):
    """A calibration: unknowns with their uncertainty, and how well the model follows the data.

    Its attributes are those of `Fitted`.
    """

    def cross_validation(self, folds: int | None = None, *, seed: int = 1) -> CrossValidation:
        """Return how well the model predicts rows that took no part in its fit.

        Args:
            folds: number of parts, each left out in turn; default: each row by itself, of over 60 rows 20; of runs 5.
            seed: of the shuffling.

        Raises:
            InputError: a number of folds that cannot be, or a fit from a file.
            NotConverged: a fit without some of the rows has no optimum.
        """
        source = self._live("cross-validate")
        return source.calibration.cross_validation(source.data, source.found, folds, seed)

    @property
    def scene(self) -> Scene:
        """The scene with the calibrated values."""
        source = self._live("take the scene of")
        scene = source.calibration.model.scene(self.values)
        return replace(scene, soil=self._named(scene.soil))

    @property
    def soil(self) -> Soil:
        """The soil with the calibrated values."""
        return self.scene.soil

    def page(self) -> Page:
        """Return what was found, what the data cannot tell, what would, and how well the model follows them."""
        return fit_page(self)

    def picture(self) -> Figure:
        """Return the picture for a notebook."""
        return self.plot()

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each measured row beside the fit, SI; the unit of each is a column.

        Raises:
            InputError: pandas is not installed.
        """
        names = ("place", "result", "unit", "observed", "predicted", "residual", "sigma", "standard_error")
        frame = data_frame({name: [getattr(row, name) for row in self.rows] for name in names}, {})
        frame.attrs["units"] = {row.result: row.unit for row in self.rows}
        return frame

    def _named(self, soil: Soil) -> Soil:
        own = [found.name.removeprefix("soil.") for found in self.unknowns if found.name.startswith("soil.")]
        if not own:
            return soil
        files = ", ".join(dict.fromkeys(m.name for m in self._live("name").calibration.measured))
        return replace(soil, name=f"{soil.name}, calibrated", source=f"{', '.join(own)} from {files}; {soil.source}")

    def _live(self, verb: str) -> Source:
        if self.source is None:
            raise InputError(f"this fit comes from a file: calibrate again to {verb} it")
        return self.source

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw measured against predicted values, residuals, and their distribution.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a place that cannot be written.
        """
        from plough_opt.core.picture_files import save
        from plough_opt.studies.calibration.picture import figure_of

        figure = figure_of(self.title, self.rows)
        if target is not None:
            save(figure, target)
        return figure

    def to_json(self) -> str:
        """Return the fit as JSON text with versions and a schema number; infinite numbers as "Infinity"."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in _UNSAVED}
        if self.source is not None:
            self.intervals(0.95, "linearised")
            self.intervals(0.95, "profile")
            own["saved_intervals"] = tuple(
                KnownInterval(name, level, kind, found)
                for (level, kind), every in self.source.known.items()
                for name, found in every.items()
            )
            own["saved_next"] = self.next_measurements()
        return SavedFit(layout=SCHEMA, **own).to_json()

    def save(self, path: str | Path) -> Path:
        """Write the fit as JSON, making its folder.

        Raises:
            InputError: the place cannot be written.
        """
        return write_file(path, "fit", self.to_json() + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Fit:
        """Read a fit that `save` wrote; it cannot compute further.

        Raises:
            InputError: no such file, or not a fit of this layout.
        """
        saved = read_saved(path, "fit", "a calibration", SavedFit.model_validate_json)
        return cls(**{name: getattr(saved, name) for name in cls.__dataclass_fields__ if name not in _UNSAVED})


class SavedFit(Saved):
    """A fit as JSON: SI units."""

    model_config = ConfigDict(
        frozen=True, arbitrary_types_allowed=True, populate_by_name=True, ser_json_inf_nan="strings"
    )

    kind: Literal["calibration"] = "calibration"
    unknowns: tuple[Found, ...]
    correlations_found: tuple[Correlation, ...]
    unidentifiable: tuple[Undetermined, ...]
    rows: tuple[Row, ...]
    loss: str
    total: float
    optima: tuple[float, ...]
    freedom: int
    scatter: float
    stated: bool
    status: str
    warnings: tuple[str, ...]
    seconds: float
    saved_intervals: tuple[KnownInterval, ...]
    saved_next: tuple[NextMeasurement, ...]


def reported(calibration: Live, data: Data, found: Estimate, seconds: float) -> Fit:
    """Return a fit from what the solver found."""
    unknowns, spread = calibration.unknowns, found.spread
    errors = np.sqrt(np.diag(spread.covariance))
    unscaled = data.weights * (found.predicted - data.observed)
    scatter = float(np.sqrt(np.sum(unscaled**2) / max(found.freedom, 1)))
    return Fit(
        title=calibration.title,
        unknowns=found_of(unknowns, errors, found),
        correlations_found=correlations_of(unknowns, errors, found),
        unidentifiable=undetermined(unknowns, found.y, spread),
        rows=rows_of(calibration.measured, data, found),
        loss=calibration.loss.name,
        total=found.stop.loss,
        optima=found.optima,
        freedom=found.freedom,
        scatter=scatter if data.stated else NOMINAL * scatter,
        stated=data.stated,
        status=found.stop.status,
        warnings=caveats(calibration.rows, calibration.model, unknowns, found),
        seconds=seconds,
        source=Source(calibration, data, found),
    )
