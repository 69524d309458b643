"""A symbolic run as one call in the user's graph that carries its scene, so that a design can find and check it."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import casadi as ca

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, classes_in, is_symbolic, stacked, template_of
from plough_opt.core.labels import Meanings, attach
from plough_opt.motion.integrators import Integration
from plough_opt.motion.methods import is_stepped
from plough_opt.motion.scene import Scene


@dataclass(frozen=True)
class Embedding:
    """Meaning of a call in a graph: (parameters, the duration last; quantities of the scene) -> results of a run.

    The quantities do not influence the results; with them a design can rebuild the scene.

    Attributes:
        integration: method, structure and times.
        template: the scene with a placeholder for each of its quantities.
    """

    integration: Integration
    template: Scene


_RUNS: Meanings[Embedding] = Meanings()


def embed(solver: Integration, p: Sequence[Expression], scene: Scene) -> tuple[Column, ...]:
    """Return the results of a run as expressions of the symbols in its scene.

    Args:
        solver: the integration.
        p: its parameters, the duration last.
        scene: the scene from which they were computed.

    Raises:
        InputError: the symbols are SX, and the method supports only MX.
    """
    template, quantities = template_of(scene)
    carried = stacked(*quantities)
    inputs = stacked(*p)
    if isinstance(inputs, ca.SX) or isinstance(carried, ca.SX):
        if solver.structure.orbit != "transient":
            raise InputError("an orbit takes MX symbols only, because it is the root of an equation: use casadi.MX")
        if not is_stepped(solver.accuracy.method):
            raise InputError(f"method '{solver.accuracy.method}' takes MX symbols only: use casadi.MX, or use 'dop853'")
        return tuple(solver.function.call([inputs]))
    # Quantities are placeholders in the template, so that scenes which differ only in numbers share one Function.
    layout = (hash(solver.function), _key(template))
    run = _RUNS.shared(layout, lambda: (_build(solver, carried.numel()), Embedding(solver, template)))
    return tuple(run.call([inputs, carried]))


def labelled(value: Column, scene: Scene) -> Expression:
    """Return a value with its scene attached as a label if the scene holds MX symbols."""
    template, quantities = template_of(scene)
    carried = stacked(*quantities)
    if isinstance(carried, ca.MX) and is_symbolic(carried):
        value = ca.MX(value)
    return attach(value, carried, template, _key(template))


def embedding_of(function: ca.Function) -> Embedding | None:
    """Return what a Function in a graph computes if `embed` made it, else None."""
    return _RUNS.of(function)


def _key(template: Scene) -> Hashable:
    """Return a key of a template: its repr, the classes in it, and the function of its density profile."""
    profile = template.soil.density_profile
    return repr(template), classes_in(template), None if profile is None else id(profile.density)


def _build(solver: Integration, count: int) -> ca.Function:
    p, carried = ca.MX.sym("p", solver.function.numel_in(0)), ca.MX.sym("scene", count)
    # If a share never leaves equilibrium, its results are zero by structure. Made dense, they keep the call in the
    # graph, and with it the scene.
    results = [ca.densify(result) for result in solver.function.call([p])]
    names = ["parameters", "scene"], ["states", "means", "variances"]
    return ca.Function("run", [p, carried], results, *names, {"never_inline": True})
