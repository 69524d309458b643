"""Verified runs: a numeric scene integrated twice, with an error estimate from the difference and with warnings."""

import logging
import math
from dataclasses import replace

import numpy as np

from plough_opt.core.compiler import interpretation_warning
from plough_opt.core.errors import IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion import judgement, plan
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.assembly import GAUSS_POINTS, MORE_POINTS, quasi_static
from plough_opt.motion.estimate import WORTH_A_WARNING, difference, unnoticed_stops
from plough_opt.motion.following import Array, Case, Integrated, integrate, thinned
from plough_opt.motion.judgement import Escape, MissedEvent
from plough_opt.motion.run import Run
from plough_opt.motion.settling import which_motion

_LOG = logging.getLogger(__name__)

# Attempts of an adaptive method to reach the wanted error, and the factor by which its tolerance is tightened at least.
_TIGHTENINGS = 3
_TIGHTER = 0.03
# Attempts with steps of order 8, whose number follows from the error of the attempt before.
_STEP_ATTEMPTS = 6
# Factor on the outputs if the share may have stopped between two of them.
_EVENT_REFINEMENT = 4
# An approximation that differs by more than this from the periodic orbit carries a warning.
_FAR_FROM_ORBIT = 1e-2
# If the check is finer than the run, their difference is less than the run's error by that of the check, about a sixth.
# Across a kink both errors are irregular: under smooth contact the difference alone was at least 1.3 times the error.
_MARGIN = 2.0
# Rounding of the moments at which a share stops for a thousandth of the run or less, as it grows afterwards.
_EVENT_ROUNDING = 1e-11
# Relative change of the parameters that shows how predictable a motion is. Rounding is about a thousandth of it.
_PERTURBATION = 1e-12
# Growth of a perturbation from which on a motion cannot be predicted to `WORTH_A_WARNING`.
_SENSITIVE = 1e4
# Relative difference from which on two motions have nothing in common.
_UNRELATED = 0.1


