"""Signals that are averaged over a run: deflection, mount force and tow power, each as change since the start."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import casadi as ca

from plough_opt.core.expressions import Expression
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.terms import Structure, pull, start_force, start_rate, start_speed, strut

Symbols = TypeVar("Symbols", ca.SX, ca.MX)


@dataclass(frozen=True)
class Signals:
    """Integrands of a run's averages.

    Attributes:
        function: (time [s], state (w [m], w' [m/s]), parameters) -> signals. Where the end of the strut's ramp is an
            event the state has a third element, ``ramped``.
        parameters: names of all parameters of the equation of motion and of the signals, in order.
        count: number of signals: change of deflection w; with a damper, change of mount force
            k0 w + c (w' - w'(0)); with a tow ramp, the tow power P s'.
        squared: how many of them, from the first, have an RMS.
    """

    function: ca.Function
    parameters: tuple[str, ...]
    count: int
    squared: int

    def symbols(self, kind: type[Symbols]) -> tuple[Symbols, dict[str, Expression]]:
        """Return a column of symbols of a kind for the parameters, the duration last, and those before it by name."""
        p = kind.sym("p", len(self.parameters) + 1)
        return p, self.named(p)

    def named(self, p: Expression) -> dict[str, Expression]:
        """Return a column of the parameters, with the duration last, by name; without the duration."""
        return dict(zip(self.parameters, ca.vertsplit(p[:-1]), strict=True))


@lru_cache(maxsize=64)
def signals(structure: Structure) -> Signals:
    """Build the signals of a structure. Without a damper the mount force is k0 z and needs none of its own."""
    symbols = {name: ca.SX.sym(name) for name in structure.names}
    time, w, rate = ca.SX.sym("time"), ca.SX.sym("w"), ca.SX.sym("rate")
    state = ca.vertcat(w, rate)
    if structure.ends_ramp:
        ramped = ca.SX.sym("ramped")
        state, symbols = ca.vertcat(state, ramped), symbols | {"ramped": ramped}
    force = pull(structure, symbols, w, rate - start_rate(structure, symbols))
    values = [w, force] if structure.damper else [w]
    squared = len(values)
    if structure.ramp:
        speed = start_speed(structure, symbols) + strut(structure, symbols, time).gain
        values.append((start_force(structure, symbols) + force) * speed)
    expression = ca.vertcat(*values)
    # A start at rest needs the strut's speed even where nothing else does.
    everything = ca.vertcat(expression, start_rate(structure, symbols))
    used = {s.name() for s in ca.symvar(everything)} | set(equation_of_motion(structure).names)
    names = tuple(name for name in structure.names if name in used)
    p = ca.vertcat(*(symbols[name] for name in names))
    function = ca.Function("signals", [time, state, p], [expression])
    return Signals(function, names, len(values), squared)
