"""Contestants that simulate a scene, and their contest: what each setting costs, and how far it is off.

Contestants are integrators, for values and gradients, and models that simplify the motion. Each is measured at a few of
its settings in any case. Contestants that may be the cheapest are then narrowed down by halving, to two neighbouring
settings that differ by a tenth in cost, of which only the finer one reaches the wanted error. Where that ends depends
on the errors alone, not on the clock or on what else was measured. Last, good settings that may be the cheapest are
timed again in turns, so that other work on the machine disturbs all of them alike.
"""

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeAlias, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, IntegrationError, PloughError
from plough_opt.core.expressions import as_number
from plough_opt.core.plain_data import Array
from plough_opt.motion import Run, simulate
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import Structure
from plough_opt.motion.methods import DEFAULT_ERROR, METHODS, ORDER_8, Accuracy, adaptive, fixed_step
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.checks import refuse_missed_event
from plough_opt.motion.solvers.compiled_steps import compiled_steps
from plough_opt.motion.solvers.integrators import Case, assemble, integration, quasi_static
from plough_opt.motion.solvers.plan import most_steps, numbers_of, phase, rates_of, steps_for, timeline_of, with_setting
from plough_opt.studies.accuracy.reference import AVERAGES, QUANTITIES, Reference, ReferenceGradient, errors_of
from plough_opt.studies.accuracy.result import AUTO, BARE, COMPILED, MACHINE_CODE, MethodResult, efficient, error_text

ERRORS: Final = (1e-3, 1e-5, 1e-6, 1e-8, 1e-10)
"""Wanted errors at which "auto" is measured in any case."""

TOLERANCES: Final = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
"""Relative tolerances at which adaptive methods are measured in any case."""

FACTORS: Final = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Multiples of the default number of steps at which other methods are measured in any case."""

GRADIENT_TOLERANCES: Final = (1e-6, 1e-9)
"""Relative tolerances for gradients."""

GRADIENT_FACTORS: Final = (0.5, 1.0, 2.0)
"""Multiples of the default number of steps for gradients."""

# Lower bound of the time of one explicit step [s]. Settings that cannot meet the allowance are left out by it.
_ONE_STEP = 2e-6
# Largest phase of the fastest oscillation in one stable step of "erk" [rad].
_STABLE_PHASE = 1.5
# Factor on the time of a run for its gradient.
_GRADIENT = 10.0
# All tolerances that narrowing may try. For methods of usual order neighbours differ by about a tenth in cost.
_ALL_TOLERANCES: Final = tuple(float(f"{digit}e-{power}") for power in range(2, 13) for digit in (5, 3, 2, 1))
# Smallest error that "auto" accepts.
_TIGHTEST = 1e-12
# Factor on the time allowed to the default, which is reported even if it takes long.
_DEFAULT_PATIENCE = 20.0
# Factor by which the next finer setting may be expected to take longer.
_NEXT_SETTING: Final = 3.0
# Contestants within this factor of the least time are narrowed down; their coarsest good setting is timed again.
_WORTH_NARROWING: Final = 4.0
# Other good settings within this factor of the least time are timed again too.
_CLOSE: Final = 1.6
# Turns in which settings are timed; fewer if they take long, but at least so many of settings that are timed again.
_TURNS: Final = 15
_FEWEST_TURNS: Final = 3
# Least time of one setting in a turn [s]: a shorter use is repeated.
_LEAST_TURN: Final = 3e-3
# Time after which no further turn begins, in allowances of one use: of one setting alone, and of those timed again.
_REPETITIONS: Final = 0.1
_ALL_TURNS: Final = 2.0
# Exponent of the coarsest number of steps, in eighths of a power of two: a 128th of the usual number.
_COARSEST: Final = -56

Use = Callable[[], object]
"""One use of a method, which is timed."""

Errors = Callable[[Any], Mapping[str, float]]
"""Function that returns the relative errors of a result by name."""

Prepare: TypeAlias = Callable[[Any], Use | tuple[Use, Callable[[], Any]]]
"""Function of a setting that returns a use that gives the result, or a use to time and a function for the result."""

Check: TypeAlias = Callable[[Any], Use] | None
"""Function of a setting that returns the use of `simulate` with it; None if the method has no check."""

_Number = TypeVar("_Number", int, float)


@dataclass(frozen=True)
class Contestant:
    """A method and its settings.

    Attributes:
        family: family of its entries.
        method: name of the method.
        prepare: setting -> function that returns the result; or two functions, one to time and one for the result.
        errors: result -> relative errors by name.
        settings: settings from coarse to fine; neighbours differ by about a tenth in cost.
        always: places of the settings to measure in any case; None for all of them, without narrowing down.
        label: setting -> text.
        least_time: setting -> lower bound of the time of one use [s].
        patient: setting that is given more time.
        check: setting -> use of `simulate` with it; None if the method has no check or checks itself.
    """

    family: str
    method: str
    prepare: Prepare
    errors: Errors
    settings: Sequence[Any] = ("",)
    always: Sequence[int] | None = None
    label: Callable[[Any], str] = str
    least_time: Callable[[Any], float] = lambda _: 0.0
    patient: Any = None
    check: Check = None


def step_counts(usual: float, factors: Sequence[float], unit: int = 1) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return numbers of steps from coarse to fine in ratios of 2^(1/8), and the places of multiples of the usual one.

    Args:
        usual: usual number of steps.
        factors: the multiples, powers of two.
        unit: divisor of every number of steps.
    """

    def steps(eighths: float) -> int:
        return max(1, math.ceil(usual * math.exp2(eighths / 8.0) / unit - 1e-9)) * unit

    counts = list(dict.fromkeys(steps(k) for k in range(_COARSEST, 8 * round(math.log2(max(factors))) + 1)))
    places = dict.fromkeys(counts.index(steps(8.0 * math.log2(factor))) for factor in factors)
    return tuple(counts), tuple(places)


