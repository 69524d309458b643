"""Terms of the equation of motion (27) in the spring deflection; a scene has only the terms that it needs.

With z = s(t) - L the deflection of the spring, z0 its value at the start and w = z - z0, the equation is

    M w'' = F(L, L') - k0 z0 - k0 w - c w' + M s''

It is written in deviations from the start, so that the large steady forces of an equilibrium start cancel algebraically
and not in floating point. As printed, with + k0 (L - V0 t), the spring repels: the parameter "stiffness" is then -k0,
the equilibrium lies at z = -F/k0, and a deviation from it grows like exp(sqrt(k0/M) t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeVar

from plough_opt.core.expressions import Expression
from plough_opt.core.labels import unlabelled
from plough_opt.motion.effects import TERMS, Damping, Entry, HarmonicBalance, Own, SmoothContact, StickSlipContact
from plough_opt.motion.effects.strength_waves import StrengthWaves
from plough_opt.motion.effects.term import Changed, Parameters, Place, Term, resisted
from plough_opt.motion.effects.tow_ramp import Strut, TowRamp
from plough_opt.motion.scene import Scene

_Kind = TypeVar("_Kind", bound=Term)

# Parameters that do not belong to a single effect. The last two are used if events change the moving mass.
_COMMON = ("inertia", "stiffness", "static", "tow_speed", "mass", "added_mass")


@dataclass(frozen=True)
class Structure:
    """Terms of a scene's equation of motion without their numbers. Scenes of equal structure share one graph.

    Attributes:
        terms: the effects that are on, in the order of `TERMS`.
        start: see `Effects`.
        carries: whether events change the mass of soil that moves with the share.
        orbit: see `Effects`.
        harmonics: number of harmonics of a harmonic balance; otherwise 0.
        ramp_by_step: whether each step states if the ramp is over: see `plough_opt.motion.runge_kutta.OneStep`.
        locates_ramp: whether an integrator locates the end of the ramp even if the scene has no other events.
    """

    terms: tuple[Term, ...] = ()
    start: Literal["equilibrium", "rest", "towed"] = "equilibrium"
    carries: bool = False
    orbit: Literal["transient", "periodic", "linearised", "harmonic_balance"] = "transient"
    harmonics: int = 0
    ramp_by_step: bool = False
    locates_ramp: bool = False

    @classmethod
    def of(cls, scene: Scene) -> Structure:
        """Return the structure of a scene."""
        effects, orbit = scene.effects, scene.effects.orbit
        terms = tuple(term for kind in TERMS for term in kind.of(scene))
        carries = effects.added_mass and effects.events
        if isinstance(orbit, HarmonicBalance):
            return cls(terms, effects.start, carries, "harmonic_balance", orbit.harmonics)
        return cls(terms, effects.start, carries, orbit)

    def find(self, kind: type[_Kind]) -> _Kind | None:
        """Return the term of a class, or None if that effect is off."""
        return next((term for term in self.terms if isinstance(term, kind)), None)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters that the terms may need, in order."""
        by_step = ("ramped",) if self.ramp_by_step else ()
        return (*_COMMON, *(name for term in self.terms for name in term.names), *by_step)

    @cached_property
    def wave(self) -> StrengthWaves | None:
        """Strength waves along the path, or None."""
        return self.find(StrengthWaves)

    @cached_property
    def ramp(self) -> bool:
        """Whether the strut's speed ramps up."""
        return self.find(TowRamp) is not None

    @cached_property
    def damper(self) -> bool:
        """Whether the mount has a damper."""
        return self.find(Damping) is not None

    @cached_property
    def entry(self) -> bool:
        """Whether the share enters the soil."""
        return self.find(Entry) is not None

    @cached_property
    def smooth(self) -> bool:
        """Whether the contact is `Smooth`."""
        return self.find(SmoothContact) is not None

    @cached_property
    def sticks(self) -> bool:
        """Whether the contact is `StickSlip`."""
        return self.find(StickSlipContact) is not None

    @cached_property
    def own(self) -> tuple[Own, ...]:
        """Resistances of the user's own."""
        return tuple(term for term in self.terms if isinstance(term, Own))

    @property
    def relaxed(self) -> bool:
        """Whether the spring is relaxed at the start."""
        return self.start != "equilibrium"

    @cached_property
    def kinked(self) -> bool:
        """Whether the equation has a kink that a share may reach, where steps of order 8 lose their order."""
        return any(term.kinked for term in self.terms)

    @cached_property
    def events(self) -> bool:
        """Whether an integrator must locate events."""
        return any(term.events for term in self.terms)

    @property
    def stepped(self) -> bool:
        """Whether the motion runs from a start without events, so that steps of order 8 can integrate it."""
        return self.orbit == "transient" and not self.events

    @cached_property
    def ends_ramp(self) -> bool:
        """Whether an integrator must locate the end of the strut's ramp."""
        return self.ramp and (self.events or self.locates_ramp)

    @cached_property
    def ending(self) -> tuple[Term, ...]:
        """Effects whose end an integrator locates. Each has a state that is 0 until then and 1 afterwards."""
        return tuple(term for term in self.terms if term.state and (self.ends_ramp or not isinstance(term, TowRamp)))


