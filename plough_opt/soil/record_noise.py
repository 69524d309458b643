"""The random part of a record: its most likely covariance, and the linear map that makes it white.

Soil without waves varies at random, and more at long wavelengths than at short ones. Its covariance is taken from
variogram models (a correlation that decays with distance, and a nugget), as the rig that measured it passes it on.
The likelihood is a product over windows, each given the points of the window before it (Vecchia 1988).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.soil.random_strength import Vector
from plough_opt.soil.strength_record import StrengthRecord

# Points of a window, half of which it shares with the one before.
_WINDOW: Final = 64
# Most windows from which the covariance is estimated, at even and at uneven distances, where each has its own factors.
_MOST_WINDOWS: Final = {True: 512, False: 24}
# Spectra over (wave number x correlation length): exponential correlation, Matern's of order 3/2, squared exponential.
_SHAPES: Final[tuple[Callable[[Vector], Vector], ...]] = (
    lambda x: 1.0 / (1.0 + x**2),
    lambda x: 1.0 / (1.0 + x**2) ** 2,
    lambda x: np.exp(-(x**2) / 4.0),
)
# Nuggets that are tried, as parts of the variance: with less than the first, rounding would make the covariance of
# smooth records singular.
_NUGGETS: Final = (1e-9, 1e-7, 1e-5, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
# Number of correlation lengths that are tried, in geometric progression from one lag to this number of windows, over
# which an exponential correlation is that of a random walk.
_LENGTHS: Final = 37
_LONGEST: Final = 16
# The search starts from every sixth length and every fourth nugget.
_COARSE: Final = (6, 4)
# Places and log-likelihood have settled when they change by less than this: waves are decided on by differences of ten.
_SETTLED: Final = 0.1
# Lags of the tabulated correlation per spacing.
_LAGS: Final = 4
# Least mean square, so that its logarithm is finite where the waves leave nothing.
_LEAST: Final = float(np.finfo(float).tiny)

Parameters = tuple[int, float, float]
"""Places of a shape, a correlation length and a nugget in their lists; between two entries a place is interpolated."""

# Factors for windows of a number of points at even distances: their correlation depends on no more than the parameters,
# as lengths are parts of the window's.
_EVEN: dict[int, dict[Parameters, Vector]] = {}


class Windows:
    """The windows of a record, and the factors of their covariances for all parameters that were tried."""

    def __init__(self, record: StrengthRecord) -> None:
        """Divide a record into windows of equal numbers of points."""
        count = len(record.position)
        size = min(_WINDOW, count)
        starts = np.array([*range(0, count - size, size // 2), count - size])
        self.rows: NDArray[np.intp] = starts[:, None] + np.arange(size)
        self.new: NDArray[np.bool_] = self.rows >= np.r_[0, self.rows[:-1, -1] + 1][:, None]
        """Which points of a window the one before does not have."""
        self.every = math.ceil(len(starts) / _MOST_WINDOWS[record.even])
        place = record.position[self.rows[:1] if record.even else self.rows]
        self._distances: Vector = np.abs(place[:, :, None] - place[:, None, :])
        self._record, self._lag = record, record.spacing / _LAGS
        self._factors = _EVEN.setdefault(size, {}) if record.even and record.rig is None else {}

    def factors(self, parameters: Parameters, every: int = 1) -> Vector:
        """Return the inverse Cholesky factors of windows' covariances: one for all at even distances, or one each."""
        shape, length, nugget = parameters
        distances = self._distances[::every]
        longest = float(np.max(self._distances))
        # The tabulated correlation has a period of four windows, so that neither end of a window feels the next period.
        count = 2 ** math.ceil(math.log2(4.0 * longest / self._lag))
        q: Vector = (2.0 * math.pi * np.fft.rfftfreq(count, self._lag)).astype(np.float64)
        density = _SHAPES[shape](q * self._lag * (_LONGEST * longest / self._lag) ** (length / (_LENGTHS - 1)))
        if self._record.rig is not None:
            density = density * np.abs(self._record.rig.response(q)) ** 2
        table = np.fft.irfft(density)[: count // 2]
        correlation = np.interp(distances, self._lag * np.arange(len(table)), table / table[0])
        part = math.exp(np.interp(nugget, range(len(_NUGGETS)), np.log(_NUGGETS)))
        covariance = (1.0 - part) * correlation + part * np.eye(distances.shape[-1])
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def fitted(self, residual: Vector) -> "Continuum":
        """Return the most likely continuum of a residual (n)."""
        from scipy import optimize  # slow to import, and rarely needed

        losses: dict[Parameters, float] = {}

        def loss(tried: Parameters) -> float:
            if tried not in losses:
                if tried not in self._factors:
                    self._factors[tried] = self.factors(tried, self.every)
                losses[tried] = -self.log_likelihood(self._factors[tried], residual, self.every)
            return losses[tried]

        for shape in range(len(_SHAPES)):
            coarse = product([shape], range(0, _LENGTHS, _COARSE[0]), range(0, len(_NUGGETS), _COARSE[1]))
            place, before = min(coarse, key=loss), None
            while place != before:
                _, length, nugget = before = place
                beside = [(shape, near, nugget) for near in _beside(length, _LENGTHS)]
                beside += [(shape, length, near) for near in _beside(nugget, len(_NUGGETS))]
                place = min(beside, key=loss)
        shape, *start = min(losses, key=loss)
        found = optimize.minimize(
            lambda place: -self.log_likelihood(self.factors((shape, *place), self.every), residual, self.every),
            start,
            method="Nelder-Mead",
            bounds=[(0.0, _LENGTHS - 1.0), (0.0, len(_NUGGETS) - 1.0)],
            options={"xatol": _SETTLED, "fatol": _SETTLED},
        )
        return Continuum(self, self.factors((shape, *found.x)))

    def log_likelihood(self, factors: Vector, residual: Vector, every: int = 1) -> float:
        """Return the logarithm of a residual's likelihood at the most likely variance, over all or some windows."""
        new = self.new[::every]
        parts = residual[self.rows[::every]].reshape(len(factors), -1, new.shape[1])
        white = (parts @ np.swapaxes(factors, 1, 2)).reshape(new.shape)
        determinant = float(np.sum(np.log(np.diagonal(factors, axis1=1, axis2=2)) * new))
        count = np.count_nonzero(new)
        return determinant - 0.5 * count * math.log(max(float(np.sum(white**2 * new)) / count, _LEAST))


def _beside(index: int, count: int) -> range:
    """Return an index and its neighbours."""
    return range(max(index - 1, 0), min(index + 2, count))


@dataclass(frozen=True)
class Continuum:
    """A covariance of a record's points (n), up to a factor.

    Attributes:
        windows: the windows of the record.
        factors: inverse Cholesky factors of their covariances.
    """

    windows: Windows
    factors: Vector = field(repr=False)

    def whitened(self, columns: Vector) -> Vector:
        """Return columns (n, c) multiplied by the matrix that makes the noise in them white."""
        return np.asarray((self.factors @ columns[self.windows.rows])[self.windows.new])

    def weighted(self, values: Vector) -> Vector:
        """Return the inverse of the covariance, times values (n)."""
        parts = self.factors @ values[self.windows.rows][..., None]
        parts = np.swapaxes(self.factors, 1, 2) @ np.where(self.windows.new[..., None], parts, 0.0)
        total = np.zeros(len(values))
        np.add.at(total, self.windows.rows, parts[..., 0])
        return total

    def log_likelihood(self, residual: Vector) -> float:
        """Return the logarithm of a residual's likelihood at the most likely variance."""
        return self.windows.log_likelihood(self.factors, residual)