def refuse(reason: str, *_: Any) -> Any:
    """Raise InputError in place of preparing a contestant that cannot take part."""
    raise InputError(reason)


def measured(
    contestants: Sequence[Contestant], key: str, wanted: float, allowance: float, *, floor: float = 0.0
) -> list[MethodResult]:
    """Return the entries of contestants: settings measured in any case, and those that led to the cheapest good one.

    Args:
        contestants: methods that are ranked together.
        key: key of `MethodResult.errors` that ranks them.
        wanted: error to reach [-].
        allowance: time that one use may take [s].
        floor: error of the reference itself [-].
    """
    trials = [_Trial(contestant, key, wanted, allowance) for contestant in contestants]
    for trial in trials:
        trial.measure_always()
    best = min((trial.least for trial in trials), default=math.inf)
    for trial in trials:
        if trial.contestant.always is not None and trial.least <= _WORTH_NARROWING * best < math.inf:
            trial.narrow()
    _time_again(trials, allowance)
    entries = [entry for trial in trials for entry in trial.entries.values()]
    front = efficient(entries, key, floor)
    for trial in trials:
        trial.check(front)
    return [trial.entries[place] for trial in trials for place in sorted(trial.entries)]


class _Trial:
    """Measurements of one contestant.

    Attributes:
        contestant: the contestant.
        entries: place of a setting -> entry.
        uses: place of a setting -> what is timed.
    """

    def __init__(self, contestant: Contestant, key: str, wanted: float, allowance: float) -> None:
        self.contestant = contestant
        self.entries: dict[int, MethodResult] = {}
        self.uses: dict[int, Use] = {}
        self._key, self._wanted, self._allowance = key, wanted, allowance

    def measure_always(self) -> None:
        """Measure the settings that are measured in any case, until one is expected to take too long."""
        contestant, expected = self.contestant, 0.0
        every = range(len(contestant.settings))
        for place in every if contestant.always is None else contestant.always:
            setting = contestant.settings[place]
            expected = max(expected, contestant.least_time(setting))
            allowed = self._allowance * (_DEFAULT_PATIENCE if setting == contestant.patient else 1.0)
            if expected > allowed:
                self._fail(place, f"cut off: expected to take {expected:.2g} s, {allowed:.2g} s allowed")
            else:
                expected = _NEXT_SETTING * self._measure(place)

    def _measure(self, place: int) -> float:
        """Measure a setting; return the time of one use [s], or of its failure."""
        contestant, setting = self.contestant, self.contestant.settings[place]
        started, clock = time.process_time(), time.perf_counter()
        try:
            prepared = contestant.prepare(setting)
            use, find = prepared if isinstance(prepared, tuple) else (prepared, prepared)
            built = time.perf_counter() - clock  # elapsed time, because a compiler is another process
            solving = time.process_time()
            result = find()
            seconds = time.process_time() - solving
            errors = contestant.errors(result)
        except (PloughError, RuntimeError) as error:
            self._fail(place, _reason(error))
            return time.process_time() - started
        first = solving + seconds - started
        seconds = min(seconds, *least_times([use], _REPETITIONS * self._allowance))
        setup, label = max(built, first - seconds), contestant.label(setting)
        self.entries[place] = MethodResult(contestant.family, contestant.method, label, seconds, setup, errors)
        self.uses[place] = use
        return seconds

    def _fail(self, place: int, reason: str) -> None:
        c = self.contestant
        self.entries[place] = MethodResult(c.family, c.method, c.label(c.settings[place]), math.inf, failure=reason)

    @property
    def good(self) -> dict[int, MethodResult]:
        """Entries that reach the wanted error, by place."""
        return {place: entry for place, entry in self.entries.items() if entry.reaches(self._key, self._wanted)}

    @property
    def least(self) -> float:
        """Least time of a setting that reaches the wanted error [s]; infinite if none does."""
        return min((entry.seconds for entry in self.good.values()), default=math.inf)

    def narrow(self) -> None:
        """Halve the settings until only the finer one of two neighbours reaches the wanted error.

        The halving covers all settings, so that it ends at the same pair whichever of them were measured before.
        Settings finer than one that is known to be good count as good without being measured, for they may take long.
        """
        least_good, bad, good = min(self.good), -1, len(self.contestant.settings) - 1
        while good - bad > 1:
            middle = (good + bad) // 2
            measured_before = middle in self.entries
            if middle < least_good and not measured_before:
                self._measure(middle)
            if middle >= least_good or middle in self.good:
                good = middle
            else:
                bad = middle
                if self.entries[middle].failure is not None and not measured_before:
                    del self.entries[middle]  # too coarse to have a result, and not one that is always reported

    def check(self, front: Sequence[MethodResult]) -> None:
        """Time `simulate`, which checks its result, with the settings on an efficient front."""
        check = self.contestant.check
        for place, entry in self.entries.items():
            if check is not None and entry in front:
                with contextlib.suppress(PloughError):
                    use = check(self.contestant.settings[place])
                    use()
                    checked = least_times([use], _REPETITIONS * self._allowance)[0]
                    self.entries[place] = replace(entry, checked=checked)


