"""The result of a calibration: `Fit`, with tables, pictures and files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.core.kept import Keepable
from plough_opt.core.tables import Page, data_frame
from plough_opt.motion.scene import Scene
from plough_opt.soil.soil import Soil
from plough_opt.studies.calibration.caveats import caveats
from plough_opt.studies.calibration.cross_validation import CrossValidation
from plough_opt.studies.calibration.estimate import NOMINAL, Data, Estimate
from plough_opt.studies.calibration.fitted import Calibrator, Fitted, Source
from plough_opt.studies.calibration.identifiability import undetermined
from plough_opt.studies.calibration.parts import (
    KnownInterval,
    correlations_of,
    fitted_unknowns,
    rows_of,
)
from plough_opt.studies.calibration.report import fit_page

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class Fit(Keepable, Fitted):
    """A calibration: unknowns with their uncertainty, and how well the model follows the data.

    Its attributes are those of `Fitted`.
    """

    kind = "calibration"
    unkept = frozenset({"source"})

    def cross_validation(self, folds: int | None = None, *, seed: int = 1) -> CrossValidation:
        """Return how well the model predicts rows that took no part in its fit.

        Args:
            folds: number of parts, each left out in turn; default: each row by itself, 20 parts for over 60 rows, and 5
                if the rows need runs.
            seed: of the shuffling.

        Raises:
            InputError: an invalid number of folds, or a fit from a file.
            NotConverged: a fit without some of the rows has no optimum.
        """
        source = self._source_to("cross-validate")
        return source.calibration.cross_validation(source.data, source.estimate, folds, seed)

    @property
    def scene(self) -> Scene:
        """The scene with the calibrated values."""
        source = self._source_to("take the scene of")
        scene = source.calibration.model.scene(self.values)
        return replace(scene, soil=self._named(scene.soil))

    @property
    def soil(self) -> Soil:
        """The soil with the calibrated values."""
        return self.scene.soil

    def page(self) -> Page:
        """Return the unknowns, the undetermined combinations, the next measurements, and the scatter about the fit."""
        return fit_page(self)

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
        own = [unknown.name.removeprefix("soil.") for unknown in self.unknowns if unknown.name.startswith("soil.")]
        if not own:
            return soil
        files = ", ".join(dict.fromkeys(m.name for m in self._source_to("name").calibration.measured))
        return replace(soil, name=f"{soil.name}, calibrated", source=f"{', '.join(own)} from {files}; {soil.source}")

    def _source_to(self, verb: str) -> Source:
        """Return the source of a fit that is not from a file."""
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

    def to_json(self, page: Page | None = None) -> str:
        """Return the fit as JSON, with its intervals and the ranking of measurements: see `Keepable.to_json`."""
        if self.source is None:
            return super().to_json(page)
        self.intervals(0.95, "linearised")
        self.intervals(0.95, "profile")
        intervals = tuple(
            KnownInterval(name, level, kind, interval)
            for (level, kind), every in self.source.known.items()
            for name, interval in every.items()
        )
        whole = replace(self, source=None, saved_intervals=intervals, saved_next=self.next_measurements())
        return whole.to_json(page or self.page())


def reported(calibration: Calibrator, data: Data, estimate: Estimate, seconds: float) -> Fit:
    """Return the fit of an estimate."""
    unknowns, spread = calibration.unknowns, estimate.spread
    errors = np.sqrt(np.diag(spread.covariance))
    unscaled = data.weights * (estimate.predicted - data.observed)
    scatter = float(np.sqrt(np.sum(unscaled**2) / max(estimate.freedom, 1)))
    return Fit(
        title=calibration.title,
        unknowns=fitted_unknowns(unknowns, errors, estimate),
        correlations_found=correlations_of(unknowns, errors, estimate),
        unidentifiable=undetermined(unknowns, estimate.y, spread),
        rows=rows_of(calibration.measured, data, estimate),
        loss=calibration.loss.name,
        total=estimate.stop.loss,
        optima=estimate.optima,
        freedom=estimate.freedom,
        scatter=scatter if data.stated else NOMINAL * scatter,
        stated=data.stated,
        status=estimate.stop.status,
        warnings=caveats(calibration.rows, calibration.model, unknowns, estimate),
        seconds=seconds,
        source=Source(calibration, data, estimate),
    )
