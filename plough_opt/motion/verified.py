"""Numeric scenes: integrated by a method that suits them, checked by another or a finer one, and judged."""

import logging
import math
from dataclasses import replace

import numpy as np

from plough_opt.core.compiler import NO_COMPILER
from plough_opt.core.errors import IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion import judgement, plan
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.assembly import GAUSS_POINTS, MORE_POINTS, quasi_static
from plough_opt.motion.estimate import TELLING, difference, unseen
from plough_opt.motion.following import Array, Case, Followed, follow, thinned
from plough_opt.motion.judgement import Escape, MissedEvent
from plough_opt.motion.run import Run
from plough_opt.motion.settling import which_motion

_LOG = logging.getLogger(__name__)

# How often, and by what factor at least, the tolerance is tightened until the wanted error is reached; and how often
# steps of order 8 are shortened, whose number follows from an error that was measured.
_TIGHTENINGS, _TIGHTER = 3, 0.03
_MEASURED = 6
# How many times more outputs are followed where a share may have stopped between them.
_CLOSER = 4
# Relative difference of a stand-in from the lasting orbit that a reader must know.
_FAR = 1e-2
# Of a run whose check is finer the difference is less than its error by the check's own, a sixth of it or so; across
# a kink both err by chance: under smooth contact the difference alone was 1.3 times it at the least.
_MARGIN = 2.0
# Rounding of the moments at which a share stops for a thousandth of the run or less, and what grows from it.
_AFTER_EVENTS = 1e-11
# Relative change of the parameters by which it is tried how far a motion can be predicted at all, and the factor by
# which a difference grows in one that cannot be to `TELLING`.
_SHAKEN = 1e-12
_SENSITIVE = 1e4
# Relative difference from which on nothing is known of a motion.
_LOST = 0.1


