"""Equation of motion (27) as CasADi Functions: the right-hand side, and the events that interrupt it.

A share that slips has the states (w, w'). Under `StickSlip`, and while a share enters, two more follow: how far it is
behind its furthest point [m], and its mode, whose rate is zero. Of a share that enters the next state is 1 once it was
wholly in the soil, and before 0; behind a strut whose speed ramps up the last one is 1 once the ramp is over.
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

# Part of the tow speed within which a difference of the strut's and the spring's speed is rounding.
_STANDSTILL = 1e-12


@dataclass(frozen=True)
class EquationOfMotion:
    """Right-hand side as a CasADi Function, with exactly the parameters that it uses.

    Attributes:
        function: (time [s], state, parameters) -> rate of the state.
        events: (time, state, parameters) -> (what is negative after an event, a row each; the state after each event,
            a column each), or None.
        names: names of the parameters, in order.
    """

    function: ca.Function
    events: ca.Function | None
    names: tuple[str, ...]

    def rates(self, time: Column, state: Column, p: Parameters) -> Column:
        """Return the rate of the state, of parameters by name."""
        return self.function(time, state, stacked(*(p[name] for name in self.names)))

    @property
    def states(self) -> int:
        """Number of states."""
        return int(self.function.numel_out(0))


class _Now:
    """The share at one moment: its state as symbols, and what follows from it.

    Attributes:
        speed: L' [m/s].
        stopping: becomes negative when the share stops: its speed, but for rounding of one that barely moves yet.
        pull: mount force P [N].
        slipping: w'' of a share that slips [m/s^2].
    """

    def __init__(self, structure: Structure, p: dict[str, ca.SX]) -> None:
        """Make the symbols of a structure's state."""
        self.time = ca.SX.sym("time")
        self.w, self.rate = ca.SX.sym("w"), ca.SX.sym("rate")
        self.opening, self.mode = ca.SX.sym("opening"), ca.SX.sym("mode")
        modes = (self.opening, self.mode) if structure.events else ()
        ended = {term.state: ca.SX.sym(term.state) for term in structure.ending}
        self.state = stacked(self.w, self.rate, *modes, *ended.values())
        self.structure = structure
        self.p = p | ended | ({"behind": self.opening} if structure.entry else {})
        self.mount = terms.strut(structure, self.p, self.time)
        self.travel = self.mount.path - terms.start_deflection(structure, p) - self.w
        self.strut_speed = terms.start_speed(structure, self.p) + self.mount.gain
        self.speed = self.strut_speed - self.rate
        self.stopping = self.speed + _STANDSTILL * self.p["tow_speed"]
        change = terms.pull(structure, self.p, self.w, self.rate)
        self.pull = terms.start_force(structure, self.p) + change
        if structure.relaxed:
            soil = terms.resistance(structure, self.p, self.travel, self.speed)
        else:
            soil = terms.resistance_change(structure, self.p, self.travel, self.mount.gain - self.rate)
        acceleration = (soil - change) / terms.inertia_at(structure, self.p, self.travel)
        self.slipping = acceleration + self.mount.acceleration if structure.ramp else acceleration

    def by_mode(self, slip: Column, stick: Column, gap: Column) -> Column:
        """Choose by the mode, element by element."""
        middle = (SLIP + STICK) / 2.0, (STICK + GAP) / 2.0
        chosen = [
            where(self.mode < middle[0], a, where(self.mode < middle[1], b, c))
            for a, b, c in zip(*(ca.vertsplit(ca.densify(ca.SX(x))) for x in (slip, stick, gap)), strict=True)
        ]
        return stacked(*chosen)


def _stick_slip(now: _Now) -> tuple[Column, list[Column], list[Column]]:
    """Return the rate of the four states in the mode that is on, what is negative once that ends, the state after."""
    p, mass = now.p, now.p["mass"]
    hold = terms.hold(now.structure, p, now.travel)
    slip = stacked(now.rate, now.slipping, 0.0, 0.0)
    stick = stacked(now.strut_speed, now.mount.acceleration, 0.0, 0.0)
    gap = stacked(now.rate, now.mount.acceleration - now.pull / mass, -now.speed, 0.0)
    # While the share sticks the strut only stretches the mount: P never falls back to 0.
    until = now.by_mode(now.stopping, hold - now.pull, now.opening)
    stopped = where(now.pull < 0.0, GAP, where(now.pull <= hold, STICK, SLIP))
    taken_up = now.speed * mass / (mass + terms.carried_mass(now.structure, p, now.travel))
    rate = now.by_mode(now.strut_speed, now.strut_speed, now.strut_speed - taken_up)
    after = stacked(now.w, rate, 0.0, now.by_mode(stopped, SLIP, SLIP))
    return now.by_mode(slip, stick, gap), [until], [after]


