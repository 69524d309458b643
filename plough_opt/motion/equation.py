"""Equation of motion (27) as CasADi Functions: the right-hand side, and the events that interrupt it.

The states begin with (w, w'). With `StickSlip` or entry two more follow: the distance behind the furthest point [m],
and the mode, whose rate is zero. With entry the next state is 0 until the share is fully in the soil, and 1 afterwards.
With a tow ramp whose end is an event, the last state is 0 until that end, and 1 afterwards.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, TypeVar

import casadi as ca

from plough_opt.core.expressions import Column, Expression, stacked, where
from plough_opt.motion import terms
from plough_opt.motion.effects.term import Parameters
from plough_opt.motion.terms import Structure

SLIP: Final = 0.0
STICK: Final = 1.0
GAP: Final = 2.0

# A speed below this fraction of the tow speed is rounding of the difference between strut's and spring's speed.
_STANDSTILL = 1e-12


@dataclass(frozen=True)
class EquationOfMotion:
    """Right-hand side as a CasADi Function of exactly the parameters that it uses.

    Attributes:
        function: (time [s], state, parameters) -> rate of the state.
        events: (time [s], state, parameters) -> (values, a row for each event, that become negative at the event; the
            state after each event, a column each); None without events.
        names: names of the parameters, in order.
    """

    function: ca.Function
    events: ca.Function | None
    names: tuple[str, ...]

    def rates(self, time: Column, state: Column, p: Parameters) -> Column:
        """Return the rate of the state for parameters by name."""
        return self.function(time, state, stacked(*(p[name] for name in self.names)))

    @property
    def states(self) -> int:
        """Number of states."""
        return int(self.function.numel_out(0))


class _SymbolicShare:
    """State of the share as symbols, and expressions that follow from it.

    Attributes:
        speed: L' [m/s].
        stopping: speed [m/s] that becomes negative when the share stops, but not by rounding at the start.
        mount_force: P [N].
        slipping: w'' of a slipping share [m/s^2].
    """

    def __init__(self, structure: Structure, p: dict[str, ca.SX]) -> None:
        """Create the symbols of a structure's state."""
        self.time = ca.SX.sym("time")
        self.w, self.rate = ca.SX.sym("w"), ca.SX.sym("rate")
        self.opening, self.mode = ca.SX.sym("opening"), ca.SX.sym("mode")
        modes = (self.opening, self.mode) if structure.events else ()
        ended = {term.state: ca.SX.sym(term.state) for term in structure.ending}
        self.state = stacked(self.w, self.rate, *modes, *ended.values())
        self.structure = structure
        self.p = p | ended | ({"behind": self.opening} if structure.entry else {})
        self.strut = terms.strut(structure, self.p, self.time)
        self.travel = self.strut.path - terms.start_deflection(structure, p) - self.w
        self.strut_speed = terms.start_speed(structure, self.p) + self.strut.gain
        self.speed = self.strut_speed - self.rate
        self.stopping = self.speed + _STANDSTILL * self.p["tow_speed"]
        change = terms.pull(structure, self.p, self.w, self.rate)
        self.mount_force = terms.start_force(structure, self.p) + change
        if structure.relaxed:
            soil = terms.resistance(structure, self.p, self.travel, self.speed)
        else:
            soil = terms.resistance_change(structure, self.p, self.travel, self.strut.gain - self.rate)
        acceleration = (soil - change) / terms.inertia_at(structure, self.p, self.travel)
        self.slipping = acceleration + self.strut.acceleration if structure.ramp else acceleration

    def by_mode(self, slip: Column, stick: Column, gap: Column) -> Column:
        """Return the column that belongs to the mode, chosen element by element."""
        middle = (SLIP + STICK) / 2.0, (STICK + GAP) / 2.0
        chosen = [
            where(self.mode < middle[0], a, where(self.mode < middle[1], b, c))
            for a, b, c in zip(*(ca.vertsplit(ca.densify(ca.SX(x))) for x in (slip, stick, gap)), strict=True)
        ]
        return stacked(*chosen)


def _stick_slip(share: _SymbolicShare) -> tuple[Column, list[Column], list[Column]]:
    """Return the rate of the four states, the value that becomes negative when the mode ends, and the state after."""
    p, mass = share.p, share.p["mass"]
    breakaway = terms.hold(share.structure, p, share.travel)
    slip = stacked(share.rate, share.slipping, 0.0, 0.0)
    stick = stacked(share.strut_speed, share.strut.acceleration, 0.0, 0.0)
    gap = stacked(share.rate, share.strut.acceleration - share.mount_force / mass, -share.speed, 0.0)
    # While the share sticks the strut only compresses the mount, so P cannot fall to 0.
    until = share.by_mode(share.stopping, breakaway - share.mount_force, share.opening)
    stopped = where(share.mount_force < 0.0, GAP, where(share.mount_force <= breakaway, STICK, SLIP))
    speed_with_soil = share.speed * mass / (mass + terms.carried_mass(share.structure, p, share.travel))
    rate = share.by_mode(share.strut_speed, share.strut_speed, share.strut_speed - speed_with_soil)
    after = stacked(share.w, rate, 0.0, share.by_mode(stopped, SLIP, SLIP))
    return share.by_mode(slip, stick, gap), [until], [after]