def parameters(scene: Scene, structure: Structure | None = None) -> dict[str, Expression]:
    """Return the parameters that the equation of motion may need, by name, in SI units."""
    structure = structure or Structure.of(scene)
    with unlabelled():  # a design checks a run together with its scene
        inertia, reaction = scene.inertia, scene.reaction
        values = {
            "inertia": inertia,
            "stiffness": scene.restoring_stiffness,
            "static": reaction.static,
            "tow_speed": scene.tow_speed,
        }
        if structure.events:
            values["mass"] = scene.mass
        if structure.carries:
            values["added_mass"] = reaction.added_mass
        for term in structure.terms:
            values |= term.values(scene)
    return values


def strut(structure: Structure, p: Parameters, time: Expression) -> Strut:
    """Return the strut's motion: at constant speed, or with a ramp."""
    ramp = structure.find(TowRamp)
    return Strut(path=p["tow_speed"] * time, gain=0.0, acceleration=0.0) if ramp is None else ramp.strut(p, time)


def start_speed(structure: Structure, p: Parameters) -> Expression:
    """Return the strut's speed at time 0 [m/s], which also defines the steady state of an equilibrium start."""
    return 0.0 if structure.ramp else p["tow_speed"]


def start_resistance(structure: Structure, p: Parameters) -> Expression:
    """Return the steady resistance to a buried share at the strut's initial speed [N], without strength waves."""
    return _resist(structure, p, p["static"], Place(None, start_speed(structure, p)))


def start_force(structure: Structure, p: Parameters) -> Expression:
    """Return the spring's force at the start [N]: the steady resistance, or 0 for a relaxed spring."""
    return 0.0 if structure.relaxed else start_resistance(structure, p)


def start_deflection(structure: Structure, p: Parameters) -> Expression:
    """Return the deflection z0 at the start [m]: steady, or 0 for a relaxed spring."""
    return start_force(structure, p) / p["stiffness"]


def start_rate(structure: Structure, p: Parameters) -> Expression:
    """Return z' at time 0 [m/s]: V0 for a share at rest under a moving strut, otherwise 0."""
    return start_speed(structure, p) if structure.start == "rest" else 0.0


def resistance(structure: Structure, p: Parameters, travel: Expression, speed: Expression) -> Expression:
    """Return the resistance [N] without that of the added mass, accurate to all digits even if it is small.

    Args:
        structure: the terms that are on.
        p: parameters by name.
        travel: L of the share [m].
        speed: L' of the share [m/s].
    """
    return _resist(structure, p, p["static"], Place(travel, speed))


def resistance_change(structure: Structure, p: Parameters, travel: Expression, gain: Expression) -> Expression:
    """Return the resistance minus the steady resistance of an equilibrium start [N]: see `resistance`.

    Args:
        structure: the terms that are on, without entry, which excludes an equilibrium start.
        p: parameters by name.
        travel: L of the share [m].
        gain: L' - s'(0), the share's speed relative to the strut's initial speed [m/s].
    """
    at = Place(travel, Changed(start_speed(structure, p), gain))
    found: Any = _resist(structure, p, Changed(p["static"], 0.0), at)
    change: Expression = found.change
    return change


def _resist(structure: Structure, p: Parameters, force: Any, at: Place) -> Expression:
    """Return the resistance that the terms, one after another, make of the static force [N]."""
    found: Expression = resisted(structure.terms, force, at, p)
    return found


def hold(structure: Structure, p: Parameters, travel: Expression) -> Expression:
    """Return the mount force [N] at which a sticking share at a travel L [m] breaks loose: see `StickSlip`."""
    force = p["static"]
    for term in structure.terms:
        force = term.hold(force, Place(travel, 0.0), p)
    return force


def pull(structure: Structure, p: Parameters, deflection: Expression, rate: Expression) -> Expression:
    """Return the mount force [N] at a deflection [m] and its rate [m/s], or its change for changes of both."""
    force = p["stiffness"] * deflection
    for term in structure.terms:
        force = force + term.pull(p, rate)
    return force


def inertia_at(structure: Structure, p: Parameters, travel: Expression) -> Expression:
    """Return the moving mass [kg] at a travel L [m]: the share and the soil that it carries along."""
    return p["mass"] + carried_mass(structure, p, travel) if structure.events else p["inertia"]


def lightest_mass(p: Parameters) -> Any:
    """Return the least moving mass [kg]: under events the share alone, as in a gap, otherwise the constant inertia."""
    return p["mass"] if "mass" in p else p["inertia"]


def carried_mass(structure: Structure, p: Parameters, travel: Expression) -> Expression:
    """Return the added mass of soil [kg] at a travel L [m], in a structure with events."""
    if not structure.carries:
        return 0.0
    entry = structure.find(Entry)
    return p["added_mass"] if entry is None else p["added_mass"] * entry.buried(p, travel) ** 3