def _time_again(trials: list[_Trial], allowance: float) -> None:
    """Time the settings that may be the cheapest again, in turns."""
    best = min((trial.least for trial in trials), default=math.inf)
    good = ((trial, place, entry.seconds) for trial in trials for place, entry in trial.good.items())
    close = [(trial, place) for trial, place, seconds in good
             if seconds <= (_WORTH_NARROWING if place == min(trial.good) else _CLOSE) * best]  # fmt: skip
    if len(close) > 1:
        seconds = least_times([trial.uses[place] for trial, place in close], _ALL_TURNS * allowance, _FEWEST_TURNS)
        for (trial, place), least in zip(close, seconds, strict=True):
            trial.entries[place] = replace(trial.entries[place], seconds=least)


def _reason(error: Exception) -> str:
    """Return the reason of a failure; of a message of CasADi, which has many lines, only the last one."""
    if isinstance(error, PloughError):
        return str(error)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"CasADi failed: {lines[-1] if lines else type(error).__name__}"


def least_times(uses: Sequence[Use], enough: float, fewest: int = 1) -> list[float]:
    """Return the least processor time of each use in several turns [s]: other work on the machine only adds to it.

    Processor time is that of this process.

    Args:
        uses: what to time, each used before, so that it needs no warm-up.
        enough: time of all turns after which no further turn begins [s].
        fewest: number of turns in any case.
    """
    least, spent = [math.inf] * len(uses), 0.0
    for turn in range(_TURNS):
        if turn >= fewest and spent > enough:
            break
        for k, use in enumerate(uses):
            # Repeat by the clock rather than by the time measured before: a coarse clock shows 0 for a short use.
            often, taken, started = 0, 0.0, time.process_time()
            while taken < _LEAST_TURN:
                # A repetition may exceed a time limit that the first use just kept.
                with contextlib.suppress(PloughError, RuntimeError):
                    use()
                often, taken = often + 1, time.process_time() - started
            least[k] = min(least[k], taken / often)
            spent += taken
    return least


