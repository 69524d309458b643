"""Equations of an exported share as CasADi Functions of its states, inputs and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.exchange.export.fmu_names import Names, calculated, names_of
from plough_opt.exchange.export.fmu_share import Share, StrutInput
from plough_opt.exchange.export.fmu_variables import Variable, parameters_of, scene_with
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, parameters


@dataclass(frozen=True)
class Model:
    """An exported share.

    Attributes:
        names: variables other than parameters.
        calculated: variables that depend on the parameters alone.
        parameters: those that any equation depends on.
        functions: by name, every argument and result a column. ``derive`` (p) -> (q, calculated), q being the numbers
            in the equation of motion; ``begin`` (u, q) -> (x, d); ``evaluate`` (t, x, u, d, q) -> (rates, outputs,
            indicators); ``happen`` (t, x, u, d, q) -> (x, d) after the events until now. For the first three there are
            ``forward_...``, from the same arguments and a seed for each of x, u, p and q among them to the change of
            all continuous results in one column, and ``reverse_...``, from the same arguments and a seed for that
            column to the sensitivities to each. A soil with a density profile has neither.
        depends: name of a rate, output or indicator -> names of states, inputs and time that it depends on.
    """

    names: Names
    calculated: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    functions: dict[str, ca.Function]
    depends: dict[str, tuple[str, ...]]

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables but the time, in the order in which the C source numbers them."""
        names = self.names
        first = *names.states, *names.rates, *names.outputs, *names.indicators, *self.calculated
        return (*first, *names.inputs, *self.parameters, *names.discrete)


def model_of(scene: Scene, kind: StrutInput, steel_density: float | None) -> Model:
    """Build the equations of a scene of numbers.

    Args:
        scene: a scene with motion from a start.
        kind: whether the input is the strut's speed or its position.
        steel_density: as in `parameters_of`.

    Raises:
        InputError: a strut whose position is the input and whose speed would be needed.
    """
    structure = Structure.of(scene)
    if kind == "position":
        _check_position_suffices(structure)
    offered = parameters_of(scene, steel_density)
    symbols = {variable.name: ca.SX.sym(variable.name) for variable in offered}
    symbolic = scene_with(scene, symbols)
    values = parameters(symbolic) | {"added_mass": symbolic.reaction.added_mass}
    share = Share(scene, structure, kind, {name: ca.SX.sym(name) for name in values})
    names, derived = names_of(scene, share), dict(calculated(scene, symbolic))
    depends = _depends(share, names)
    # The quadratures of a density profile have hundreds of thousands of operations, and their derivatives more.
    differentiable = scene.soil.density_profile is None
    functions, used = _functions(share, values, ca.vertcat(*derived.values()), symbols, differentiable)
    return Model(names, tuple(derived), tuple(v for v in offered if v.name in used), functions, depends)


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


def _functions(
    share: Share, values: dict[str, ca.SX], derived: ca.SX, symbols: dict[str, ca.SX], differentiable: bool
) -> tuple[dict[str, ca.Function], set[str]]:
    """Return the Functions, and the names of the parameters that any of them uses.

    Args:
        share: with a symbol for each number in the equation of motion.
        values: those numbers, as expressions of the parameters' symbols.
        derived: column of the calculated variables, of the same symbols.
        symbols: the parameters by name.
        differentiable: whether to add derivatives.
    """
    time, x, u, d = share.time, share.x, share.input, share.d
    now = [share.rates, share.outputs, share.indicators]
    begun, happened = share.start(), share.after_events()
    needed = {symbol.name() for symbol in ca.symvar(ca.vertcat(*now, *begun, *happened))}
    q = ca.vertcat(*(symbol for name, symbol in share.q.items() if name in needed))
    from_p = ca.vertcat(*(values[name] for name in share.q if name in needed))
    used = {symbol.name() for symbol in ca.symvar(ca.vertcat(from_p, derived))}
    p = ca.vertcat(*(symbol for name, symbol in symbols.items() if name in used))
    written = {
        "derive": ([p], [from_p, derived]),
        "begin": ([u, q], list(begun)),
        "evaluate": ([time, x, u, d, q], now),
        "happen": ([time, x, u, d, q], list(happened)),
    }
    if differentiable:
        for name, to, by in (
            ("derive", [from_p, derived], [p]),
            ("begin", [begun[0]], [u, q]),
            ("evaluate", now, [x, u, q]),
        ):
            arguments, unknown, known = written[name][0], ca.vertcat(*to), ca.vertcat(*by)
            seeds, seed = [ca.SX.sym("seed", part.numel()) for part in by], ca.SX.sym("seed", unknown.numel())
            change = ca.jtimes(unknown, known, ca.vertcat(*seeds))
            written[f"forward_{name}"] = ([*arguments, *seeds], [change])
            ends = np.cumsum([0, *(part.numel() for part in by)])
            backwards = ca.vertsplit(ca.jtimes(unknown, known, seed, True), ends.tolist())
            written[f"reverse_{name}"] = ([*arguments, seed], backwards)
    functions = {
        name: ca.Function(name, arguments, [ca.densify(ca.SX(result)) for result in results], {"cse": True})
        for name, (arguments, results) in written.items()
    }
    return functions, used


def _depends(share: Share, names: Names) -> dict[str, tuple[str, ...]]:
    """Return the states, inputs and time on which each rate, output and indicator depends."""
    rows = (*names.rates, *names.outputs, *names.indicators)
    known = (*(variable.name for variable in (*names.states, *names.inputs)), "time")
    now = ca.vertcat(share.rates, share.outputs, share.indicators)
    pattern = ca.jacobian_sparsity(now, ca.vertcat(share.x, share.input, share.time))
    depends: dict[str, list[str]] = {variable.name: [] for variable in rows}
    for row, column in zip(*pattern.get_triplet(), strict=True):
        depends[rows[row].name].append(known[column])
    return {name: tuple(sorted(on, key=known.index)) for name, on in depends.items()}
