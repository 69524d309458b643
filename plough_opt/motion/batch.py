"""`Batch`: the averages of very many designs of one scene, by the compiled steps of `simulate`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core.checks import (
    array_of,
    check_kind,
    check_single,
    labels_in,
    plain_number,
    shown,
    whole_number,
    without_labels,
)
from plough_opt.core.compiler import by_rows, compiler_problem
from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.expressions import Column, Expression, as_number, is_casadi, is_symbolic, stacked, template_of
from plough_opt.core.files import drawn
from plough_opt.core.plain_data import Array
from plough_opt.core.saving import Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import customary
from plough_opt.motion.domain import DomainCheck
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.effects.terms import SHORTEST_RAMP
from plough_opt.motion.equation import Structure, equation_of, parameters
from plough_opt.motion.run import Averages
from plough_opt.motion.scene import Scene, duration_of
from plough_opt.motion.solvers.compiled_steps import FEWEST_COARSE_STEPS, ManyRuns
from plough_opt.motion.solvers.orbit import without_orbit
from plough_opt.motion.vocabulary import called

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

RESULTS: Final = tuple(Averages.__dataclass_fields__)
"""Names of the results of each design, before its multiplier and error."""

# Designs that one thread holds in memory at once.
_CHUNK = 4096
# Each run is checked by one of so many times its steps, and fewer if steps lose their order at kinks. With 0.7 the
# difference covers 99.4 % of the errors of random designs where 1e-3 is wanted, with two thirds 99.6 %.
_CHECK, _CHECK_OF_KINKS = 2.0 / 3.0, 0.5
# Steps of the first run to an error of 1e-6 or more, in those of `ManyRuns`. With fewer most designs are integrated
# again, and of larger errors the difference covers less.
_FIRST = 1.9
# How often a design that misses the wanted error is integrated again, by steps shorter by `_CHECK`; chaotic ones do.
_REPETITIONS = 6
# Steps after which a design is given up.
_MOST_STEPS = 200_000
# Factor on the difference under own resistances, which may jump within a step: it covers 98 % of such errors.
_MARGIN_OF_OWN = 4.0
_EPSILON = 2.0**-52
_NO_RAMP = f"its tow ramp does not last longer than {SHORTEST_RAMP:g} s: use a batch of a scene without tow_ramp for it"


class Batch:
    """Mean and RMS force of very many designs of one scene, each to a wanted accuracy.

    For example::

        angle, height, k0 = (ca.MX.sym(name) for name in ("angle", "height", "k0"))
        share = po.Wedge(angle, po.deg(15.0), height)
        mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
        batch = po.Batch(po.Scene(soil, share, k0, mass, 2.0, effects), 2.0, inputs=[angle, height, k0])
        result = batch(values)  # values: a row for each design
        result.mean_draft, result.force_rms, result.error_estimate

    Each design is integrated twice by steps of order 8, compiled for a vector register of designs; the difference is
    its error estimate. A design that misses the wanted error is integrated again by shorter steps, up to six times.

    A periodic orbit is found by Newton's method on the map of one wavelength, from the linear response. Unlike
    `simulate`, a batch does not follow a share from equilibrium to see whether it comes to the orbit.

    Args:
        scene: scene whose quantities may be CasADi expressions of the inputs; its motion must be transient, with
            contact ``"resisting"`` or `Smooth`, or a periodic orbit without own resistances.
        duration: simulated time, above 0: a float [s], a text such as "2 s", or an expression of the inputs [s]; None
            for a periodic orbit, which lasts one wavelength of the soil's strength.
        inputs: CasADi symbols, in the order of the columns of values.
        error: wanted error of mean draft and RMS force, relative to the larger of them, from 1e-11 to 1e-2.

    Raises:
        InputError: the scene is of another kind or has other symbols, or inputs are not symbols or repeat one.
        DomainError: the duration is a number not above 0.

    Example:
        >>> import casadi as ca
        >>> import plough_opt as po
        >>> stiffness = ca.MX.sym("stiffness")
        >>> damped = po.Effects(damping=400.0, strength_wave=po.StrengthWave(0.3, 0.2))
        >>> cone = po.Cone("10 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), cone, stiffness, "30 kg", "2 m/s", damped)
        >>> found = po.Batch(scene, "0.2 s", [stiffness])([[5e4], [2e5]])
        >>> len(found.mean_draft)
        2
    """

    def __init__(
        self, scene: Scene, duration: Expression | None, inputs: Sequence[Column], *, error: float = 1e-6
    ) -> None:
        _check_scene(scene)
        duration = duration_of(scene, duration)
        check_single("the duration of a batch", duration)
        symbols = _symbols(inputs)
        self._error = plain_number("error", error, at_least=1e-11, at_most=1e-2)
        self._structure = Structure.of(scene)
        template, quantities = template_of(scene)
        self._check = DomainCheck(template, [None if is_symbolic(q) else float(as_number(q)) for q in quantities])
        varying, values = [q for q in quantities if is_symbolic(q)], parameters(scene)
        # Events, which a batch does not have, would change the mass.
        self._names = tuple(name for name in self._structure.names if name != "mass")
        columns = (
            stacked(*varying, duration),
            stacked(*equation_of(self._structure).column(values, duration)),
            stacked(*(values[name] for name in self._names)),
        )
        given = _of_inputs(symbols, columns)
        self._given, self._inputs = by_rows(given), int(given.numel_in(0))
        self._runs = ManyRuns(self._structure, 0)

    @property
    def compiled(self) -> bool:
        """Whether a C compiler was found. Without one CasADi takes the same steps: see `warnings`."""
        return self._runs.compiled

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the batch as a whole."""
        settles = "whether a share from equilibrium comes to an orbit is unknown: a batch does not follow it there"
        followed = (f"{settles}, as po.simulate does",) if self._structure.orbit == "periodic" else ()
        if self.compiled:
            return followed
        return (
            *followed,
            f"{compiler_problem()}: CasADi interprets the batch, to the same error; with a compiler it would be ten to"
            " a hundred times faster",
        )

    def __call__(self, values: ArrayLike, *, threads: int = 1) -> BatchResult:
        """Simulate designs.

        Args:
            values: inputs of the designs, SI; a row for each design, a column for each input.
            threads: number of threads that share the designs.

        Raises:
            InputError: values are not numbers or have the wrong shape, or threads is not a whole number from 1.
        """
        whole_number("threads", threads, 1)
        began = time.perf_counter()
        rows = array_of(values, "the values of a batch must be numbers, in SI units, not {}")
        if rows.ndim != 2 or rows.shape[1] != self._inputs:
            raise InputError(
                f"the values of a batch have the shape {rows.shape}: they need a row for each design and a column for"
                f" each of the {self._inputs} inputs"
            )
        results = np.full((len(RESULTS) + 3, len(rows)), np.nan)
        reasons: dict[int, str] = {}

        def simulate(start: int) -> None:
            part = slice(start, start + _CHUNK)
            results[:, part], failed = self._simulate(rows[part])
            reasons.update({start + k: reason for k, reason in failed.items()})

        with ThreadPoolExecutor(threads) as pool:
            list((pool.map if threads > 1 else map)(simulate, range(0, len(rows), _CHUNK)))
        found = BatchResult(
            **dict(zip((*RESULTS, "largest_multiplier", "error_estimate", "steps"), results, strict=True)),
            reasons=dict(sorted(reasons.items())),
            wanted=self._error,
            seconds=time.perf_counter() - began,
            warnings=self.warnings,
        )
        count = np.count_nonzero(found.unstable)
        return replace(found, warnings=(*self.warnings, f"{count} designs: {UNSTABLE}")) if count else found

    def stream(self, chunks: Iterable[ArrayLike], *, threads: int = 1) -> Iterator[BatchResult]:
        """Yield the results of chunks of designs one after the other, so that memory does not grow with their number.

        Args:
            chunks: arrays of values, as for a call.
            threads: number of threads, as for a call.

        Raises:
            InputError: chunks does not yield arrays, or a call would raise.

        Example:
            >>> import casadi as ca
            >>> import plough_opt as po
            >>> mass = ca.MX.sym("mass")
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), cone, 5e4, mass, 2.0, po.Effects(damping=400.0))
            >>> batch = po.Batch(scene, 0.1, [mass])
            >>> [len(found.mean_draft) for found in batch.stream([[[20.0], [25.0]], [[30.0]]])]
            [2, 1]
        """
        if is_casadi(chunks) or not isinstance(chunks, Iterable):
            raise InputError(f"chunks = {shown(chunks)} must be a list or a generator of arrays")
        for chunk in chunks:
            yield self(chunk, threads=threads)

    def _simulate(self, rows: Array) -> tuple[Array, dict[int, str]]:
        """Return a row for each result, multiplier, error and number of steps, and why designs failed, by position."""
        quantities, p, known = self._given(rows)
        reasons = self._check.reasons(quantities.T)
        if self._structure.ramp:
            ramps = known[:, self._names.index("ramp_time")]
            reasons |= {int(k): _NO_RAMP for k in np.flatnonzero(~(ramps > SHORTEST_RAMP)) if int(k) not in reasons}
        sound = np.delete(np.arange(len(rows)), list(reasons))
        results = np.full((len(RESULTS) + 3, len(rows)), np.nan)
        with np.errstate(all="ignore"):
            results[:, sound] = self._integrate(p[sound], known[sound])
        for k in sound[~np.isfinite(results[: len(RESULTS), sound]).all(axis=0)]:
            reasons[int(k)] = self._reason(quantities[k], results[-1, k])
            results[:-1, k] = np.nan
        return results, reasons

    def _integrate(self, p: Array, known: Array) -> Array:
        """Return results, multipliers, errors and numbers of steps, a row each, of designs within the domain.

        Args:
            p: parameters of the runs, a row for each design.
            known: parameters by `_names`, a row for each design.
        """
        first, unit, planned = self._runs.planned(p)
        count = equation_of(self._structure).count

        def averages(which: NDArray[np.int64], steps: Array) -> Array:
            limited = np.where(steps <= _MOST_STEPS, steps, np.nan)
            found, largest = self._runs.integrate(p[which], first[which], unit[which], limited)
            named = dict(zip(self._names, known[which].T, strict=True))
            return np.stack([*self._structure.averages(named, *np.split(found.T, [count])), largest])

        results, which = np.empty((len(RESULTS) + 3, len(p))), np.arange(len(p))
        margin = _MARGIN_OF_OWN if self._structure.own else 1.0
        check = _CHECK_OF_KINKS if self._structure.kinked or self._structure.own else _CHECK
        finer = _FIRST * max(1e-6 / self._error, 1.0) ** 0.125
        needed = np.maximum(planned[:, 1], FEWEST_COARSE_STEPS)
        steps = np.minimum(self._runs.whole(finer * needed), _MOST_STEPS)
        steps = np.where(needed <= _MOST_STEPS, steps, needed)
        before = averages(which, np.ceil(check * steps))
        for _ in range(1 + _REPETITIONS):
            now = averages(which, steps)
            size, apart = np.maximum(np.abs(now[0]), now[1]), np.abs(now[:2] - before[:2]).max(axis=0)
            error = margin * np.divide(apart, size, out=np.zeros_like(size), where=apart != 0.0) + _EPSILON * steps
            error[np.isnan(error)] = np.inf
            results[:, which] = *now, error, steps
            again = (error > self._error) & (steps <= check * _MOST_STEPS)
            if not again.any():
                break
            which, before, steps = which[again], now[:, again], self._runs.whole(steps[again] / check)
        return results

    def _reason(self, quantities: Array, steps: float) -> str:
        """Return why a design within the domain failed."""
        scene = self._check.scene(lambda k: float(quantities[k]))
        try:
            description = scene.describe()
        except PloughError as error:  # such as a density profile without a compaction front
            return str(error)
        if steps > _MOST_STEPS:
            return (
                f"the motion of a {description} takes more than {_MOST_STEPS} steps: use the quasi-static scene"
                " (Effects(motion=False)), a softer or a damped mount, or a shorter duration"
            )
        if scene.effects.orbit == "periodic":
            return without_orbit(scene)
        return f"the motion of a {description} has no finite mean: the share is driven away; po.simulate reports when"


def _of_inputs(inputs: Sequence[Column], results: Sequence[Column]) -> ca.Function:
    """Return the Function of a column of all inputs with these results, of SX if their graphs allow that.

    Raises:
        InputError: a result depends on other symbols than the inputs.
    """
    dense: list[Any] = [ca.densify(result) for result in results]
    inner = ca.Function("inner", list(inputs), dense, {"allow_free": True})
    if inner.has_free():
        raise InputError(f"the scene depends on {', '.join(inner.get_free())}: name it among the inputs of the batch")
    if inner.is_a("MXFunction") and (labels := labels_in(inner)):
        inner = ca.Function("inner", list(inputs), without_labels(dense, labels))
    column = ca.MX.sym("column", sum(symbol.numel() for symbol in inputs))
    ends = itertools.accumulate((symbol.numel() for symbol in inputs), initial=0)
    parts = [ca.reshape(column[a:b], *x.shape) for x, (a, b) in zip(inputs, itertools.pairwise(ends), strict=True)]
    function = ca.Function("of_inputs", [column], inner.call(parts))
    with suppress(RuntimeError):  # the solution of linear equations has no graph of scalar operations
        function = function.expand()
    return function


def _symbols(inputs: Sequence[Column]) -> list[Expression]:
    """Return the inputs as a list.

    Raises:
        InputError: an input is not a symbol, or one is named twice.
    """
    symbols = list(inputs) if isinstance(inputs, Sequence) else []
    if not symbols or not all(is_symbolic(one) and one.is_valid_input() for one in symbols):
        raise InputError("the inputs of a batch must be a list of the CasADi symbols in its scene")
    if len({type(one) for one in symbols}) > 1:
        raise InputError("the inputs of a batch must be all SX or all MX")
    distinct = ca.symvar(ca.veccat(*symbols))
    if sum(one.numel() for one in distinct) < sum(one.numel() for one in symbols):
        raise InputError("an input of the batch is named twice: name each symbol once")
    return symbols


def _check_scene(scene: Scene) -> None:
    """Raise InputError if a batch cannot integrate the motion of a scene."""
    check_kind("the scene", scene, Scene, "a Scene, made of soil, share, stiffness, mass and tow speed")
    effects = scene.effects
    if not effects.motion:
        raise InputError(
            "a batch integrates a motion, and a quasi-static scene has none: use po.simulate(scene, duration) with"
            " symbols and a casadi.Function of its averages, which costs next to nothing"
        )
    if effects.orbit == "periodic" and effects.own:
        raise InputError(
            "a batch cannot check whether own resistances repeat themselves with the wave: use po.simulate for the"
            " periodic orbit of each design"
        )
    if effects.tow_profile is not None:
        raise InputError("a batch has a constant tow speed or a tow_ramp: use po.simulate for each design")
    if effects.events:
        cause = "StickSlip" if isinstance(effects.contact, StickSlip) else "the entry of a share"
        raise InputError(
            f"a batch cannot locate the events of {cause}: use Smooth(width) as contact and a share that is buried from"
            " the start, or po.simulate for each design"
        )


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
        error_estimate: estimated error of mean draft and RMS force, relative to the larger of them [-]: the difference
            from a run of two thirds of the steps, or of half of them under contact `Smooth` and own resistances; times
            four under the latter. It is usually about 25 times the error. Of 32,000 random scenes it covers 99.8 % of
            the errors if 1e-6 or less is wanted, and 99.4 % if 1e-2 is.
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
        heading = (
            f"{len(self)} designs in {self.seconds:.3g} s, {len(self.reasons)} without results,"
            f" {np.count_nonzero(self.missed)} with an estimated error above {self.wanted:g}"
        )
        return Page(heading, (*([table] if table.rows else []), *lost), self.warnings)

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