def verified(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate twice; return the run, its estimated error, and what a reader must know of it."""
    effects = case.scene.effects
    if not effects.motion:
        return _quasi_static(case, accuracy)
    wanted = accuracy.error or DEFAULT_ERROR
    if effects.orbit != "transient":
        judgement.refuse_drifting_own(case.scene)
    if accuracy.method == "auto":
        judgement.refuse_endless(case.scene, case.p, case.duration)
    if effects.orbit not in ("transient", "periodic"):
        return _stand_in(case, wanted)
    if accuracy.method != "auto":
        named = plan.with_setting(accuracy, plan.steps_for(case.phase), case.outputs)
        found, error = _twice(case, named, plan.check_of(named, case.p, case.duration, case.structure.kinked))
        error, notes = _stated(case, found, error, None)
    else:
        found, error = _automatic(case, wanted)
        error, notes = _stated(case, found, error, wanted)
    _LOG.debug("motion by %s: estimated error %.2g", found.run.accuracy, error)
    return thinned(found.run, case.outputs), error, (*notes, *judgement.remarks(found.run))


def interpreted(case: Case, run: Run) -> tuple[str, ...]:
    """Return why a run that should have been compiled was not, or nothing."""
    if not run.scene.effects.motion:
        kind = "a quasi-static run"
    elif case.structure.orbit != "transient":
        kind = "a lasting orbit"
    elif not run.accuracy.order_8:
        kind = f"a run by '{run.accuracy.method}'"
    else:
        return () if case.code else (NO_COMPILER,)
    return (f"compiled=True changes nothing in {kind}: machine code takes steps of order 8",)


def _quasi_static(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    scene, duration = case.scene, case.duration
    judgement.refuse_endless(scene, case.p, duration)
    timeline = plan.timeline_of(scene, duration, case.outputs, plan.steps_for(plan.forced_rate(case.p) * duration))
    with np.errstate(all="ignore"):  # what is not finite is refused below
        run = quasi_static(scene, duration, timeline, accuracy)
        check = quasi_static(scene, duration, timeline, accuracy, GAUSS_POINTS + MORE_POINTS)
    if not all(np.isfinite(as_number(part)).all() for part in (run.mount_force, run.mean_draft, run.force_rms)):
        why = judgement.unsound_own(scene, run, 0.0) or "look at its numbers"
        raise IntegrationError(f"the resistance of a {scene.describe()} is not finite: {why}")
    return run, difference(run, check), ()


def _automatic(case: Case, wanted: float) -> tuple[Followed, float]:
    """Integrate by the first of the methods that suit a scene which reaches the wanted error, or comes nearest."""
    best: tuple[Followed, float] | None = None
    failure: IntegrationError | None = None
    methods = plan.suited(case.structure, case.phase)
    if methods[0] == "dop853" and case.structure.stepped and not case.structure.kinked:
        methods = methods[1:]
        best, failure = _by_measured_steps(case, wanted)
        if best is not None and (best[1] <= wanted or _hopeless(case, *best, wanted)):
            return best
    for method in methods:
        aim = wanted
        for tightened in range(1 if method == "rosenbrock" else _TIGHTENINGS):
            try:
                found, error = _twice(case, *plan.checked(method, aim, case.p, case.duration))
            except Escape:
                raise
            except IntegrationError as failed:
                failure = failed
                if not isinstance(failed, MissedEvent):
                    break
                aim *= _TIGHTER
                continue
            if error <= wanted:
                return found, error
            if best is None or error < best[1]:
                best = found, error
            if unseen(found.run, case.rate, 0.0) > wanted:
                case = replace(case, closer=_CLOSER * case.closer)
                continue
            if tightened and _hopeless(case, found, error, wanted):
                return best
            aim *= min(_TIGHTER, 0.5 * wanted / error)
    if best is not None:
        return best
    assert failure is not None  # each method found a run or failed
    raise failure


def _hopeless(case: Case, found: Followed, error: float, wanted: float) -> bool:
    """Return whether rounding, some thousand times less than a shake, changes a motion by more than is wanted."""
    return error > TELLING and _shaken(case, found) > _SENSITIVE * wanted


def _by_measured_steps(case: Case, wanted: float) -> tuple[tuple[Followed, float] | None, IntegrationError | None]:
    """Integrate by steps of order 8: by long ones first, whose error shows how many reach the wanted one.

    The long steps are the same whatever is wanted, and the tighter that is the more are taken: a looser error costs no
    more.

    Returns:
        The run that reaches the error or comes nearest, and why there is none.
    """
    best: tuple[Followed, float] | None = None
    failure: IntegrationError | None = None
    steps = plan.first_steps(case.p, case.duration)
    for _ in range(_MEASURED):
        error = math.inf
        try:
            found, error = _twice(case, *plan.pair_of(steps))
        except Escape:
            raise
        except IntegrationError as failed:
            failure = failed
        else:
            if best is None or error < best[1]:
                best = found, error
            if error <= wanted:
                break
        steps = plan.next_steps(steps, error, wanted)
    return best, failure


def _stand_in(case: Case, wanted: float) -> tuple[Run, float, tuple[str, ...]]:
    """Return a stand-in for the lasting orbit, its relative difference from the orbit, and a note if there is none."""
    exact = replace(case.scene, effects=replace(case.scene.effects, orbit="periodic"))
    method = plan.automatic("dop853", wanted, case.p, case.duration)
    run = follow(case, method).run
    notes = judgement.remarks(run)
    try:
        orbit = follow(Case.of(exact, case.duration, case.outputs), method).run
    except IntegrationError:
        notes = ("the lasting orbit that this run stands for was not found: its error is unknown", *notes)
        return run, math.inf, notes
    error = difference(run, orbit)
    _, _, lasting = which_motion(orbit)
    notes = (*notes, *lasting)
    if error > _FAR:
        notes = (f"a stand-in for the lasting orbit, from which it differs by {error:.1%}", *notes)
    return run, error, notes


def _twice(case: Case, first: Accuracy, second: Accuracy) -> tuple[Followed, float]:
    """Return the run by a method, and its estimated error, from the run by another."""
    if first.adaptive and _is_coarser(second, first):
        # From the coarser of two runs the finer one learns the sizes of what moves.
        check = follow(case, second)
        found = follow(case, first, check.sizes)
    else:
        found = follow(case, first)
        check = _checking(case, first, second, found.sizes)
    apart = _apart(case, found, check)
    coarser = _is_coarser(second, first)
    error = apart * (1.0 if coarser and not case.structure.kinked else _MARGIN)
    return found, max(error, unseen(found.run, case.rate, error))


def _apart(case: Case, found: Followed, other: Followed) -> float:
    """Return how far two motions of a case are apart; of motions with events, no less than those leave of digits."""
    apart = difference(thinned(found.run, case.outputs), thinned(other.run, case.outputs))
    return max(apart, _AFTER_EVENTS) if apart > 0.0 and case.structure.events else apart


def _checking(case: Case, first: Accuracy, second: Accuracy, sizes: Array | None) -> Followed:
    """Return the run that checks another."""
    try:
        return follow(case, second, sizes)
    except IntegrationError:
        if case.structure.events or not first.adaptive or first.method == second.method:
            # An event that the check misses is a failure too.
            raise
        # Fixed steps may be too long for what only an adaptive method notices.
        return follow(case, plan.finer(first), sizes)


def _is_coarser(one: Accuracy, other: Accuracy) -> bool:
    """Return whether a method has a coarser setting than the same method has in another accuracy."""
    return one.method == other.method and (
        (one.steps or 0) < (other.steps or 0) or (one.tolerance or 0.0) > (other.tolerance or 0.0)
    )


def _stated(case: Case, found: Followed, error: float, wanted: float | None) -> tuple[float, tuple[str, ...]]:
    """Return the estimated error, and in words that it is larger than wanted, or that no motion could be predicted."""
    if error <= (wanted or TELLING):
        return error, ()
    if wanted is None:
        return error, (f"the estimated relative error is {error:.1e}: take more steps or a tighter tolerance",)
    missed = f"the wanted relative error {wanted:.1e} was not reached"
    # The coarse steps of an implicit method say nothing about the motion's own sensitivity.
    if error > TELLING and found.run.accuracy.method != "rosenbrock":
        apart = _shaken(case, found)
        if apart > _SENSITIVE * _SHAKEN:
            # Differences of the size of the motion itself are bounded by nothing that two runs show.
            error = max(error, _MARGIN * apart) if apart < _LOST else math.inf
            until = f"to better than {error:.1e}" if error < math.inf else "at all"
            return error, (
                f"{missed}: the motion is too sensitive to be predicted {until}, for a change of the scene's numbers by"
                f" {_SHAKEN:.0e} of themselves changes it by {apart:.1e}",
            )
    return error, (f"{missed}: the estimate is {error:.1e}",)


def _shaken(case: Case, found: Followed) -> float:
    """Return how far a motion is from that of all but the same scene."""
    try:
        other = follow(case, found.run.accuracy, found.sizes, shaken=_SHAKEN)
    except IntegrationError:
        return math.inf
    return _apart(case, found, other)
