"""Contestants that simulate a scene: integrators for values and gradients, and models that simplify the motion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, IntegrationError, PloughError
from plough_opt.core.expressions import as_number
from plough_opt.motion import Run, simulate
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.assembly import assemble, quasi_static
from plough_opt.motion.compiled_steps import compiled_steps
from plough_opt.motion.effects import HarmonicBalance, StickSlip
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import integration
from plough_opt.motion.judgement import refuse_missed_event
from plough_opt.motion.methods import METHODS, ORDER_8, adaptive, fixed_step
from plough_opt.motion.plan import (
    fastest_rate,
    forced_rate,
    most_steps,
    numbers_of,
    phase,
    steps_for,
    timeline_of,
    with_setting,
)
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.studies.accuracy.contest import Contestant, Entry, Use, measured, refuse, step_counts
from plough_opt.studies.accuracy.reference import AVERAGES, QUANTITIES, Reference, ReferenceGradient, errors_of

AUTO: Final = "auto"
"""Name of the default, which chooses its method and checks the result."""

COMPILED: Final = "auto, compiled"
"""Name of the default in machine code."""

BARE: Final = "dop853, compiled"
"""Name of steps of order 8 in machine code, without a check."""

MACHINE_CODE: Final = "machine code"
"""Family of compiled contestants."""

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

HARMONICS: Final = (1, 3, 8, 16)
"""Numbers of harmonics at which harmonic balance is measured in any case."""

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
_PATIENCE = 20.0

_Number = TypeVar("_Number", int, float)
Errors = Callable[[Any], Mapping[str, float]]


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

    def ranked(self, contestants: list[Contestant], key: str, floor: float = 0.0) -> list[Entry]:
        """Return the entries of contestants that are ranked by one error."""
        return measured(contestants, key, self.wanted, self.allowance, floor=floor)


def prepared(task: Task, accuracy: Accuracy, *, compiled: bool = False) -> tuple[Use, Callable[[], Run]]:
    """Return two functions: one integration by a named method, without the check that `simulate` adds; and its run.

    Args:
        task: the task.
        accuracy: the method with its setting.
        compiled: whether to take steps of order 8 in machine code.
    """
    scene, structure, known = task.scene, Structure.of(task.scene), numbers_of(task.scene)
    steps = accuracy.steps or most_steps(phase(known, task.duration))
    timeline = timeline_of(scene, task.duration, task.outputs, steps, accuracy.method)
    code = compiled_steps(structure) if compiled else None
    once: Use
    if code is not None:
        once = partial(code, timeline, [*(known[name] for name in signals(structure).parameters), task.duration])
    else:
        solver = integration(structure, accuracy, timeline)
        once = partial(solver.function.call, [ca.DM([*(known[name] for name in solver.names), task.duration])])

    def run() -> Run:
        states, means, variances = _finite(once())
        states = states.T if code is None else states
        fractions = timeline.output_fractions
        found = assemble(scene, task.duration, fractions, states, means.ravel(), variances.ravel(), accuracy)
        if isinstance(scene.effects.contact, StickSlip):
            refuse_missed_event(found)
        return found

    return once, run


def _finite(results: Any) -> list[NDArray[np.float64]]:
    """Return results as arrays; raise IntegrationError if there are none, or one is not finite."""
    found = [np.asarray(part) for part in results or ()]
    if not found or not all(np.all(np.isfinite(part)) for part in found):
        raise IntegrationError("the result is not finite")
    return found


def integrators(task: Task, reference: Reference) -> list[Entry]:
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
        contestants = [Contestant(family, auto, simulated, errors, automatic, label=text, patience=_patience)]
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


def _patience(accuracy: Accuracy) -> float:
    return _PATIENCE if accuracy.error == DEFAULT_ERROR else 1.0


def gradients(task: Task, reference: ReferenceGradient) -> list[Entry]:
    """Return the entries of all methods for the gradient of mean draft and RMS, by CasADi's derivatives of the run."""
    at = [float(getattr(task.scene, name)) for name in QUANTITIES]

    def prepare(accuracy: Accuracy) -> tuple[Use, Callable[[], Any]]:
        x = ca.MX.sym("x", len(QUANTITIES))
        varied: dict[str, Any] = dict(zip(QUANTITIES, ca.vertsplit(x), strict=True))
        run = simulate(replace(task.scene, **varied), task.given, accuracy=accuracy, outputs=1)
        averages = ca.vertcat(*(getattr(run, name) for name in AVERAGES))
        function = ca.Function("gradient", [x], [ca.densify(ca.jacobian(averages, x))])

        def find() -> Any:
            (found,) = _finite([function(at)])
            return found * at

        return lambda: function(at), find

    def errors(found: Any) -> Mapping[str, float]:
        size = np.max(np.abs(reference.values))
        wrong = np.max(np.abs(found - reference.values), axis=1) / (size if size > 0 else 1.0)
        own = zip(("mean draft", "RMS"), wrong, strict=True)
        return {"gradient": float(np.max(wrong)), **{f"gradient of {name}": float(w) for name, w in own}}

    contestants = [Contestant("derivatives", AUTO, prepare, errors, (Accuracy(),), label=text)]
    single = replace(task, outputs=1)
    able = [method for method, why in _reasons(task.scene).items() if not why]
    contestants += [_contestant(single, "derivatives", method, prepare, errors) for method in able]
    return task.ranked(contestants, "gradient")