def _entering(share: _SymbolicShare) -> tuple[Column, list[Column], list[Column]]:
    """Return the same as `_stick_slip` for a share that enters and stays in contact.

    It may turn back. The mode GAP then marks that it is behind its furthest point.
    """
    behind = share.mode > STICK
    rates = stacked(share.rate, share.slipping, where(behind, -share.speed, 0.0), 0.0)
    turning = where(share.p["entered"] < 0.5, where(behind, share.opening, share.stopping), 1.0)
    after = stacked(share.w, share.rate, 0.0, where(behind, SLIP, GAP))
    return rates, [turning], [after]


@lru_cache(maxsize=64)
def equation_of_motion(structure: Structure) -> EquationOfMotion:
    """Build the differential equation of a structure from the terms that are on."""
    symbols = {name: ca.SX.sym(name) for name in structure.names}
    share = _SymbolicShare(structure, symbols)
    if structure.sticks:
        rates, zeros, after = _stick_slip(share)
    elif structure.entry:
        rates, zeros, after = _entering(share)
    else:
        rates, zeros, after = stacked(share.rate, share.slipping), [], []
    end_flags = share.state[4 if structure.events else 2 :]
    rates, after = stacked(rates, ca.SX.zeros(end_flags.numel())), [stacked(state, end_flags) for state in after]
    for term, ended in zip(structure.ending, ca.vertsplit(end_flags), strict=True):
        zeros.append(where(ended < 0.5, term.until(share.p, share.time, share.travel), 1.0))
        after.append(ca.substitute(share.state, ended, 1.0))
    everything = stacked(rates, *zeros, *after)
    used = {symbol.name() for symbol in ca.symvar(everything)} & set(structure.names)
    names = tuple(name for name in structure.names if name in used)
    inputs = [share.time, share.state, stacked(*(symbols[name] for name in names))]
    labels = ["time", "state", "parameters"]
    function = ca.Function("equation_of_motion", inputs, [rates], labels, ["rate"])
    if not zeros:
        return EquationOfMotion(function, None, names)
    results = [stacked(*zeros), ca.horzcat(*after)]
    return EquationOfMotion(function, ca.Function("events", inputs, results, labels, ["zero", "after"]), names)


def start_state(structure: Structure, p: Parameters) -> Column:
    """Return the state at time 0 as a column."""
    first = stacked(0.0, terms.start_rate(structure, p))
    end_flags = (0.0,) * len(structure.ending)
    if not structure.sticks:
        return stacked(first, *((0.0, SLIP) if structure.entry else ()), *end_flags)
    # A share without speed sticks, unless the mount force already exceeds what holds it.
    speed = 0.0 if structure.start == "rest" else terms.start_speed(structure, p)
    pulled = terms.start_force(structure, p) + terms.pull(structure, p, 0.0, terms.start_rate(structure, p))
    held = pulled < terms.hold(structure, p, -terms.start_deflection(structure, p))
    return stacked(first, 0.0, where(speed > 0.0, SLIP, where(held, STICK, SLIP)), *end_flags)


Symbols = TypeVar("Symbols", ca.SX, ca.MX)


@dataclass(frozen=True)
class Signals:
    """Signals whose time averages a run reports.

    Attributes:
        function: (time [s], state (w [m], w' [m/s]), parameters) -> signals. If the end of the strut's ramp is an
            event, the state has a third element, ``ramped``.
        parameters: names of all parameters of the equation of motion and of the signals, in order.
        count: number of signals: the change of deflection w; with a damper, the change of mount force
            k0 w + c (w' - w'(0)); with a tow ramp, the tow power P s'.
        squared: number of signals, from the first, that have an RMS too.
    """

    function: ca.Function
    parameters: tuple[str, ...]
    count: int
    squared: int

    def symbols(self, kind: type[Symbols]) -> tuple[Symbols, dict[str, Expression]]:
        """Return a column of symbols for the parameters and, last, the duration; and the parameters by name."""
        p = kind.sym("p", len(self.parameters) + 1)
        return p, self.named(p)

    def named(self, p: Column) -> dict[str, Expression]:
        """Return the parameters by name, from a column that has the duration as its last element."""
        values: list[Column] = ca.vertsplit(p[:-1])
        return dict(zip(self.parameters, values, strict=True))


@lru_cache(maxsize=64)
def signals(structure: Structure) -> Signals:
    """Build the signals of a structure. Without a damper the mount force is k0 z and needs no signal."""
    symbols = {name: ca.SX.sym(name) for name in structure.names}
    time, w, rate = ca.SX.sym("time"), ca.SX.sym("w"), ca.SX.sym("rate")
    state = stacked(w, rate)
    if structure.ends_ramp:
        ramped = ca.SX.sym("ramped")
        state, symbols = stacked(state, ramped), symbols | {"ramped": ramped}
    force = terms.pull(structure, symbols, w, rate - terms.start_rate(structure, symbols))
    values: list[Expression] = [w, force] if structure.damper else [w]
    squared = len(values)
    if structure.ramp:
        speed = terms.start_speed(structure, symbols) + terms.strut(structure, symbols, time).gain
        values.append((terms.start_force(structure, symbols) + force) * speed)
    expression = stacked(*values)
    # A start at rest needs the strut's speed even if no signal does.
    everything = stacked(expression, terms.start_rate(structure, symbols))
    used = {s.name() for s in ca.symvar(everything)} | set(equation_of_motion(structure).names)
    names = tuple(name for name in structure.names if name in used)
    p = stacked(*(symbols[name] for name in names))
    function = ca.Function("signals", [time, state, p], [expression])
    return Signals(function, names, len(values), squared)
