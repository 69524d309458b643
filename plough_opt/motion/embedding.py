"""A run inside somebody's graph: one call that carries its scene along, so that others can find and check it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from plough_opt.accuracy import ORDER_8
from plough_opt.errors import InputError
from plough_opt.expressions import Expression, is_quantity, map_expressions
from plough_opt.motion.integrators import Integration
from plough_opt.scene import Scene


@dataclass(frozen=True)
class Embedding:
    """A run as one CasADi Function of the equation's parameters and of the whole scene.

    Attributes:
        integration: method, structure and times.
        template: the scene with a placeholder for each of its quantities.
        function: (parameters with the duration last, quantities of the scene) -> results of the
            integration. The quantities have no influence; they let a design rebuild the scene.
    """

    integration: Integration
    template: Scene
    function: ca.Function


@dataclass(frozen=True)
class Label:
    """A scene that a graph carries along without an integration: a value passed through beside its quantities.

    Attributes:
        template: the scene with a placeholder for each of its quantities.
        function: (value, quantities of the scene) -> the same value.
    """

    template: Scene
    function: ca.Function


_KNOWN: dict[int, Embedding | Label] = {}
_BY_LAYOUT: dict[tuple[int, str], Embedding] = {}
_LABELS: dict[str, Label] = {}


def with_numbers(template: Scene, quantities: Sequence[float]) -> Scene:
    """Return a template's scene with numbers for its quantities.

    Raises:
        DomainError: a number lies outside the model's domain.
    """
    numbers = iter(quantities)
    scene: Scene = map_expressions(template, lambda _: float(next(numbers)), is_quantity)
    return scene


def embed(solver: Integration, p: Sequence[Expression], scene: Scene) -> tuple[Expression, ...]:
    """Return the run's results as expressions of the symbols in its scene.

    Args:
        solver: the integration.
        p: its parameters, the duration last.
        scene: the scene that they come from.

    Raises:
        InputError: SX symbols and a method that exists for MX only.
    """
    template, carried = _template(scene)
    inputs = ca.vertcat(*p)
    if isinstance(inputs, ca.SX) or isinstance(carried, ca.SX):
        if solver.accuracy.method not in ORDER_8:
            raise InputError(
                f"method '{solver.accuracy.method}' takes MX symbols only: make the scene of casadi.MX, or use 'dop853'"
            )
        return tuple(solver.function.call([inputs]))
    # Quantities print alike, as placeholders, so scenes that differ in numbers only share one Function.
    layout = (hash(solver.function), repr(template))
    if layout not in _BY_LAYOUT:
        _BY_LAYOUT[layout] = _build(solver, template, carried.numel())
    return tuple(_BY_LAYOUT[layout].function.call([inputs, carried]))


def labelled(value: Expression, scene: Scene) -> Expression:
    """Return a value of a scene as it is; of MX symbols, with the scene carried along in the graph."""
    template, carried = _template(scene)
    if not isinstance(carried, ca.MX) or not isinstance(value, ca.MX):
        return value
    layout = repr(template)
    if layout not in _LABELS:
        x, q = ca.MX.sym("x"), ca.MX.sym("scene", carried.numel())
        function = ca.Function("label", [x, q], [x], ["value", "scene"], ["value_again"], {"never_inline": True})
        _LABELS[layout] = _KNOWN[hash(function)] = Label(template, function)
    return _LABELS[layout].function(value, carried)


def known_call(function: ca.Function) -> Embedding | Label | None:
    """Return what a Function in a graph stands for, or None for any Function that is not of this file."""
    return _KNOWN.get(hash(function))


def _template(scene: Scene) -> tuple[Scene, Expression]:
    """Return a scene with placeholders, and the quantities that they stand for as a column."""
    quantities: list[Expression] = []

    def placeholder(value: Expression) -> ca.SX:
        quantities.append(value)
        return ca.SX.sym("quantity")

    template = map_expressions(scene, placeholder, is_quantity)
    return template, ca.vertcat(*quantities)


def _build(solver: Integration, template: Scene, count: int) -> Embedding:
    p, carried = ca.MX.sym("p", solver.function.numel_in(0)), ca.MX.sym("scene", count)
    # A share that never moves from equilibrium has results that are zero by structure; dense, they keep the call,
    # and with it the scene, in the graph.
    results = [ca.densify(result) for result in solver.function.call([p])]
    names = ["parameters", "scene"], ["states", "means", "variances"]
    function = ca.Function("run", [p, carried], results, *names, {"never_inline": True})
    built = Embedding(solver, template, function)
    _KNOWN[hash(function)] = built
    return built