def _contestant(
    task: Task,
    family: str,
    method: str,
    prepare: Callable[[Accuracy], Any],
    errors: Errors,
    *,
    name: str = "",
    check: Callable[[Any], Use] | None = None,
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
    least_time = partial(_least_time, task, slower=_GRADIENT if derivatives else 1.0)
    name = name or method
    return Contestant(family, name, prepare, errors, settings, always, text, least_time=least_time, check=check)


def _least_time(task: Task, accuracy: Accuracy, *, slower: float) -> float:
    """Return a lower bound of the time that a method takes [s], from its number of steps."""
    steps: float = accuracy.steps or 0
    if accuracy.method == "erk":
        # The fastest oscillation limits the stable step of an explicit method, even where it has died away.
        steps = fastest_rate(numbers_of(task.scene)) * task.duration / _STABLE_PHASE
    return slower * steps * _ONE_STEP


def _reasons(scene: Scene) -> dict[str, str]:
    """Return for each method the reason why it cannot integrate a scene; empty if it can."""
    orbits, events = scene.effects.orbit != "transient", scene.effects.events
    return {method: refused(method, orbits=orbits, events=events) for method in (*fixed_step(), *adaptive())}


def refused(method: str, *, orbits: bool, events: bool) -> str:
    """Return the reason why a method cannot find periodic orbits or locate events; empty if it can.

    Args:
        method: name in `METHODS`.
        orbits: whether periodic orbits are needed.
        events: whether motions have events.
    """
    if orbits and method not in ORDER_8:
        return "cannot find a periodic orbit"
    if events and not METHODS[method].locates_events:
        return "cannot locate events, which stick-slip and entry have"
    return ""


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


def error_text(error: float) -> str:
    """Return an error as text with the fewest digits, from 1 to 3, that give its value."""
    return min((f"{error:.{digits}e}" for digits in range(3)), key=lambda text: (float(text) != error, len(text)))


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


def models(task: Task, motion: Reference | None, periodic: Reference | None) -> list[Entry]:
    """Return the entries of models; errors named "lasting ..." are relative to the periodic orbit.

    Args:
        task: the task.
        motion: reference of the scene's own motion, or None.
        periodic: reference of the periodic orbit to which the motion may tend, or None.
    """

    def errors(found: Run) -> Mapping[str, float]:
        return _errors("", found, motion) | _errors("lasting ", found, periodic)

    contestants = [Contestant("model", "quasi-static", lambda _: _quasi_static(task), errors)]
    transient, orbit = task.scene.effects.orbit == "transient", periodic_orbit_of(task.scene)
    if orbit is not None and not (transient and periodic is None):
        around = replace(task, scene=orbit, duration=float(as_number(orbit.wave_period)))
        settings, always = settings_of(around, "dop853")

        def stand_in(kind: Any) -> tuple[Use, Callable[[], Run]]:
            scene = replace(orbit, effects=replace(orbit.effects, orbit=kind))
            return prepared(replace(around, scene=scene), settings[-1])

        balances = tuple(map(HarmonicBalance, range(1, HARMONICS[-1] + 1)))
        chosen = tuple(count - 1 for count in task.some(HARMONICS))
        contestants.append(Contestant("model", "linearised", lambda _: stand_in("linearised"), errors))
        contestants.append(Contestant("model", "harmonic balance", stand_in, errors, balances, chosen, _counted))
        if transient:
            once = partial(prepared, around)
            contestants.append(Contestant("model", "lasting orbit", once, errors, settings, always, text))
    return task.ranked(contestants, "lasting averages" if transient else "averages")


def _counted(balance: HarmonicBalance) -> str:
    return f"{balance.harmonics} harmonic{'s' * (balance.harmonics > 1)}"


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
    steps = steps_for(forced_rate(numbers_of(scene)) * task.duration)
    timeline = timeline_of(scene, task.duration, task.outputs, steps)
    return partial(quasi_static, scene, task.duration, timeline, Accuracy())


def _errors(prefix: str, found: Run, reference: Reference | None) -> dict[str, float]:
    """Return errors relative to a reference; those of mount forces only if both have the same output times."""
    if reference is None:
        return {}
    truth = reference.run
    same = len(found.time) == len(truth.time) and abs(found.time[-1] - truth.time[-1]) < 1e-9
    own = errors_of(found, truth)
    names = own if same else ("averages", "mean draft", "RMS")
    return {prefix + name: own[name] for name in names}
