"""`simulate`: checked simulation of numeric scenes, and simulation of symbolic scenes for designs."""

import time
from dataclasses import replace

import numpy as np

from plough_opt.core.checks import check_domain, check_kind, check_single, check_switch, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, holds_casadi, is_count, is_symbolic, map_expressions
from plough_opt.core.quantities import BESIDE
from plough_opt.motion import plan
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.assembly import SYMBOLIC_GAUSS_POINTS, assemble, quasi_static
from plough_opt.motion.averages import Checks
from plough_opt.motion.effects import Smooth
from plough_opt.motion.embedding import embed
from plough_opt.motion.following import Case
from plough_opt.motion.integrators import integration
from plough_opt.motion.methods import locating
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.settling import which_motion
from plough_opt.motion.terms import Structure, parameters
from plough_opt.motion.verified import interpreted, verified
from plough_opt.soil.waves import check_strength


def simulate(
    scene: Scene,
    duration: Expression | None = None,
    *,
    accuracy: Accuracy | None = None,
    outputs: int = plan.OUTPUTS,
    compiled: bool = False,
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
            run then takes about a quarter of the time, with the same result. A warning reports if there is no compiler,
            or if another method or model takes the run.

    Returns:
        A numeric or symbolic `Run`.

        A numeric run is integrated twice. The second run is coarser, or finer if a method is named. The largest
        difference between the two is the ``error_estimate``. It is doubled if the second run is not the coarser one or
        the contact has kinks. With events it is at least 1e-11, and at least the possible effect of a stop between
        outputs that both runs may have missed. The estimate covers every result relative to its own size: mount force,
        soil resistance, deflection and speed at the outputs, hence their peaks, relative to the largest value of each;
        travel relative to its largest value or the largest deflection, whichever is larger; opening relative to the
        largest deflection; each RMS relative to itself; mean draft and mean deflection relative to themselves or the
        RMS, whichever is larger; tow power relative to itself or to that force at the strut's mean speed. A size below
        1e-7 of the motion's own scale of force, deflection or speed counts as 1e-7 of that scale. Soil resistance and
        speed jump at an event, and count at outputs where both runs are in the same mode. The estimate excludes
        rounding (about 1e-13 relative) and the error of the model itself. For an approximation of the periodic orbit it
        is the difference from that orbit. ``warnings`` report an estimate above the wanted error (1e-6 for a named
        method), and a motion too sensitive to be predicted.

        A symbolic run is an exactly differentiable expression without an estimate. Its derivatives aim at
        ``Accuracy(derivatives=...)``. With stick and slip, or entry, take second derivatives of a gradient:
        ``casadi.hessian(f, x)`` or ``jacobian(gradient(f, x), x)``. CasADi has no second derivatives of a forward
        derivative, as in ``jacobian(jacobian(f, x), x)``, and raises a ``RuntimeError``. A symbolic quasi-static run
        whose tow speed, wavelength or ramp time is a symbol averages over as many panels as it has outputs, at least
        400. That suffices for about a hundred waves; a warning about a longer run is not given.

    Raises:
        DomainError: the duration is not positive.
        InputError: the duration is missing, or given for an orbit; there is no output interval; the scene holds an
            array; a quasi-static scene has an integration method; the method cannot take SX symbols; or a symbolic
            scene is to be compiled.
        IntegrationError: the method failed; the message names the scene, the time and the likely cause.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> po.simulate(scene, "1 s").duration
        1.0
    """
    check_kind("the scene", scene, Scene, "a Scene, made of soil, share, stiffness, mass and tow speed")
    check_kind("accuracy", accuracy, Accuracy | None, "an Accuracy, such as Accuracy('erk')")
    if not is_count(outputs) or outputs > plan.MOST_OUTPUTS:
        raise InputError(f"outputs = {shown(outputs)} must be a whole number of intervals, 1 to {plan.MOST_OUTPUTS}")
    check_switch("compiled", compiled)
    duration = _duration(scene, duration)
    accuracy = accuracy or Accuracy()
    if accuracy.method != "auto" and not scene.effects.motion:
        raise InputError(f"accuracy method '{accuracy.method}' has nothing to integrate in a quasi-static scene")
    if scene.effects.orbit != "transient" and not accuracy.order_8:
        raise InputError(
            f"accuracy method '{accuracy.method}' cannot find an orbit: use 'auto', or 'dop853' with a number of steps"
        )
    if scene.effects.events and not accuracy.locates_events:
        raise InputError(
            f"accuracy method '{accuracy.method}' cannot locate the events of stick and slip or entry: use"
            f" {' or '.join(map(repr, locating()))}"
        )
    if holds_casadi((scene, duration)):
        check_single("simulate", (scene, duration))
        if any(map(is_symbolic, (*parameters(scene).values(), scene.mass, duration))):
            if compiled:
                raise InputError(
                    "a symbolic run cannot be compiled by itself: the design or component that uses it is compiled"
                )
            check_strength(scene.effects.waves)
            return _symbolic(scene, duration, accuracy, outputs)
        scene, duration = map_expressions((scene, duration), lambda value: float(as_number(value)))
    started = time.perf_counter()
    case = Case.of(scene, float(duration), outputs, compiled=compiled)
    run, error, notes = verified(case, accuracy)
    check_strength(scene.effects.waves, (float(np.min(run.travel)), float(np.max(run.travel))))
    multipliers, settled, stability = which_motion(run) if scene.effects.orbit == "periodic" else ((), None, ())
    notes = (*notes, *stability, *(interpreted(case, run) if compiled else ()))
    return replace(run, checks=Checks(error, time.perf_counter() - started, notes, multipliers, settled))


def repeat(scene: Scene, duration: Expression, *, outputs: int = plan.OUTPUTS) -> Run:
    """Simulate a scene for the duration of an earlier run; an orbit has its own duration."""
    return simulate(scene, duration if scene.effects.orbit == "transient" else None, outputs=outputs)


def _duration(scene: Scene, duration: Expression | None) -> Expression:
    """Return the simulated time [s]; for an orbit its period."""
    if scene.effects.orbit == "transient":
        if duration is None:
            raise InputError("the duration is missing: give the time to simulate, in seconds")
        duration = BESIDE["scene.duration"].read(duration, stacklevel=4)
        if isinstance(duration, np.ndarray) and duration.ndim > 0:
            raise InputError(f"the duration is an array of {duration.size} values: simulate accepts one at a time")
        return duration
    if duration is not None:
        raise InputError("the duration of a periodic orbit is one wavelength of the soil strength: omit it")
    check_domain("tow speed", scene.tow_speed, "m/s", above=0.0, why="a standing share has no orbit")
    return scene.wave_period


def _symbolic(scene: Scene, duration: Expression, accuracy: Accuracy, outputs: int) -> Run:
    """Return the run as expressions of the scene's symbols."""
    if not scene.effects.motion:
        imposed = {name: value for name, value in parameters(scene).items() if plan.is_imposed(name)}
        panels = max(outputs, plan.OUTPUTS)
        if not any(map(is_symbolic, (*imposed.values(), duration))):
            rate = plan.forced_rate({name: float(as_number(value)) for name, value in imposed.items()})
            panels = max(panels, plan.steps_for(rate * float(as_number(duration))))
        timeline = plan.timeline_of(scene, duration, outputs, panels)
        return quasi_static(scene, duration, timeline, accuracy, SYMBOLIC_GAUSS_POINTS)
    if accuracy.method != "auto":
        accuracy = plan.with_setting(accuracy, max(outputs, plan.OUTPUTS), outputs)
    elif scene.effects.events:
        # Events are located, but not the ends of the step of smooth contact, which need a tighter tolerance.
        part = 1e-4 if isinstance(scene.effects.contact, Smooth) else 1e-2
        wanted = min(accuracy.error or DEFAULT_ERROR, part * accuracy.wanted_derivatives)
        accuracy = Accuracy("erk", tolerance=max(0.01 * wanted, plan.TIGHTEST))
    steps = plan.MOST_ADAPTIVE if accuracy.adaptive else accuracy.steps or plan.unknown_steps(scene, accuracy, outputs)
    timeline = plan.timeline_of(scene, duration, outputs, steps, accuracy.method, symbolic=True)
    solver, p = integration(Structure.of(scene), accuracy, timeline), parameters(scene)
    states, means, variances = embed(solver, [*(p[name] for name in solver.names), duration], scene)
    return assemble(scene, duration, timeline.output_fractions, states.T, means, variances, accuracy)