def verified(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate a case and its check; return the run, its estimated relative error [-] and warnings."""
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
        found, error = _checked(case, named, plan.check_of(named, case.p, case.duration, case.structure.kinked))
        error, warnings = _warned(case, found, error, None)
    else:
        found, error = _automatic(case, wanted)
        error, warnings = _warned(case, found, error, wanted)
    _LOG.debug("motion by %s: estimated error %.2g", found.run.accuracy, error)
    return thinned(found.run, case.outputs), error, (*warnings, *judgement.remarks(found.run))


def interpreted(case: Case, run: Run) -> tuple[str, ...]:
    """Return a warning if a run was to be compiled and was not."""
    if not run.scene.effects.motion:
        kind = "a quasi-static run"
    elif case.structure.orbit != "transient":
        kind = "a periodic orbit"
    elif not run.accuracy.order_8:
        kind = f"a run by '{run.accuracy.method}'"
    else:
        return () if case.code else (interpretation_warning(),)
    return (f"compiled=True has no effect on {kind}: machine code takes steps of order 8 from a start only",)


def _quasi_static(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    scene, duration = case.scene, case.duration
    judgement.refuse_endless(scene, case.p, duration)
    timeline = plan.timeline_of(scene, duration, case.outputs, plan.steps_for(plan.forced_rate(case.p) * duration))
    with np.errstate(all="ignore"):  # values that are not finite raise an error below
        run = quasi_static(scene, duration, timeline, accuracy)
        check = quasi_static(scene, duration, timeline, accuracy, GAUSS_POINTS + MORE_POINTS)
    if not all(np.isfinite(as_number(part)).all() for part in (run.mount_force, run.mean_draft, run.force_rms)):
        why = judgement.unsound_own(scene, run, 0.0) or "check its quantities"
        raise IntegrationError(f"the resistance of a {scene.describe()} is not finite: {why}")
    return run, difference(run, check), ()


def _automatic(case: Case, wanted: float) -> tuple[Integrated, float]:
    """Try the methods that suit a scene until one reaches the wanted error; else return the run with the least error.

    Raises:
        IntegrationError: every method failed.
    """
    best: tuple[Integrated, float] | None = None
    failure: IntegrationError | None = None
    methods = plan.suited(case.structure, case.phase)
    if methods[0] == "dop853" and case.structure.stepped and not case.structure.kinked:
        methods = methods[1:]
        best, failure = _by_measured_steps(case, wanted)
        if best is not None and (best[1] <= wanted or _hopeless(case, *best, wanted)):
            return best
    case = replace(case, explained=best is None)
    for method in methods:
        target = wanted
        for attempt in range(1 if method == "rosenbrock" else _TIGHTENINGS):
            try:
                found, error = _checked(case, *plan.checked(method, target, case.p, case.duration))
            except Escape:
                raise
            except IntegrationError as failed:
                failure = failed
                if not isinstance(failed, MissedEvent):
                    break
                target *= _TIGHTER
                continue
            if error <= wanted:
                return found, error
            if best is None or error < best[1]:
                best = found, error
            if unnoticed_stops(found.run, case.rate, 0.0) > wanted:
                case = replace(case, event_refinement=_EVENT_REFINEMENT * case.event_refinement)
                continue
            if attempt and _hopeless(case, found, error, wanted):
                return best
            target *= min(_TIGHTER, 0.5 * wanted / error)
    if best is not None:
        return best
    assert failure is not None  # each method found a run or failed
    raise failure


def _hopeless(case: Case, found: Integrated, error: float, wanted: float) -> bool:
    """Return whether rounding alone changes a motion by more than the wanted error."""
    return error > WORTH_A_WARNING and _change_by_perturbation(case, found) > _SENSITIVE * wanted


def _by_measured_steps(case: Case, wanted: float) -> tuple[tuple[Integrated, float] | None, IntegrationError | None]:
    """Integrate by steps of order 8: first by long ones, whose error shows how many reach the wanted one.

    The first number of steps does not depend on the wanted error, and a tighter one takes more: so a looser error never
    costs more.

    Returns:
        The run that reaches the error or comes nearest, with its error, and the last failure; None for either of them
        if there is none. Once the error does not fall with its order, no more steps are tried, and the error is that of
        the attempt before, because the difference of two irregular errors bounds neither.
    """
    best: tuple[Integrated, float] | None = None
    failure: IntegrationError | None = None
    steps, before = plan.first_steps(case.p, case.duration), (1, math.inf)
    for _ in range(_STEP_ATTEMPTS):
        error = math.inf
        try:
            found, error = _checked(case, *plan.pair_of(steps))
        except Escape:
            raise
        except IntegrationError as failed:
            failure = failed
        else:
            if best is None or error < best[1]:
                best = found, error
            if error <= wanted:
                break
            if plan.has_lost_order(steps, error, *before):
                best = best[0], max(before[1], error)
                break
        steps, before = plan.next_steps(steps, error, wanted), (steps, error)
    return best, failure


def _stand_in(case: Case, wanted: float) -> tuple[Run, float, tuple[str, ...]]:
    """Return an approximation of the periodic orbit, its relative difference from the orbit, and warnings."""
    exact = replace(case.scene, effects=replace(case.scene.effects, orbit="periodic"))
    method = plan.automatic("dop853", wanted, case.p, case.duration)
    run = integrate(case, method).run
    warnings = judgement.remarks(run)
    try:
        orbit = integrate(Case.of(exact, case.duration, case.outputs), method).run
    except IntegrationError:
        warnings = ("the periodic orbit that this run approximates was not found: its error is unknown", *warnings)
        return run, math.inf, warnings
    error = difference(run, orbit)
    _, _, orbit_warnings = which_motion(orbit)
    warnings = (*warnings, *orbit_warnings)
    if error > _FAR_FROM_ORBIT:
        warnings = (f"this approximation of the periodic orbit differs from it by {error:.1%}", *warnings)
    return run, error, warnings


def _checked(case: Case, accuracy: Accuracy, check: Accuracy) -> tuple[Integrated, float]:
    """Return the run by one setting, and its error as estimated from a run by another."""
    if accuracy.adaptive and _is_coarser(check, accuracy):
        # The finer run relates its tolerance to the sizes that the coarser one found.
        other = integrate(case, check)
        found = integrate(case, accuracy, other.sizes)
    else:
        found = integrate(case, accuracy)
        other = _check_run(case, accuracy, check, found.sizes)
    apart = _difference(case, found, other)
    error = apart * (1.0 if _is_coarser(check, accuracy) and not case.structure.kinked else _MARGIN)
    return found, max(error, unnoticed_stops(found.run, case.rate, error))


def _difference(case: Case, found: Integrated, other: Integrated) -> float:
    """Return the relative difference of two runs of a case; with events at least the rounding of these."""
    apart = difference(thinned(found.run, case.outputs), thinned(other.run, case.outputs))
    return max(apart, _EVENT_ROUNDING) if apart > 0.0 and case.structure.events else apart


def _check_run(case: Case, accuracy: Accuracy, check: Accuracy, sizes: Array | None) -> Integrated:
    """Return the run by the check's setting, or by a finer one of the run's own method if that fails."""
    try:
        return integrate(case, check, sizes)
    except IntegrationError:
        if case.structure.events or not accuracy.adaptive or accuracy.method == check.method:
            # A check that misses an event is a failure too.
            raise
        # Fixed steps may be too long for what an adaptive method resolves.
        return integrate(case, plan.finer(accuracy), sizes)


def _is_coarser(one: Accuracy, other: Accuracy) -> bool:
    """Return whether two accuracies have the same method and the first has the coarser setting."""
    return one.method == other.method and (
        (one.steps or 0) < (other.steps or 0) or (one.tolerance or 0.0) > (other.tolerance or 0.0)
    )


def _warned(case: Case, found: Integrated, error: float, wanted: float | None) -> tuple[float, tuple[str, ...]]:
    """Return the estimated error, and a warning if it exceeds the wanted one or the motion cannot be predicted."""
    if error <= (wanted or WORTH_A_WARNING):
        return error, ()
    if wanted is None:
        return error, (f"the estimated relative error is {error:.1e}: use more steps or a tighter tolerance",)
    missed = f"the wanted relative error {wanted:.1e} was not reached"
    # The coarse steps of an implicit method say nothing about the sensitivity of the motion itself.
    if error > WORTH_A_WARNING and found.run.accuracy.method != "rosenbrock":
        apart = _change_by_perturbation(case, found)
        if apart > _SENSITIVE * _PERTURBATION:
            # Two runs that have nothing in common give no bound on the error.
            error = max(error, _MARGIN * apart) if apart < _UNRELATED else math.inf
            until = f"to better than {error:.1e}" if error < math.inf else "at all"
            return error, (
                f"{missed}: the motion is too sensitive to be predicted {until}, because a relative change of the"
                f" scene's quantities by {_PERTURBATION:.0e} changes it by {apart:.1e}",
            )
    return error, (f"{missed}: the estimate is {error:.1e}",)


def _change_by_perturbation(case: Case, found: Integrated) -> float:
    """Return how much a tiny change of the scene's quantities changes a motion, relatively."""
    try:
        other = integrate(case, found.run.accuracy, found.sizes, perturbation=_PERTURBATION)
    except IntegrationError:
        return math.inf
    return _difference(case, found, other)