# --- the contestants ---


@dataclass(frozen=True)
class Task:
    """Task that all methods are measured on.

    Attributes:
        scene: scene with numbers.
        duration: simulated time; for a periodic orbit its period [s].
        outputs: number of equal intervals between output times.
        allowance: time that one use of a method may take [s].
        thin: whether to leave out every other setting except the finest; the advice stays the same.
        wanted: relative error at which "auto" is measured in addition to `ERRORS` [-].
    """

    scene: Scene
    duration: float
    outputs: int
    allowance: float
    thin: bool = False
    wanted: float = DEFAULT_ERROR

    @property
    def given(self) -> float | None:
        """Duration as `simulate` takes it: None for a periodic orbit."""
        return self.duration if self.scene.effects.orbit == "transient" else None

    def some(self, settings: tuple[_Number, ...]) -> tuple[_Number, ...]:
        """Return the settings; in a thin study every other one and the last, so that it reaches the same errors."""
        if not self.thin:
            return settings
        return settings[::2] if len(settings) % 2 else settings[::2] + settings[-1:]

    def ranked(self, contestants: list[Contestant], key: str, floor: float = 0.0) -> list[MethodResult]:
        """Return the entries of contestants that are ranked by one error."""
        return measured(contestants, key, self.wanted, self.allowance, floor=floor)


def prepared(task: Task, accuracy: Accuracy, *, compiled: bool = False) -> tuple[Use, Callable[[], Run]]:
    """Return two functions: one integration by a named method, without the check that `simulate` adds; and its run.

    Args:
        task: the task.
        accuracy: the method with its setting.
        compiled: whether to take steps of order 8 in machine code.
    """
    case = Case.of(task.scene, task.duration, task.outputs, compiled=compiled)
    timeline = case.timeline(task.outputs, accuracy, most_steps(case.phase))
    if case.code is not None:
        once: Use = partial(case.code, timeline, case.column)
    else:
        once = partial(integration(case.structure, accuracy, timeline).function.call, [ca.DM(case.column)])

    def run() -> Run:
        states, means, variances = _finite(once())
        states = states.T if case.code is None else states
        fractions = timeline.output_fractions
        averages = means.ravel(), variances.ravel()
        motion = assemble(task.scene, case.p, task.duration, fractions, states, *averages, accuracy)
        if isinstance(task.scene.effects.contact, StickSlip):
            refuse_missed_event(motion)
        return motion

    return once, run


def _finite(results: Any) -> list[Array]:
    """Return results as arrays; raise IntegrationError if there are none, or one is not finite."""
    arrays = [np.asarray(part) for part in results or ()]
    if not arrays or not all(np.all(np.isfinite(part)) for part in arrays):
        raise IntegrationError("the result is not finite")
    return arrays


def integrators(task: Task, reference: Reference) -> list[MethodResult]:
    """Return the entries of all methods that can integrate the scene, interpreted and in machine code."""
    reasons = _reasons(task.scene)
    families: list[tuple[str, str, dict[str, str], bool]] = [("integrator", AUTO, {m: m for m in reasons}, False)]
    structure = Structure.of(task.scene)
    if structure.stepped and compiled_steps(structure) is not None:
        families.append((MACHINE_CODE, COMPILED, {BARE: "dop853"}, True))
    errors = partial(errors_of, reference=reference.run)
    entries = []
    for family, auto, names, compiled in families:
        simulated = partial(_simulated, task, compiled=compiled)
        once = partial(prepared, task, compiled=compiled)
        automatic = automatic_settings(task)
        patient = Accuracy(error=DEFAULT_ERROR)
        contestants = [Contestant(family, auto, simulated, errors, automatic, label=text, patient=patient)]
        for name, method in names.items():
            if why := reasons[method]:
                contestants.append(Contestant(family, name, partial(refuse, why), errors))
            else:
                contestants.append(_contestant(task, family, method, once, errors, name=name, check=simulated))
        entries += task.ranked(contestants, "averages", reference.errors["averages"])
    return entries


