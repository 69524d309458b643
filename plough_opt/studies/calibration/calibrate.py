"""`calibrate`: the unknowns of a scene, with their uncertainty, from measurements."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from plough_opt.core.checks import array_of, check_named, check_text, mapping_of, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.plain_data import Array
from plough_opt.motion.scene import Scene
from plough_opt.studies.calibration.estimate import estimate
from plough_opt.studies.calibration.fit import Fit, reported
from plough_opt.studies.calibration.measurements import Measurements
from plough_opt.studies.calibration.model import Described, SceneOf, setup_of


class Calibration:
    """A calibration whose model is built once, for fits to many sets of observed values.

    Args:
        given: a problem file; a numeric scene; or a function of values by key, such as "soil.cohesion", that accepts
            symbols and returns a scene.
        data: one set of measurements, or several.
        unknown: key of a problem file -> (lower, upper) or (lower, upper, guess), SI or text with units; default: the
            variables of the problem file that are not columns of the data.
        errors: of values whose sigma is not stated: "constant" standard deviation in each set, or "relative", that is
            proportional to the result.
        loss: "squares", or a robust loss that gives outliers less weight: "huber", "soft_l1", "cauchy".
        duration: simulated time [s] of runs whose averages were measured; default: the problem's.
        starts: number of starts: the guess, and the best of 64 points between the bounds (of 16 if they need runs).
        title: title for reports.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
        >>> po.Calibration(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")}).fit().loss
        'squares'
    """

    def __init__(
        self,
        given: Described | Scene | SceneOf,
        data: Measurements | Sequence[Measurements],
        unknown: Mapping[str, Any] | None = None,
        *,
        loss: str = "squares",
        errors: str = "constant",
        duration: float | None = None,
        starts: int = 4,
        title: str = "",
    ) -> None:
        check_text("title", title)
        if not is_count(starts) or starts > 16:
            raise InputError(f"starts = {shown(starts)} must be a whole number from 1 to 16")
        self.setup = setup_of(given, data, unknown, loss, errors, duration)
        self.starts = starts
        self.title = title or self.setup.model.title

    def predict(self, values: Mapping[str, Any]) -> Array:
        """Return the predictions of all rows, SI.

        Args:
            values: unknown -> its value, SI or text with a unit.

        Raises:
            InputError: the values are not those of all unknowns.
            DomainError: a value is not finite.

        Example:
            >>> import plough_opt as po
            >>> still = po.Effects(motion=False)
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
            >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
            >>> question = po.Calibration(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
            >>> question.predict({"soil.cohesion": "20 kPa"}).round().tolist()
            [2405.0, 2430.0]
        """
        unknowns = {unknown.name: unknown for unknown in self.setup.model.unknowns}
        given = mapping_of("the values", values, f"{{'{next(iter(unknowns))}': value}} for every unknown")
        for name in given:
            check_named("{} is not an unknown of this calibration", name, unknowns)
        if missing := [name for name in unknowns if name not in given]:
            raise InputError(f"the values lack {', '.join(missing)}: give every unknown a value")
        y = np.array([unknown.scaled(unknown.read(f"'{name}'", given[name])) for name, unknown in unknowns.items()])
        return self.setup.problem.predict(y)

    def fit(self, observed: Array | None = None) -> Fit:
        """Return the fit to the measured values, or to other observed values.

        Args:
            observed: other values in place of the measured ones, SI, one for each row.

        Raises:
            InputError: the observed values are not finite numbers, one for each row.
            NotConverged: no start led to an optimum.

        Example:
            >>> import plough_opt as po
            >>> still = po.Effects(motion=False)
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
            >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
            >>> question = po.Calibration(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
            >>> round(question.fit(question.predict({"soil.cohesion": 25e3})).values["soil.cohesion"])
            25000
        """
        started = time.perf_counter()
        data = self.setup.data
        if observed is not None:
            expected = f"observed must be {len(data.observed)} finite numbers, one for each row"
            values = array_of(observed, expected)
            if values.shape != data.observed.shape or not np.all(np.isfinite(values)):
                raise InputError(expected)
            data = replace(data, observed=values)
        return reported(self.title, estimate(self.setup, data, self.setup.model.guess, self.starts), started)


def calibrate(
    given: Described | Scene | SceneOf,
    data: Measurements | Sequence[Measurements],
    unknown: Mapping[str, Any] | None = None,
    **options: Any,
) -> Fit:
    """Estimate soil and model parameters from measurements, by least squares between bounds.

    For example::

        data = po.read_measurements("draft.csv")
        fit = po.calibrate(scene, data, {"soil.cohesion": (1e3, 80e3), "effects.rate_term": (0.0, 0.2)})
        print(fit.values, fit.intervals(0.95), fit.unidentifiable)

    Args:
        given: a problem file, a numeric scene, or a function of values by key that returns a scene.
        data: one set of measurements, or several.
        unknown: key of a problem file -> (lower, upper) or (lower, upper, guess), SI or text with units.
        **options: loss, errors, duration, starts and title; see `Calibration` for all arguments.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.
        NotConverged: no start led to an optimum.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
        >>> fit = po.calibrate(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
        >>> fit.freedom
        1
    """
    fit = Calibration(given, data, unknown, **options).fit()
    return replace(fit, origin=getattr(given, "origin", fit.origin))
