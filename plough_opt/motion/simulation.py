"""`simulate`: one verb for numeric scenes, checked, and for symbolic scenes inside a design."""

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
        scene: of floats, or with CasADi expressions in it.
        duration: simulated time [s], above 0; a float or an expression. Of a lasting orbit it is one wavelength of
            the soil's strength and must be left out.
        accuracy: method and setting, or the error to reach; default: a relative error of 1e-8.
        outputs: number of equal intervals between output times, at least 1.
        compiled: of a numeric scene, follow a motion from its start by steps of order 8 in machine code, by the
            system's C compiler. Translating takes about a second, once for scenes of like effects on a machine; then a
            run takes about a quarter of the time, with the same result. Where there is no compiler, or
            another method or model takes the run, a warning says so.

    Returns:
        A numeric or symbolic `Run`. A numeric run is integrated a second time, more coarsely, of a method
        that is named more finely, and ``error_estimate`` is the largest difference of the two, twice that where the
        second run is not the coarser or the contact has kinks, and after events no less than 1e-11, or than what a stop
        between the outputs may change that the integrator may have passed over. It covers every result, each relative
        to its own size: mount force, soil resistance, deflection and speed at the outputs, and so their peaks, relative
        to the largest of each; travel and opening to the largest deflection too; both RMS to themselves; mean draft and
        deflection to themselves or the RMS, whichever is larger; the tow power to itself or that force at the strut's
        mean speed.
        A size below 1e-7 of what the motion's forces, deflections or speeds reach counts as that. Soil resistance and
        speed jump at an event, and count where both runs are in the same mode. What is left of double precision, some
        1e-13 of those, is not in it, nor what the model leaves out. An estimate above the wanted error, or of a
        named method above 1e-6, is reported in ``warnings``, and that a motion is too sensitive to be predicted. Of a
        stand-in for the lasting orbit it is the difference from that orbit. A symbolic run is an exactly
        differentiable expression that has no such estimate.
        Its derivatives aim at ``Accuracy(derivatives=...)``. Of stick and slip, and of entry, second derivatives are
        those of a gradient, ``casadi.hessian(f, x)`` or ``jacobian(gradient(f, x), x)``: of a forward derivative, as
        in ``jacobian(jacobian(f, x), x)``, CasADi has none and raises a ``RuntimeError``.
        A symbolic quasi-static run in which the tow speed, the wavelength or the ramp's time is a symbol averages over
        as many panels as it has outputs, at least 400: enough for some hundred waves; more are not reported.

    Raises:
        DomainError: the duration is not positive.
        InputError: no duration, or one for an orbit, fewer than one output interval, an array in the scene, an
            integration method for a quasi-static scene, SX symbols with a method that cannot take them, or a symbolic
            scene that shall be compiled.
        IntegrationError: the method failed; the message says for which scene, when and the likely cause.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> po.simulate(scene, "1 s").duration
        1.0
    """
    _check_kinds(scene, accuracy, outputs)
    check_switch("compiled", compiled)
    duration = _duration(scene, duration)
    accuracy = accuracy or Accuracy()
    if accuracy.method != "auto" and not scene.effects.motion:
        raise InputError(f"accuracy method '{accuracy.method}' has nothing to integrate in a quasi-static scene")
    if scene.effects.orbit != "transient" and not accuracy.order_8:
        raise InputError(
            f"accuracy method '{accuracy.method}' finds no orbit: take 'auto', or 'dop853' with a number of steps"
        )
    if scene.effects.events and not accuracy.locates_events:
        raise InputError(
            f"accuracy method '{accuracy.method}' finds no events, which stick and slip and the entry of a share have:"
            f" take {' or '.join(map(repr, locating()))}"
        )
    if holds_casadi((scene, duration)):
        check_single("simulate", (scene, duration))
        if any(map(is_symbolic, (*parameters(scene).values(), scene.mass, duration))):
            if compiled:
                raise InputError("a symbolic run has no machine code: what it becomes part of is compiled as a whole")
            check_strength(scene.effects.waves)
            return _symbolic(scene, duration, accuracy, outputs)
        scene, duration = map_expressions((scene, duration), lambda value: float(as_number(value)))
    started = time.perf_counter()
    case = Case.of(scene, float(duration), outputs, compiled=compiled)
    run, error, notes = verified(case, accuracy)
    check_strength(scene.effects.waves, (float(np.min(run.travel)), float(np.max(run.travel))))
    multipliers, found, lasting = which_motion(run) if scene.effects.orbit == "periodic" else ((), None, ())
    notes = (*notes, *lasting, *(interpreted(case, run) if compiled else ()))
    return replace(run, checks=Checks(error, time.perf_counter() - started, notes, multipliers, found))


def _check_kinds(scene: Scene, accuracy: Accuracy | None, outputs: int) -> None:
    """Refuse something else in the place of a scene, an accuracy or a number of outputs."""
    check_kind("the scene", scene, Scene, "a Scene, made of soil, share, stiffness, mass and tow speed")
    if not (accuracy is None or isinstance(accuracy, Accuracy)):
        raise InputError(f"accuracy = {shown(accuracy)} must be an Accuracy, as Accuracy('erk')")
    if not is_count(outputs) or outputs > plan.MOST_OUTPUTS:
        raise InputError(
            f"outputs = {shown(outputs)} must be a whole number from 1 to {plan.MOST_OUTPUTS}: of intervals"
        )


def repeat(scene: Scene, duration: Expression, *, outputs: int = plan.OUTPUTS) -> Run:
    """Simulate a scene for the duration of a run of its like; an orbit has its own."""
    return simulate(scene, duration if scene.effects.orbit == "transient" else None, outputs=outputs)


def _duration(scene: Scene, duration: Expression | None) -> Expression:
    """Return the simulated time, of an orbit its period."""
    if scene.effects.orbit == "transient":
        if duration is None:
            raise InputError("the duration is missing: how long shall the scene be simulated, in seconds?")
        duration = BESIDE["scene.duration"].read(duration, stacklevel=4)
        if isinstance(duration, np.ndarray) and duration.ndim > 0:
            raise InputError(f"the duration is an array of {duration.size} values: simulate takes one at a time")
        return duration
    if duration is not None:
        raise InputError("a lasting orbit has a duration of its own, one wavelength of the soil: leave it out")
    check_domain("tow speed", scene.tow_speed, "m/s", above=0.0, why="a share that stands still has no orbit")
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
        # Events are located, the ends of smooth contact's step beside them are not.
        part = 1e-4 if isinstance(scene.effects.contact, Smooth) else 1e-2
        wanted = min(accuracy.error or DEFAULT_ERROR, part * accuracy.wanted_derivatives)
        accuracy = Accuracy("erk", tolerance=max(0.01 * wanted, plan.TIGHTEST))
    return _embedded(scene, duration, accuracy, outputs)


def _embedded(scene: Scene, duration: Expression, accuracy: Accuracy, outputs: int) -> Run:
    """Return a run by a method with its setting as expressions of the scene's symbols."""
    steps = plan.MOST_ADAPTIVE if accuracy.adaptive else accuracy.steps or plan.unknown_steps(scene, accuracy, outputs)
    timeline = plan.timeline_of(scene, duration, outputs, steps, accuracy.method, symbolic=True)
    solver, p = integration(Structure.of(scene), accuracy, timeline), parameters(scene)
    states, means, variances = embed(solver, [*(p[name] for name in solver.names), duration], scene)
    return assemble(scene, duration, timeline.output_fractions, states.T, means, variances, accuracy)