def _simulated(task: Task, accuracy: Accuracy, *, compiled: bool) -> Callable[[], Run]:
    """Return a use of `simulate`, which checks its result."""
    return partial(simulate, task.scene, task.given, accuracy=accuracy, outputs=task.outputs, compiled=compiled)


def gradients(task: Task, reference: ReferenceGradient) -> list[MethodResult]:
    """Return the entries of all methods for the gradient of mean draft and RMS, by CasADi's derivatives of the run."""
    at = [float(getattr(task.scene, name)) for name in QUANTITIES]

    def prepare(accuracy: Accuracy) -> tuple[Use, Callable[[], Any]]:
        x = ca.MX.sym("x", len(QUANTITIES))
        varied: dict[str, Any] = dict(zip(QUANTITIES, ca.vertsplit(x), strict=True))
        run = simulate(replace(task.scene, **varied), task.given, accuracy=accuracy, outputs=1)
        averages = ca.vertcat(*(getattr(run, name) for name in AVERAGES))
        function = ca.Function("gradient", [x], [ca.densify(ca.jacobian(averages, x))])
        return lambda: function(at), lambda: _finite([function(at)])[0] * at

    def errors(gradient: Any) -> Mapping[str, float]:
        size = np.max(np.abs(reference.values))
        wrong = np.max(np.abs(gradient - reference.values), axis=1) / (size if size > 0 else 1.0)
        named = zip(("mean draft", "RMS"), wrong, strict=True)
        return {"gradient": float(np.max(wrong)), **{f"gradient of {name}": float(w) for name, w in named}}

    contestants = [Contestant("derivatives", AUTO, prepare, errors, (Accuracy(),), label=text)]
    single = replace(task, outputs=1)
    able = [method for method, why in _reasons(task.scene).items() if not why]
    contestants += [_contestant(single, "derivatives", method, prepare, errors) for method in able]
    return task.ranked(contestants, "gradient")


def _contestant(
    task: Task, family: str, method: str, prepare: Prepare, errors: Errors, *, name: str = "", check: Check = None
) -> Contestant:
    """Return a named method with its settings.

    Args:
        task: the task.
        family: family of its entries.
        method: name in `METHODS`.
        prepare: as of `Contestant`.
        errors: as of `Contestant`.
        name: name in reports; default the method's.
        check: as of `Contestant`.
    """
    derivatives = family == "derivatives"
    settings, always = settings_of(task, method, gradient=derivatives)
    # The fastest oscillation limits the stable step of an explicit method, even where it has died away.
    stable = rates_of(task.scene).fastest * task.duration / _STABLE_PHASE if method == "erk" else 0
    one_step = _ONE_STEP * (_GRADIENT if derivatives else 1.0)
    return Contestant(family, name or method, prepare, errors, settings, always, text,
                      least_time=lambda setting: one_step * (setting.steps or stable), check=check)  # fmt: skip


def _reasons(scene: Scene) -> dict[str, str]:
    """Return for each method the reason why it cannot integrate a scene; empty if it can."""
    orbits, events = scene.effects.orbit != "transient", scene.effects.events
    reasons = dict.fromkeys((*fixed_step(), *adaptive()), "")
    for method in reasons:
        if orbits and method not in ORDER_8:
            reasons[method] = "cannot find a periodic orbit"
        elif events and not METHODS[method].locates_events:
            reasons[method] = "cannot locate events, which stick-slip and entry have"
    return reasons


def automatic_settings(task: Task) -> list[Accuracy]:
    """Return the settings of "auto", with the default and the wanted error among them."""
    errors = {*task.some(ERRORS), DEFAULT_ERROR, max(task.wanted, _TIGHTEST)}
    return [Accuracy(error=error) for error in sorted(errors, reverse=True)]


