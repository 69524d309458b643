"""A verified run: one method at two settings, refined until they agree to the wanted error."""

import logging
import math
from collections.abc import Iterator

from plough_opt.core.errors import IntegrationError
from plough_opt.motion.methods import DEFAULT_ERROR, Accuracy
from plough_opt.motion.run import Run
from plough_opt.motion.solvers import checks, plan
from plough_opt.motion.solvers.checks import WORTH_A_WARNING, Escape, MissedEvent, difference
from plough_opt.motion.solvers.integrators import Case, compared, integrate

_LOG = logging.getLogger(__name__)

# If the check is finer than the run, their difference is less than the run's error by that of the check, about a sixth.
# Across a kink or an event both errors are irregular, and the difference alone may fall below either.
_MARGIN = 2.0
# Relative change of the parameters that shows how predictable a motion is, and the growth from which on it is not.
# Rounding is about a thousandth of that change.
_PERTURBATION = 1e-12


def verified(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate a case with a motion; return the run, its estimated relative error [-] and warnings.

    Raises:
        IntegrationError: no method succeeds, or the run would take minutes.
        InputError: the own effects of an orbit do not repeat themselves.
    """
    if case.structure.orbit != "transient":
        checks.refuse_drifting_own(case.scene)
    if accuracy.method == "auto":
        checks.refuse_endless(case.scene, case.duration)
        wanted = accuracy.error or DEFAULT_ERROR
        run, error = _refined(case, wanted)
        error, warnings = _warned(case, run, error, wanted)
    else:
        run, error = agreement(case, *plan.named(accuracy, case.p, case.duration, case.outputs), _MARGIN)
        finer = f"the estimated relative error is {error:.1e}: use more steps or a tighter tolerance"
        warnings = (finer,) if error > WORTH_A_WARNING else ()
    _LOG.debug("motion by %s: estimated error %.2g", run.accuracy, error)
    return run, error, (*warnings, *checks.remarks(run))


def _refined(case: Case, wanted: float) -> tuple[Run, float]:
    """Try the methods that suit a case, one after another; return the first run that reaches the error, or the best.

    Raises:
        IntegrationError: every method failed.
    """
    best: Run | None = None
    least, failure = math.inf, None
    for method in plan.suited(case.structure, case.phase):
        try:
            for run, error in _refinements(case, method, wanted):
                best, least = (run, error) if error < least or best is None else (best, least)
        except Escape:
            raise
        except IntegrationError as failed:
            failure = failed
        if least <= wanted:
            break
    if best is None:
        assert failure is not None  # a method yields a run or fails
        raise failure
    return best, least


def _refinements(case: Case, method: str, wanted: float) -> Iterator[tuple[Run, float]]:
    """Yield runs by finer and finer settings with their errors, until one reaches the wanted error or hardly gains.

    Raises:
        IntegrationError: the method failed, and finer settings do not help.
    """
    summed, fewest = plan.rates_of(case.scene).summed * case.duration, plan.fewest_steps(case.p)
    setting, before = plan.first_setting(method, wanted, summed, fewest), math.inf
    for attempts_left in (3, 2, 1, 0):
        error = math.inf
        try:
            run, error = agreement(case, setting, plan.coarser(setting), _MARGIN if case.structure.kinked else 1.0)
        except IntegrationError as failed:
            chosen = setting.adaptive and not isinstance(failed, MissedEvent)  # an adaptive method chose its steps
            if chosen or not attempts_left:
                raise
        else:
            yield run, error
        if error <= wanted or error > 0.5 * before:  # beyond rounding, chaos or a kink finer settings do not help
            return
        last, setting, before = setting, plan.refined(setting, error, wanted), error
        if setting == last:
            return


def agreement(case: Case, setting: Accuracy, check: Accuracy, margin: float) -> tuple[Run, float]:
    """Return the run by one setting, and its error as estimated by the difference from the run by another."""
    if case.code is not None and setting.order_8 and (pair := compared(case, setting, check)) is not None:
        run, apart = pair
    else:
        run = integrate(case, setting)
        apart = difference(run, integrate(case, check))
    if apart > 0.0 and case.structure.events:
        # Rounding of the moments at which a share stops for a thousandth of the run or less, as it grows afterwards.
        apart = max(apart, 2e-11)
    return run, margin * apart


def _warned(case: Case, run: Run, error: float, wanted: float) -> tuple[float, tuple[str, ...]]:
    """Return the estimated error, and a warning if it exceeds the wanted one or the motion cannot be predicted."""
    if error <= wanted:
        return error, ()
    missed = f"the wanted relative error {wanted:.1e} was not reached"
    # The coarse steps of an implicit method say nothing about the sensitivity of the motion itself.
    if error > WORTH_A_WARNING and run.accuracy.method != "rosenbrock":
        try:
            apart = difference(run, integrate(case, run.accuracy, perturbation=_PERTURBATION))
        except IntegrationError:
            apart = math.inf
        if apart > 1e4 * _PERTURBATION:
            # Two runs that have nothing in common give no bound on the error.
            # Relative difference from which on two motions have nothing in common.
            error = max(error, _MARGIN * apart) if apart < 0.1 else math.inf
            until = f"to better than {error:.1e}" if error < math.inf else "at all"
            return error, (
                f"{missed}: the motion is too sensitive to be predicted {until}, because a relative change of the"
                f" scene's quantities by {_PERTURBATION:.0e} changes it by {apart:.1e}",
            )
    return error, (f"{missed}: the estimate is {error:.1e}",)