def _entering(now: _Now) -> tuple[Column, list[Column], list[Column]]:
    """Return the like of a share that enters and never leaves contact; it may turn back, and is then behind."""
    behind = now.mode > STICK
    rates = stacked(now.rate, now.slipping, where(behind, -now.speed, 0.0), 0.0)
    turning = where(now.p["entered"] < 0.5, where(behind, now.opening, now.stopping), 1.0)
    after = stacked(now.w, now.rate, 0.0, where(behind, SLIP, GAP))
    return rates, [turning], [after]


@lru_cache(maxsize=64)
def equation_of_motion(structure: Structure) -> EquationOfMotion:
    """Build the differential equation of a structure; terms that are off leave no trace in it."""
    symbols = {name: ca.SX.sym(name) for name in structure.names}
    now = _Now(structure, symbols)
    if structure.sticks:
        rates, zeros, after = _stick_slip(now)
    elif structure.entry:
        rates, zeros, after = _entering(now)
    else:
        rates, zeros, after = stacked(now.rate, now.slipping), [], []
    counted = now.state[4 if structure.events else 2 :]
    rates, after = stacked(rates, ca.SX.zeros(counted.numel())), [stacked(state, counted) for state in after]
    for term, ended in zip(structure.ending, ca.vertsplit(counted), strict=True):
        zeros.append(where(ended < 0.5, term.until(now.p, now.time, now.travel), 1.0))
        after.append(ca.substitute(now.state, ended, 1.0))
    everything = stacked(rates, *zeros, *after)
    used = {symbol.name() for symbol in ca.symvar(everything)} & set(structure.names)
    names = tuple(name for name in structure.names if name in used)
    inputs = [now.time, now.state, stacked(*(symbols[name] for name in names))]
    labels = ["time", "state", "parameters"]
    function = ca.Function("equation_of_motion", inputs, [rates], labels, ["rate"])
    if not zeros:
        return EquationOfMotion(function, None, names)
    results = [stacked(*zeros), ca.horzcat(*after)]
    return EquationOfMotion(function, ca.Function("events", inputs, results, labels, ["zero", "after"]), names)


def start_state(structure: Structure, p: Parameters) -> Column:
    """Return the state at time 0 as a column."""
    first = stacked(0.0, terms.start_rate(structure, p))
    counted = (0.0,) * len(structure.ending)
    if not structure.sticks:
        return stacked(first, *((0.0, SLIP) if structure.entry else ()), *counted)
    # A share without speed sticks, unless the mount already pulls enough.
    speed = 0.0 if structure.start == "rest" else terms.start_speed(structure, p)
    pulled = terms.start_force(structure, p) + terms.pull(structure, p, 0.0, terms.start_rate(structure, p))
    held = pulled < terms.hold(structure, p, -terms.start_deflection(structure, p))
    return stacked(first, 0.0, where(speed > 0.0, SLIP, where(held, STICK, SLIP)), *counted)


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

    def named(self, p: Column) -> dict[str, Expression]:
        """Return a column of the parameters, with the duration last, by name; without the duration."""
        values: list[Column] = ca.vertsplit(p[:-1])
        return dict(zip(self.parameters, values, strict=True))


@lru_cache(maxsize=64)
def signals(structure: Structure) -> Signals:
    """Build the signals of a structure. Without a damper the mount force is k0 z and needs none of its own."""
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
    # A start at rest needs the strut's speed even where nothing else does.
    everything = stacked(expression, terms.start_rate(structure, symbols))
    used = {s.name() for s in ca.symvar(everything)} | set(equation_of_motion(structure).names)
    names = tuple(name for name in structure.names if name in used)
    p = stacked(*(symbols[name] for name in names))
    function = ca.Function("signals", [time, state, p], [expression])
    return Signals(function, names, len(values), squared)