def settings_of(task: Task, method: str, *, gradient: bool = False) -> tuple[tuple[Accuracy, ...], tuple[int, ...]]:
    """Return the settings of a method from coarse to fine, and the places of those to measure in any case.

    Numbers of steps lie around the number that the time scales of the scene call for.
    """
    if METHODS[method].adaptive:
        chosen = task.some(GRADIENT_TOLERANCES if gradient else TOLERANCES)
        settings = tuple(Accuracy(method, tolerance=tolerance) for tolerance in _ALL_TOLERANCES)
        return settings, tuple(_ALL_TOLERANCES.index(tolerance) for tolerance in chosen)
    usual = with_setting(Accuracy(method), steps_for(phase(numbers_of(task.scene), task.duration)), 1).steps or 1
    # Only steps of order 8 need not end at the outputs.
    unit = 1 if method in ORDER_8 else task.outputs
    counts, always = step_counts(usual, task.some(GRADIENT_FACTORS if gradient else FACTORS), unit)
    return tuple(Accuracy(method, steps=steps) for steps in counts), always


def text(accuracy: Accuracy) -> str:
    """Return a setting as text."""
    if accuracy.method == "auto":
        return f"error {error_text(accuracy.error)}" if accuracy.error else "default"
    return f"{accuracy.steps} steps" if accuracy.steps else f"tolerance {accuracy.tolerance:.0e}"


# --- models that simplify the motion ---


def periodic_orbit_of(scene: Scene) -> Scene | None:
    """Return the scene of the periodic orbit under a scene's one strength wave, or None if it has none."""
    effects = scene.effects
    if len(effects.waves) != 1 or not effects.motion:
        return None
    try:
        return replace(scene, effects=replace(effects, orbit="periodic", start="equilibrium", tow_ramp=None))
    except PloughError:
        return None


def models(task: Task, motion: Reference | None, periodic: Reference | None) -> list[MethodResult]:
    """Return the entries of models; errors named "lasting ..." are relative to the periodic orbit.

    Args:
        task: the task.
        motion: reference of the scene's own motion, or None.
        periodic: reference of the periodic orbit to which the motion may tend, or None.
    """

    def errors(run: Run) -> Mapping[str, float]:
        return _errors("", run, motion) | _errors("lasting ", run, periodic)

    contestants = [Contestant("model", "quasi-static", lambda _: _quasi_static(task), errors)]
    transient, orbit = task.scene.effects.orbit == "transient", periodic_orbit_of(task.scene)
    if orbit is not None and transient and periodic is not None:
        around = replace(task, scene=orbit, duration=float(as_number(orbit.wave_period)))
        settings, always = settings_of(around, "dop853")
        once = partial(prepared, around)
        contestants.append(Contestant("model", "periodic orbit", once, errors, settings, always, text))
    return task.ranked(contestants, "lasting averages" if transient else "averages")


def _quasi_static(task: Task) -> Callable[[], Run]:
    """Return a use of the quasi-static limit of a scene, over the same time.

    Raises:
        InputError: the scene has no such limit.
    """
    if task.scene.effects.entry:
        raise InputError("its share is wholly buried from the start, so it cannot enter")
    effects = replace(
        task.scene.effects, motion=False, start="equilibrium", damping=None, contact="resisting", orbit="transient"
    )
    scene = replace(task.scene, effects=effects)
    steps = steps_for(rates_of(scene).forced * task.duration)
    timeline = timeline_of(scene, task.duration, task.outputs, steps)
    return partial(quasi_static, scene, numbers_of(scene), task.duration, timeline, Accuracy())


def _errors(prefix: str, run: Run, reference: Reference | None) -> dict[str, float]:
    """Return errors relative to a reference; those of mount forces only if both have the same output times."""
    if reference is None:
        return {}
    truth = reference.run
    same = len(run.time) == len(truth.time) and abs(run.time[-1] - truth.time[-1]) < 1e-9
    every = errors_of(run, truth)
    names = every if same else ("averages", "mean draft", "RMS")
    return {prefix + name: every[name] for name in names}
