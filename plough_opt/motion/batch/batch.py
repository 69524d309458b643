"""`Batch`: the averages of very many designs of one scene, and the reasons why designs lie outside the domain."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core.checks import (
    array_of,
    check_domain,
    check_kind,
    check_single,
    limits_of_numbers,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.compiler import compiler_problem
from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.expressions import (
    Column,
    Expression,
    as_number,
    is_casadi,
    is_quantity,
    is_symbolic,
    map_expressions,
    stacked,
    template_of,
)
from plough_opt.core.files import drawn
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import BESIDE
from plough_opt.core.saving import Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import customary
from plough_opt.motion.batch.advance import (
    RESULTS,
    Layout,
    Matrix,
    advance,
    ellipse_after,
    function_of_column,
    results_of,
    setup,
)
from plough_opt.motion.batch.series import Engine
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.effects.terms import SHORTEST_RAMP
from plough_opt.motion.equation import Structure, check_strength, equation_of
from plough_opt.motion.scene import Scene, duration_of
from plough_opt.motion.solvers.orbit import inverse, near_orbit, returning, without_orbit
from plough_opt.motion.vocabulary import called

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


class DomainCheck:
    """Rebuilds a scene with the numbers of many designs, and finds those for which that raises an error.

    All designs are tried at once, as arrays, and only those beyond a limit one by one. If arrays fail, as in a class of
    the user's, they are halved.
    """

    def __init__(self, template: Scene, fixed: list[float | None]) -> None:
        """Take the scene to rebuild.

        Args:
            template: the scene with a placeholder for each quantity.
            fixed: the value of each placeholder, or None if it varies between designs.
        """
        numbers = iter(fixed)
        # Parts of the scene that do not vary are built once.
        self._template = map_expressions(
            template, lambda placeholder: placeholder if (number := next(numbers)) is None else number, is_quantity
        )
        self._varying = fixed.count(None)

    def reasons(self, rows: Array, *, declared: bool = True) -> dict[int, str]:
        """Return the positions of the designs outside the domain, each with the reason.

        Args:
            rows: a row for each quantity that varies, then one for the duration; a column for each design.
            declared: whether limits that `check_domain` declares count, or only other errors of a user's class.
        """
        reasons: dict[int, str] = {}
        with np.errstate(all="ignore"):
            for k in self._suspects(rows, np.arange(rows.shape[1]), declared):
                try:
                    with nullcontext() if declared else limits_of_numbers():
                        self.scene(rows[:, k].tolist().__getitem__)
                except PloughError as error:
                    reasons[int(k)] = str(error)
        return reasons

    def scene(self, value: Callable[[int], Any]) -> Scene:
        """Return the scene with the given values of the quantities that vary.

        Args:
            value: index of such a quantity -> its value; the index after the last one is that of the duration.

        Raises:
            DomainError: a value outside the model's domain.
        """
        values = map(value, range(self._varying))
        scene: Scene = map_expressions(self._template, lambda _: next(values))
        if scene.effects.orbit != "transient":
            check_domain("tow speed", scene.tow_speed, "m/s", above=0.0, why="a standing share has no orbit")
        BESIDE["scene.duration"].check(value(self._varying))
        if scene.soil.density_profile is None:
            scene.check_reaction()
        else:  # a profile accepts no arrays; designs without a compaction front have no finite results anyway
            check_strength(scene.effects.waves)
        return scene

    def _suspects(self, rows: Array, where: NDArray[np.int64], declared: bool) -> NDArray[np.int64]:
        """Return those among some designs that have to be tried one by one."""
        if len(where) <= 1:
            return where
        inside = np.ones(len(where), dtype=bool)
        try:
            with limits_of_numbers() as limits:
                self.scene(lambda row: rows[row, where])
            for limit, values in limits if declared else ():
                inside &= limit.holds(values)
        except Exception:  # a user's own class may raise any error for arrays
            halves = (self._suspects(rows, part, declared) for part in np.array_split(where, 2))
            return np.concatenate([*halves])
        return where[~inside]


# Designs that one thread holds in memory at once.
_CHUNK = 16384
# Steps after which a design is given up.
_MOST_TAYLOR_STEPS = 200_000
# How often a design that misses the wanted error is repeated with shorter steps.
_REPETITIONS = 4
# A repetition aims at this part of the wanted error.
_RESERVE = 0.3
# A repetition divides the allowed error of a step by at most a million.
_LARGEST_CUT = 1e-6
# Map of deviations that changes none.
_UNMOVED: Matrix = (ca.SX(1), ca.SX(0), ca.SX(0), ca.SX(1))
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

    The motion is integrated by its Taylor series in time. The wanted error decides the order, and the last terms of the
    series decide the step sizes of each design. The recurrences of the coefficients follow from the graph of the
    right-hand side; they are written in C and compiled for the processor's vector registers, once for each kind of
    scene.

    A periodic orbit is found by Newton's method on the map of one wavelength, from the linear response. Its error
    estimate includes that of the state at time 0, which the map of deviations over one wavelength amplifies. Unlike
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
        self._error = error = plain_number("error", error, at_least=1e-11, at_most=1e-2)
        self._layout = Layout.of(equation_of(Structure.of(scene)))
        template, quantities = template_of(scene)
        self._check = DomainCheck(template, [None if is_symbolic(q) else float(as_number(q)) for q in quantities])
        varying = [q for q in quantities if is_symbolic(q)]
        functions = {
            "quantities": function_of_column("quantities", symbols, stacked(*varying, duration)),
            "setup": setup(self._layout, scene, duration, symbols, error),
        }
        if scene.effects.orbit == "periodic":
            p, q = ca.SX.sym("p", len(self._layout.names) + 1), ca.SX.sym("q", 8)
            functions["near"] = ca.Function("near", [p], [ca.vertcat(*near_orbit(self._layout.equation)(p))])
            missed = ellipse_after(ca.vertsplit(q[:3]), _UNMOVED, q[3])
            functions["closed"] = ca.Function(
                "closed", [q], [ca.vertcat(*ellipse_after(missed, (q[4], q[5], q[6], q[7]), ca.SX(0)))]
            )
        self._inputs = functions["setup"].numel_in(0)
        # One order more for every digit of the wanted error, and ten because a step may make only a small part of it.
        order = round(10.0 - math.log10(error))
        phases = tuple((advance(self._layout, order, phase), end) for phase, end in enumerate(self._layout.ends))
        self._engine = Engine(functions, phases, self._layout.parameters)

    @property
    def compiled(self) -> bool:
        """Whether a C compiler was found. Without one NumPy does the same operations: see `warnings`."""
        return self._engine.compiled

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the batch as a whole."""
        settles = "whether a share from equilibrium comes to an orbit is unknown: a batch does not follow it there"
        followed = (f"{settles}, as po.simulate does",) if self._layout.structure.orbit == "periodic" else ()
        if self.compiled:
            return followed
        return (
            *followed,
            f"{compiler_problem()}: NumPy evaluates the batch, with the same results; with a compiler it would be about"
            " ten times faster for thousands of designs, and a hundred times for tens",
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
        rows = self._rows(values)
        starts = range(0, rows.shape[1], _CHUNK)
        results = np.full((len(RESULTS) + 3, rows.shape[1]), np.nan)
        reasons: dict[int, str] = {}

        def simulate(start: int) -> None:
            part = slice(start, start + _CHUNK)
            results[:, part], failed = self._simulate(np.ascontiguousarray(rows[:, part]))
            reasons.update({start + k: reason for k, reason in failed.items()})

        if threads == 1:
            list(map(simulate, starts))
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(simulate, starts))
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

    def _rows(self, values: ArrayLike) -> Array:
        """Return values as an array with a row for each input."""
        array = array_of(values, "the values of a batch must be numbers, in SI units, not {}")
        if array.ndim != 2 or array.shape[1] != self._inputs:
            raise InputError(
                f"the values of a batch have the shape {array.shape}: they need a row for each design and a column for"
                f" each of the {self._inputs} inputs"
            )
        return array.T

    def _simulate(self, rows: Array) -> tuple[Array, dict[int, str]]:
        """Return a row for each result, multiplier, error and number of steps, and why designs failed, by position."""
        layout = self._layout
        best = np.full((len(RESULTS) + 3, rows.shape[1]), np.nan)
        quantities = self._engine.evaluate("quantities", rows)
        reasons = self._check.reasons(quantities)
        prepared = self._engine.evaluate("setup", rows)
        if layout.structure.ramp:
            ramps = prepared[layout.names.index("ramp_time")]
            reasons |= {int(k): _NO_RAMP for k in np.flatnonzero(~(ramps > SHORTEST_RAMP)) if int(k) not in reasons}
        which = np.delete(np.arange(rows.shape[1]), list(reasons))
        prepared = prepared if len(which) == rows.shape[1] else prepared[:, which]
        # Designs in one register wait for the slowest of them; those of similar phase take similar numbers of steps.
        results = self._integrate(prepared, prepared[layout.parameters])
        best[:, which] = results
        for _ in range(_REPETITIONS):
            again = results[-2] > self._error
            if not np.any(again):
                break
            which, before = which[again], results[:, again]
            cut = np.clip(_RESERVE * self._error / before[-2], _LARGEST_CUT, _RESERVE)
            prepared = prepared[:, again]
            prepared[layout.allowed_error] *= cut
            results = self._integrate(prepared, before[-1])
            better = results[-2] < before[-2]
            best[:, which[better]] = results[:, better]
            # If shorter steps hardly lower the error, it is due to rounding or to a chaotic motion.
            worthwhile = results[-2] <= np.sqrt(cut) * before[-2]
            which, prepared, results = which[worthwhile], prepared[:, worthwhile], results[:, worthwhile]
        for k in np.flatnonzero(~np.isfinite(best[: len(RESULTS)]).all(axis=0)):
            best[:-1, k] = np.nan
            if int(k) not in reasons:
                reasons[int(k)] = self._reason(quantities[:, k], best[-1, k])
        return best, reasons

    def _integrate(self, prepared: Array, key: Array) -> Array:
        """Return results, multipliers, errors and steps of designs, a row each.

        Results are NaN if a run took too many steps, or if no orbit was found.

        Args:
            prepared: results of `setup`.
            key: a number for each design; designs with similar keys are integrated side by side.
        """
        layout, count = self._layout, self._layout.parameters
        p, known = np.ascontiguousarray(prepared[:count]), dict(zip(layout.known, prepared[count + 1 :], strict=True))
        states, largest = np.zeros((layout.states, p.shape[1])), np.full(p.shape[1], np.nan)
        states[2] = layout.structure.start_rate(known)
        if layout.structure.orbit == "periodic":
            states, largest = self._on_orbits(p, key)
        steps = self._run(p, states, key)
        results = np.empty((len(RESULTS) + 3, p.shape[1]))
        with np.errstate(all="ignore"):
            *results[: len(RESULTS)], results[-2] = results_of(layout, known, states[3:])
        results[-3], results[-1] = largest, steps
        # Of a finished run only the error may have left the range of floating point.
        results[:-1, np.isnan(states[0])] = np.nan
        return results

    def _run(self, p: Array, states: Array, key: Array) -> Array:
        """Integrate designs, and return their numbers of steps; unfinished ones get NaN as states."""
        sound = np.flatnonzero(np.isfinite(states).all(axis=0))
        steps = self._engine.run(p, states, sound[np.argsort(key[sound])], _MOST_TAYLOR_STEPS)
        states[:, ~(states[0] >= p[self._layout.ends[-1]])] = np.nan
        return steps

    def _on_orbits(self, p: Array, key: Array) -> tuple[Array, Array]:
        """Return the states of orbits at time 0, and the absolute values of their largest multipliers.

        A state has NaN if no orbit was found. Its error ellipse holds the orbit: if e is the error of the state after a
        period, that of the state before it is (1 - slope)^-1 e.
        """
        layout, motion = self._layout, slice(1, 3)

        def after(which: NDArray[np.int64], first: Array) -> Array:
            states = np.zeros((layout.states, len(which)))
            states[motion] = first.T
            self._run(np.ascontiguousarray(p[:, which]), states, key[which])
            return states

        near = self._engine.evaluate("near", p[[*range(len(layout.names)), layout.ends[-1]]])
        guess, unit = near[:2].T, near[2:].T
        first, slope = returning(lambda which, tried: after(which, tried)[motion].T, guess, unit)
        last = after(np.arange(p.shape[1]), first)
        # The plane of the ellipse is that of w and w'/s, with the mount's angular frequency s.
        stiffness, inertia = (p[layout.names.index(name)] for name in ("stiffness", "inertia"))
        metres = np.stack([np.ones_like(inertia), np.sqrt(inertia / np.abs(stiffness))], axis=1)
        scale = unit * metres
        gain = inverse(np.eye(2) - slope * scale[:, :, None] / scale[:, None, :])
        missed = np.linalg.norm(metres * (last[motion].T - first), axis=1)
        states = np.zeros((layout.states, p.shape[1]))
        states[motion] = first.T
        states[-4:-1] = self._engine.evaluate("closed", np.vstack([last[-4:-1], missed, gain.reshape(-1, 4).T]))
        finite = np.where(np.isfinite(slope), slope, 0.0)
        return states, np.abs(np.linalg.eigvals(finite)).max(axis=1)

    def _reason(self, quantities: Array, steps: float) -> str:
        """Return why a design within the domain failed."""
        scene = self._check.scene(lambda k: float(quantities[k]))
        try:
            description = scene.describe()
        except PloughError as error:  # such as a density profile without a compaction front
            return str(error)
        if scene.effects.orbit == "periodic" and steps < _MOST_TAYLOR_STEPS:
            return without_orbit(scene)
        if steps >= _MOST_TAYLOR_STEPS:
            return (
                f"the motion of a {description} takes more than {_MOST_TAYLOR_STEPS} steps: use the quasi-static scene"
                " (Effects(motion=False)), a softer or a damped mount, or a shorter duration"
            )
        return f"the motion of a {description} has no finite mean: the share is driven away; po.simulate reports when"


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
    if effects.orbit not in ("transient", "periodic"):
        raise InputError(
            "a batch does not approximate periodic orbits: use orbit = 'periodic', or po.simulate for each design"
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
