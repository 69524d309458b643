"""A run inside somebody's graph: one call that carries its scene along, so that others can find and check it."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import casadi as ca

from plough_opt.core import expressions
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, classes_in, is_symbolic, stacked, template_of
from plough_opt.core.labels import Meanings, attach
from plough_opt.motion.integrators import Integration
from plough_opt.motion.methods import is_stepped
from plough_opt.motion.scene import Scene


@dataclass(frozen=True)
class Embedding:
    """A Function in a graph: (parameters with the duration last, quantities of the scene) -> a run's results.

    The quantities have no influence; they let a design rebuild the scene.

    Attributes:
        integration: method, structure and times.
        template: the scene with a placeholder for each of its quantities.
    """

    integration: Integration
    template: Scene


_RUNS: Meanings[Embedding] = Meanings()


def with_numbers(template: Scene, quantities: Sequence[float]) -> Scene:
    """Return a template's scene with numbers for its quantities.

    Raises:
        DomainError: a number lies outside the model's domain.
    """
    scene: Scene = expressions.with_numbers(template, quantities)
    return scene


def embed(solver: Integration, p: Sequence[Expression], scene: Scene) -> tuple[Column, ...]:
    """Return the run's results as expressions of the symbols in its scene.

    Args:
        solver: the integration.
        p: its parameters, the duration last.
        scene: the scene that they come from.

    Raises:
        InputError: SX symbols and a method that exists for MX only.
    """
    template, quantities = template_of(scene)
    carried = stacked(*quantities)
    inputs = stacked(*p)
    if isinstance(inputs, ca.SX) or isinstance(carried, ca.SX):
        if solver.structure.orbit != "transient":
            raise InputError("an orbit takes MX symbols only, for it is the root of an equation: use casadi.MX")
        if not is_stepped(solver.accuracy.method):
            raise InputError(
                f"method '{solver.accuracy.method}' takes MX symbols only: make the scene of casadi.MX, or use 'dop853'"
            )
        return tuple(solver.function.call([inputs]))
    # Quantities print alike, as placeholders, so scenes that differ in numbers only share one Function.
    layout = (hash(solver.function), _key(template))
    run = _RUNS.shared(layout, lambda: (_build(solver, carried.numel()), Embedding(solver, template)))
    return tuple(run.call([inputs, carried]))


def labelled(value: Column, scene: Scene) -> Expression:
    """Return a value of a scene, labelled, where the scene holds MX symbols, with its template and its quantities."""
    template, quantities = template_of(scene)
    carried = stacked(*quantities)
    if isinstance(carried, ca.MX) and is_symbolic(carried):
        value = ca.MX(value)
    return attach(value, carried, template, _key(template))


def embedding_of(function: ca.Function) -> Embedding | None:
    """Return the run that a Function in a graph is, or None for any other Function."""
    return _RUNS.of(function)


def _key(template: Scene) -> Hashable:
    """Return a key of a template: its repr, and the classes and the function of a density profile in it."""
    profile = template.soil.density_profile
    return repr(template), classes_in(template), None if profile is None else id(profile.density)


def _build(solver: Integration, count: int) -> ca.Function:
    p, carried = ca.MX.sym("p", solver.function.numel_in(0)), ca.MX.sym("scene", count)
    # A share that never moves from equilibrium has results that are zero by structure; dense, they keep the call,
    # and with it the scene, in the graph.
    results = [ca.densify(result) for result in solver.function.call([p])]
    names = ["parameters", "scene"], ["states", "means", "variances"]
    return ca.Function("run", [p, carried], results, *names, {"never_inline": True})
