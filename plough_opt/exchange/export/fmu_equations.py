"""Equations of an exported share: Functions of its states, inputs and parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.exchange.export.fmu_share import Share
from plough_opt.exchange.export.fmu_variables import Variable, calculated, parameters_of, scene_with, variables_of
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion.terms import Structure, parameters

KINDS = ("states", "rates", "outputs", "indicators", "calculated", "inputs", "parameters", "discrete")
"""Kinds of variables, in the order in which the C source numbers them."""


@dataclass(frozen=True)
class Model:
    """An exported share.

    Attributes:
        of_kind: variables by kind. "calculated" depend on the "parameters" alone, and of these there are those that any
            equation depends on; "discrete" change at events only.
        functions: by name, every argument and result a column. ``derive`` (p) -> (q, calculated), q being the numbers
            in the equation of motion; ``begin`` (u, q) -> (x, d); ``evaluate`` (t, x, u, d, q) -> (rates, outputs,
            indicators); ``happen`` (t, x, u, d, q) -> (x, d) after the events until now. For the first three there are
            ``forward_...``, from the same arguments and a seed for each of x, u, p and q among them to the change of
            all continuous results in one column, and ``reverse_...``, from the same arguments and a seed for that
            column to the sensitivities to each. A soil with a density profile has neither.
        depends: name of a rate, output or indicator -> names of states, inputs and time that it depends on.
    """

    of_kind: Mapping[str, tuple[Variable, ...]]
    functions: Mapping[str, ca.Function]
    depends: Mapping[str, tuple[str, ...]]

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables but the time, in the order in which the C source numbers them."""
        return tuple(chain.from_iterable(self.of_kind[kind] for kind in KINDS))


def model_of(named: NamedScene, *, by_speed: bool) -> Model:
    """Build the equations of a numeric scene with motion from a start.

    Args:
        named: the scene.
        by_speed: whether the input is the strut's speed; else it is its position.

    Raises:
        InputError: a strut whose position is the input and whose speed would be needed.
    """
    scene, structure = named.scene, Structure.of(named.scene)
    if not by_speed:
        _check_position_suffices(structure)
    offered = tuple(parameters_of(named))
    symbols = {variable.name: ca.SX.sym(variable.name) for variable in offered}
    symbolic = scene_with(named, symbols)
    values = parameters(symbolic) | {"added_mass": symbolic.reaction.added_mass}
    share = Share(scene, structure, by_speed, {name: ca.SX.sym(name) for name in values})
    expressions = variables_of(share, scene) | {"calculated": calculated(scene, symbolic)}
    columns = {kind: _column(found.values()) for kind, found in expressions.items()}
    begun, happened = map(_column, share.start()), map(_column, share.after_events())
    now = [columns[kind] for kind in ("rates", "outputs", "indicators")]
    written = {
        "begin": ([columns["inputs"]], [*begun]),
        "evaluate": ([share.time, *(columns[kind] for kind in ("states", "inputs", "discrete"))], now),
    }
    written["happen"] = (written["evaluate"][0], [*happened])
    results = _column(chain.from_iterable(found for _, found in written.values()))
    used = [name for name, symbol in share.q.items() if symbol.name() in _names(results)]
    q, from_p = (_column(source[name] for name in used) for source in (share.q, values))
    written = {name: ([*arguments, q], found) for name, (arguments, found) in written.items()}
    needed = _names(ca.vertcat(from_p, columns["calculated"]))
    p = _column(symbol for name, symbol in symbols.items() if name in needed)
    written = {"derive": ([p], [from_p, columns["calculated"]]), **written}
    # The quadratures of a density profile have hundreds of thousands of operations, and their derivatives more.
    if scene.soil.density_profile is None:
        states, inputs = columns["states"], columns["inputs"]
        written |= _derivatives("derive", *written["derive"], [p])
        written |= _derivatives("begin", written["begin"][0], written["begin"][1][:1], [inputs, q])
        written |= _derivatives("evaluate", *written["evaluate"], [states, inputs, q])
    functions = {
        name: ca.Function(name, arguments, [*map(ca.densify, found)], {"cse": True})
        for name, (arguments, found) in written.items()
    }
    of_kind = {kind: tuple(found) for kind, found in expressions.items()}
    of_kind["parameters"] = tuple(variable for variable in offered if variable.name in needed)
    known = _column([columns["states"], columns["inputs"], share.time])
    return Model(of_kind, functions, _depends(of_kind, ca.jacobian_sparsity(_column(now), known)))


def _check_position_suffices(structure: Structure) -> None:
    """Raise InputError if the equations need the strut's speed."""
    if structure.damper:
        raise InputError(
            "a damper in the mount needs the strut's speed, which its position does not give: use strut = 'speed', or"
            " leave damping out"
        )
    if structure.ramp:
        raise InputError(
            "tow_ramp is a motion of the strut, and so is its position as the input: use strut = 'speed', or leave"
            " tow_ramp out"
        )


def _column(values: Any) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *values)


def _names(expression: ca.SX) -> set[str]:
    return {symbol.name() for symbol in ca.symvar(expression)}


def _derivatives(
    name: str, arguments: list[ca.SX], results: list[ca.SX], by: list[ca.SX]
) -> dict[str, tuple[list[ca.SX], list[ca.SX]]]:
    """Return arguments and results of the products of a Jacobian with seeds, forwards and backwards."""
    unknown, known = _column(results), _column(by)
    seeds, seed = [ca.SX.sym("seed", part.numel()) for part in by], ca.SX.sym("seed", unknown.numel())
    ends = np.cumsum([0, *(part.numel() for part in by)]).tolist()
    backwards = ca.vertsplit(ca.jtimes(unknown, known, seed, True), ends)
    return {
        f"forward_{name}": ([*arguments, *seeds], [ca.jtimes(unknown, known, _column(seeds))]),
        f"reverse_{name}": ([*arguments, seed], backwards),
    }


def _depends(of_kind: Mapping[str, tuple[Variable, ...]], pattern: ca.Sparsity) -> dict[str, tuple[str, ...]]:
    """Return names of the states, inputs and time on which each rate, output and indicator depends."""
    rows = [variable.name for kind in ("rates", "outputs", "indicators") for variable in of_kind[kind]]
    known = [*(variable.name for kind in ("states", "inputs") for variable in of_kind[kind]), "time"]
    depends: dict[str, tuple[str, ...]] = dict.fromkeys(rows, ())
    for row, column in sorted(zip(*pattern.get_triplet(), strict=True)):
        depends[rows[row]] += (known[column],)
    return depends
