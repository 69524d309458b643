"""`simulate`: arguments are checked, numeric scenes integrated twice, symbolic scenes made into runs for designs."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from plough_opt.core.checks import check_kind, check_single, check_switch, whole_number
from plough_opt.core.compiler import interpretation_warning
from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import (
    Expression,
    as_number,
    holds_casadi,
    holds_symbols,
    is_casadi,
    is_symbolic,
    kept,
    map_expressions,
)
from plough_opt.motion.effects import profile_of
from plough_opt.motion.equation import check_strength, parameters
from plough_opt.motion.methods import Accuracy, locating
from plough_opt.motion.run import Checks, Run
from plough_opt.motion.scene import Scene, duration_of
from plough_opt.motion.solvers import checks, plan
from plough_opt.motion.solvers.checks import difference
from plough_opt.motion.solvers.compiled_steps import source_of
from plough_opt.motion.solvers.integrators import Case, quasi_static, symbolic
from plough_opt.motion.solvers.orbit import which_motion
from plough_opt.motion.solvers.steps import GAUSS_POINTS, MORE_POINTS
from plough_opt.motion.solvers.verified import verified

_DEFAULT = Accuracy()
_holds_casadi = kept(holds_casadi)


def simulate(
    scene: Scene,
    duration: Expression | None = None,
    *,
    accuracy: Accuracy | None = None,
    outputs: int = plan.OUTPUTS,
    compiled: bool = False,
    tow_speed: Any = None,
) -> Run:
    """Simulate a share on its mount, equation (27), or its quasi-static limit.

    Args:
        scene: a scene of floats or CasADi expressions.
        duration: simulated time [s], above 0; a float or an expression. Omit it for a periodic orbit: its duration is
            one wavelength of the soil strength.
        accuracy: method and setting, or the error to reach; default: a relative error of 1e-8.
        outputs: number of equal intervals between output times, at least 1.
        compiled: whether steps of order 8 of a numeric scene, integrated from a start, run as machine code. Compilation
            by the system's C compiler takes about a second, once per machine for all scenes with the same effects; a
            run then takes about a fifth of the time, with the same result up to rounding. A warning reports if there
            is no compiler, if another method or model takes the run, or if an own effect looks up a table.
        tow_speed: speed of the strut over time instead of the scene's constant one: a table, which is a tuple of times
            [s], from 0 on, and of speeds [m/s], as numbers or texts such as "9 km/h", with straight lines between them
            and the last speed afterwards. Steps end at its times. In the run's scene ``tow_speed`` is the largest
            speed, at which laws of resistance are evaluated, and ``effects.tow_profile`` the course.

    Returns:
        A numeric or symbolic `Run`.

        A numeric run is integrated by one method at two settings, which are refined until they agree. Their largest
        difference is the ``error_estimate``; it is doubled if the second run is the finer one, as for a named method,
        or if the contact has kinks or events. The estimate covers every result relative to its own size: mount force,
        soil resistance, deflection and speed at the outputs, hence their peaks, relative to the largest value of each;
        travel relative to its largest value or the largest deflection, whichever is larger; opening relative to the
        largest deflection; each RMS relative to itself; mean draft and mean deflection relative to themselves or the
        RMS, whichever is larger; tow power relative to itself or to that force at the strut's mean speed. A size below
        1e-7 of the motion's own scale of force, deflection or speed counts as 1e-7 of that scale. Soil resistance and
        speed jump at an event, and count at outputs where both runs are in the same mode. The estimate excludes
        rounding (about 1e-13 relative) and the error of the model itself. ``warnings`` report an estimate above the
        wanted error (1e-6 for a named method), and a motion too sensitive to be predicted.

        A symbolic run is an exactly differentiable expression without an estimate. Its derivatives aim at
        ``Accuracy(derivatives=...)``. With stick and slip, or entry, take second derivatives of a gradient:
        ``casadi.hessian(f, x)`` or ``jacobian(gradient(f, x), x)``. CasADi has no second derivatives of a forward
        derivative, as in ``jacobian(jacobian(f, x), x)``, and raises a ``RuntimeError``. A symbolic quasi-static run
        whose tow speed, wavelength or ramp time is a symbol averages over as many panels as it has outputs, at least
        400. That suffices for about a hundred waves; a warning about a longer run is not given.

    Raises:
        DomainError: the duration is not positive, or the tow speed is never above 0.
        InputError: the duration is missing, or given for an orbit; there is no output interval; the scene holds an
            array; a quasi-static scene has an integration method; the method cannot take SX symbols; a symbolic scene
            is to be compiled; or the tow speed is not as above, is negative, or is combined with an orbit, a tow
            ramp, stick and slip, entry, random strength or a symbolic duration.
        IntegrationError: the method failed; the message names the scene, the time and the likely cause.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> po.simulate(scene, "1 s").duration
        1.0
        >>> float(po.simulate(scene, "9 s", tow_speed=([0.0, 3.0, 9.0], [0.0, 2.0, 1.0])).speed[-1])
        1.0
    """
    accuracy = _DEFAULT if accuracy is None else accuracy
    scene, duration = _read(scene, duration, accuracy, outputs, compiled, tow_speed)
    if is_casadi(duration) or _holds_casadi(scene):
        if compiled:
            instead = "the design or component that uses it is compiled"
            raise InputError(f"a symbolic run cannot be compiled by itself: {instead}")
        check_strength(scene.effects.waves)
        return symbolic(scene, parameters(scene), duration, accuracy, outputs)
    started = time.perf_counter()
    case = Case.of(scene, float(duration), outputs, compiled=compiled)
    run, error, notes = (verified if scene.effects.motion else _quasi_static)(case, accuracy)
    check_strength(scene.effects.waves, (float(np.min(run.travel)), float(np.max(run.travel))))
    multipliers, settled, stability = which_motion(run) if scene.effects.orbit != "transient" else ((), None, ())
    notes = (*notes, *stability, *(interpreted(case, run) if compiled else ()))
    return replace(run, checks=Checks(error, time.perf_counter() - started, notes, multipliers, settled))


def repeat(scene: Scene, duration: Expression, *, outputs: int = plan.OUTPUTS) -> Run:
    """Simulate a scene for the duration of an earlier run; an orbit has its own duration."""
    return simulate(scene, duration if scene.effects.orbit == "transient" else None, outputs=outputs)


def _read(
    scene: Scene, duration: Expression | None, accuracy: Accuracy, outputs: int, compiled: bool, tow_speed: Any
) -> tuple[Scene, Expression]:
    """Return the scene, with the course of its tow speed if given, and the simulated time [s], for an orbit its period.

    They hold floats, or expressions of symbols.

    Raises:
        InputError, DomainError: `simulate` refuses its arguments.
    """
    check_kind("the scene", scene, Scene, "a Scene, made of soil, share, stiffness, mass and tow speed")
    of_casadi = is_casadi(duration) or _holds_casadi(scene)
    if isinstance(duration, np.ndarray) and duration.ndim:
        raise InputError(f"the duration is an array of {duration.size} values: simulate accepts one at a time")
    if of_casadi:
        check_single("simulate", (scene, duration))
    if of_casadi and not holds_symbols((scene, duration)):
        scene, duration = map_expressions((scene, duration), lambda value: float(as_number(value)))
    check_kind("accuracy", accuracy, Accuracy, "an Accuracy, such as Accuracy('erk')")
    whole_number("outputs", outputs, 1, plan.MOST_OUTPUTS)
    check_switch("compiled", compiled)
    method = f"accuracy method '{accuracy.method}'"
    if accuracy.method != "auto" and not scene.effects.motion:
        raise InputError(f"{method} has nothing to integrate in a quasi-static scene")
    if scene.effects.orbit != "transient" and not accuracy.order_8:
        raise InputError(f"{method} cannot find an orbit: use 'auto', or 'dop853' with a number of steps")
    if scene.effects.events and not accuracy.locates_events:
        methods = " or ".join(map(repr, locating()))
        raise InputError(f"{method} cannot locate the events of stick and slip or entry: use {methods}")
    found = duration_of(scene, duration, stacklevel=4)
    if tow_speed is not None:
        if is_symbolic(found):
            raise InputError("the tow speed varies with time, so the duration cannot be a symbol: give a number [s]")
        largest, course = profile_of(tow_speed)
        scene = replace(scene, tow_speed=largest, effects=replace(scene.effects, tow_profile=course))
    profile, steps = scene.effects.tow_profile, accuracy.steps
    if profile is not None and steps is not None and steps < (fewest := plan.STEPS_PER_PIECE * profile.pieces):
        raise InputError(f"accuracy steps = {steps} are too few for the knots of the tow speed: give {fewest} or more")
    return scene, found


def interpreted(case: Case, run: Run) -> tuple[str, ...]:
    """Return a warning if a run was to be compiled and was not."""
    if not run.scene.effects.motion:
        kind = "a quasi-static run"
    elif case.structure.orbit != "transient":
        kind = "a periodic orbit"
    elif not run.accuracy.order_8:
        kind = f"a run by '{run.accuracy.method}'"
    elif case.code:
        return ()
    else:
        try:
            source_of(case.structure)
        except InputError:
            kind = "own effects with an operation without a vector form, such as the lookup in a table"
        else:
            return (interpretation_warning(),)
    return (f"compiled=True has no effect on {kind}: machine code takes steps of order 8 from a start only",)


def _quasi_static(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    scene, duration = case.scene, case.duration
    checks.refuse_endless(scene, duration)
    timeline = plan.timeline_of(scene, duration, case.outputs, plan.steps_for(plan.rates_of(scene).forced * duration))
    with np.errstate(all="ignore"):  # values that are not finite raise an error below
        run = quasi_static(scene, case.p, duration, timeline, accuracy)
        check = quasi_static(scene, case.p, duration, timeline, accuracy, GAUSS_POINTS + MORE_POINTS)
    if not all(np.isfinite(as_number(part)).all() for part in (run.mount_force, run.mean_draft, run.force_rms)):
        why = checks.unsound_own(scene, duration) or "check its quantities"
        raise IntegrationError(f"the resistance of a {scene.describe()} is not finite: {why}")
    return run, difference(run, check), ()
