"""Scene: a share on its mount in the soil, with the effects that are simulated and no others."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

from plough_opt.core.checks import check_domain, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_symbolic, rms, sqrt
from plough_opt.core.labels import checked_in_designs, unlabelled
from plough_opt.core.quantities import read_fields
from plough_opt.laws.forces import PlasticGas
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction, without_pressure
from plough_opt.laws.registry import law_of
from plough_opt.motion.effects import Effects, Smooth
from plough_opt.soil.geometry import Cone, Wedge
from plough_opt.soil.random_strength import Sliding, Stationary, stationary_response
from plough_opt.soil.soil import Soil
from plough_opt.soil.waves import check_strength

# Overburden [Pa] of some 1.5 m of soil, below which no subsoiler works: more is the atmosphere's.
_DEEPEST = 20e3
# Standard deviations that a Gaussian motion exceeds in one of 370 moments.
_SURELY = 3.0

_Property = TypeVar("_Property")


def _checked_in_designs(law: Callable[[Scene], _Property]) -> Callable[[Scene], _Property]:
    """Decorate a scene's property, which a design checks with the scene."""
    return checked_in_designs(law, lambda scene: scene.check_reaction())


def _checked_stationary(law: Callable[[Scene], _Property]) -> Callable[[Scene], _Property]:
    """Decorate a property of the linearised motion, which a design checks with its numbers."""
    return checked_in_designs(law, lambda scene: scene._stationary)


@dataclass(frozen=True)
class Scene:
    """A share on an elastic mount, towed through soil.

    Args:
        soil: the soil.
        share: a `Wedge`, of which only the equivalent cone enters, or that `Cone` itself.
        stiffness: k0 of the mount [N/m], above 0.
        mass: m of all that moves but the soil [kg], above 0: frame part and share (`Cone.solid_mass`).
        tow_speed: V0 of the strut [m/s], at least 0.
        effects: what to simulate.
        medium: the law of resistance: a name in `plough_opt.laws.LAWS`, or a `ResistanceLaw` such as
            ``McKyesAli(depth=0.35)``. ``"plastic"``: the plastic gas; ``"elastic"``: the linear elastic medium, which
            gives the steady contact force on the equivalent cone (`po.elastic.cone_force`, an order of magnitude).
            What a law does not give is refused, as motion is by those of steady sliding only (the elastic medium, Swick
            and Perumpral), which take ``Effects(motion=False)``, or left out, as added mass, with a warning.

    Every number may be a float or a CasADi expression.

    Raises:
        DomainError: a number outside its domain.
        InputError: an unknown medium, an effect that has no meaning in it, or something else in the place of soil,
            share or effects.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> round(float(scene.cone.height), 3)
        0.25
    """

    soil: Soil
    share: Wedge | Cone
    stiffness: Expression
    mass: Expression
    tow_speed: Expression
    effects: Effects = field(default_factory=Effects)
    medium: str | ResistanceLaw = "plastic"

    def __post_init__(self) -> None:
        self._check_kinds()
        self._refuse_what_the_law_lacks()
        read_fields(self, **{name: f"scene.{name}" for name in ("stiffness", "mass", "tow_speed")})
        if self.effects.random_strength is not None:
            self.check_stationary()

    def _check_kinds(self) -> None:
        """Raise InputError if soil, share or effects has the wrong type."""
        for name, wanted, kinds in (
            ("soil", "a Soil, for instance named_soil('serozem')", Soil),
            ("share", "a Wedge or a Cone", Wedge | Cone),
            ("effects", "an Effects", Effects),
        ):
            if not isinstance(getattr(self, name), kinds):
                raise InputError(f"the scene's {name} = {shown(getattr(self, name))} must be {wanted}")

    def _refuse_what_the_law_lacks(self) -> None:
        """Refuse effects that have no meaning in the law of resistance."""
        effects = self.effects
        for name in ("motion", "strength_wave", "random_strength", "tow_ramp", "rate_term", "own", "entry"):
            if self.law.lacks(name) and getattr(effects, name) not in (None, False, ()):
                raise InputError(self.law.refusal(name))
        if effects.printed.errors and not isinstance(self.law, PlasticGas):
            raise InputError("the printed formulation belongs to the plastic gas: take medium = 'plastic' for it")

    @cached_property
    def law(self) -> ResistanceLaw:
        """The law of resistance: see ``medium``."""
        return law_of(self.medium)

    @cached_property
    def cone(self) -> Cone:
        """The share's equivalent cone."""
        if isinstance(self.share, Cone):
            return self.share
        with unlabelled():
            return self.share.equivalent_cone()

    @property
    @_checked_in_designs
    def reaction(self) -> SoilReaction:
        """F0 [N], Fd [N s^2/m^2] and added mass [kg], zero where the effect is off."""
        return self._reaction

    @cached_property
    def _reaction(self) -> SoilReaction:
        full = self._reaction_at(self._at)
        return SoilReaction(
            static=full.static,
            drag=full.drag if self.effects.inertial_drag else 0.0,
            added_mass=full.added_mass if self.effects.added_mass else 0.0,
        )

    def check_reaction(self) -> None:
        """Refuse a numeric scene outside the domain of its law of resistance, or a strength below 0 somewhere.

        Limits that a design keeps by requirements, such as the shear wave's speed, are left out.

        Raises:
            DomainError: such as a density profile with which there is no compaction front, or strength waves whose
                amplitudes exceed 1 in sum.
        """
        check_strength(self.effects.waves)
        with unlabelled():
            self.law.check(self._at)

    @property
    def _whole(self) -> ShareInSoil:
        """The share in its soil, under the soil's ambient pressure."""
        return ShareInSoil(self.share, self.cone, self.soil, self.tow_speed)

    @property
    def _at(self) -> ShareInSoil:
        """The share in its soil, without ambient pressure where the scene takes none."""
        return self._whole if self.effects.ambient_pressure else without_pressure(self._whole)

    def _reaction_at(self, at: ShareInSoil) -> SoilReaction:
        """Return the whole reaction of a soil to a share, in the scene's formulation."""
        with unlabelled():
            return self.effects.printed.reaction(self.law.reaction(at))

    @property
    @_checked_in_designs
    def carried_soil(self) -> Expression:
        """Mass of soil that the share carries along by the law of resistance [kg], also where that effect is off.

        Raises:
            InputError: the law of resistance says nothing of it.
        """
        if self.law.lacks("added_mass"):
            raise InputError(self.law.refusal("added_mass"))
        with unlabelled():
            return self.law.reaction(self._whole).added_mass

    @property
    @_checked_in_designs
    def loosened_radius(self) -> Expression:
        """Radius to which the soil is loosened at the share's base [m]; of the plastic gas that of the front, r*.

        Raises:
            InputError: the law of resistance gives none.
        """
        with unlabelled():
            return self.law.loosened_radius(self._whole)

    @property
    @_checked_in_designs
    def inertia(self) -> Expression:
        """M = m + m_a [kg]."""
        return self.mass + self.reaction.added_mass

    @property
    def restoring_stiffness(self) -> Expression:
        """Force of the spring on the share per deflection [N/m]: k0, or -k0 as equation (27) is printed."""
        return -self.stiffness if self.effects.printed.repelling_spring else self.stiffness

    @property
    @_checked_in_designs
    def steady_resistance(self) -> Expression:
        """Resistance F0 (1 + kappa V0^2) + Fd V0^2 [N] at the tow speed, without the strength wave."""
        rate = self.effects.rate_term if self.effects.rate_term is not None else 0.0
        own = sum(effect.force(0.0, self.tow_speed) for effect in self.effects.own)
        return self.reaction.static * (1.0 + rate * self.tow_speed**2) + self.reaction.drag * self.tow_speed**2 + own

    @property
    @_checked_stationary
    def stationary_force_rms(self) -> Expression:
        """RMS of the mount force about its mean [N], of the linearised motion under random strength and strength waves.

        Linearised about steady sliding, over a path without an end: see `plough_opt.soil.random_strength`. A share that
        follows the strut (``motion=False``) passes on all of the soil's fluctuation.

        Raises:
            InputError: strength that does not vary, a motion without damping of any kind or without speed, own
                resistances, two strength waves of one length, the elastic medium, or the print's repelling spring.
            DomainError: a response that is not finite.
        """
        return self._stationary.force_rms

    @property
    @_checked_stationary
    def stationary_displacement_rms(self) -> Expression:
        """RMS of the deflection about its mean [m], as `stationary_force_rms`."""
        return self._stationary.displacement_rms

    @cached_property
    def _stationary(self) -> Stationary:
        """The linearised response about steady sliding."""
        self.check_stationary()
        effects, speed = self.effects, self.tow_speed
        with unlabelled():
            static, drag, inertia = self.reaction.static, self.reaction.drag, self.inertia
        rate = effects.rate_term if effects.rate_term is not None else 0.0
        force, slope = static * (1.0 + rate * speed**2), 2.0 * speed * (drag + rate * static)
        if not effects.motion:
            variance = sum(wave.amplitude**2 / 2.0 for wave in effects.waves)
            if effects.random_strength is not None:
                variance = variance + effects.random_strength.variance
            return Stationary(force * rms(variance, 1.0), 0.0, 0.0)
        if isinstance(effects.contact, Smooth):
            # The smooth step multiplies all resistance, and has a slope of its own below its width.
            step, steepness = effects.contact.step(speed)
            force, slope = step * force, step * slope + steepness * (force + drag * speed**2)
        damper = effects.damping if effects.damping is not None else 0.0
        sliding = Sliding(force, self.stiffness, inertia, damper + slope, speed)
        found = stationary_response(sliding, damper, effects.waves, effects.random_strength)
        check_domain("stationary RMS of the mount force", found.force_rms, "N", why="there is hardly any damping")
        return found

    def check_stationary(self) -> None:
        """Refuse a scene without a linearised response about steady sliding.

        Raises:
            InputError: see `stationary_force_rms`.
        """
        effects, what = self.effects, "the stationary RMS"
        if self.law.lacks("motion"):
            raise InputError(f"{what} is of a motion: {self.law.refusal('motion')}")
        if not effects.waves and effects.random_strength is None:
            raise InputError(f"{what} needs strength that varies: give random_strength, or strength_wave")
        if not effects.motion:
            return
        if effects.own:
            raise InputError(f"{what} takes no own resistances, which are not linearised: leave them out, or simulate")
        if effects.printed.repelling_spring:
            raise InputError(f"{what} needs a spring that holds the share: take formulation = 'derived'")
        if not is_symbolic(self.tow_speed) and not float(as_number(self.tow_speed)) > 0.0:
            raise InputError(f"{what} needs a tow speed above 0: a share that stands meets no other soil")
        given = (effects.damping, effects.rate_term, 1.0 if effects.inertial_drag else 0.0)
        if not any(is_symbolic(part) or (part is not None and float(as_number(part)) > 0.0) for part in given):
            raise InputError(f"{what} needs damping of some kind: give damping or rate_term, or keep inertial_drag")
        lengths = [float(as_number(w.wavelength)) for w in effects.waves if not is_symbolic(w.wavelength)]
        if len({*lengths}) < len(lengths):
            raise InputError(f"{what} takes one strength wave of each length: join those that are alike")

    @property
    @_checked_in_designs
    def natural_frequency(self) -> Expression:
        """Undamped angular frequency sqrt(k0/M) [rad/s]; of the print's repelling spring the rate of growth."""
        return sqrt(self.stiffness / self.inertia)

    @property
    @_checked_in_designs
    def wave_frequency(self) -> Expression:
        """Angular frequency 2 pi V0/ell [rad/s] at which the first strength wave passes; 0 without a wave."""
        waves = self.effects.waves
        return 2.0 * math.pi * self.tow_speed / waves[0].wavelength if waves else 0.0

    @property
    def wave_period(self) -> Expression:
        """Time [s] in which a share passes one wavelength, or of several waves the length common to all.

        Raises:
            InputError: no wave, or several without a common length.
        """
        waves = self.effects.waves
        if not waves:
            raise InputError("the scene has no strength_wave, and so no period")
        return waves[0].wavelength * self.effects.turns[0] / self.tow_speed

    @property
    def branch(self) -> str:
        """Of a numeric scene "soft" or "stiff", its mount below or above resonance with the wave; else ""."""
        if not float(as_number(self.wave_frequency)) > 0.0:
            return ""
        return "soft" if float(as_number(self.natural_frequency / self.wave_frequency)) < 1.0 else "stiff"

    @property
    @_checked_in_designs
    def ambient_share(self) -> Expression:
        """Part of the static resistance F0 that the ambient pressure carries [-]; 0 where F0 is 0.

        It is 0 in a medium whose force is gauge, as the elastic one, where the pressure only keeps the contact.
        """
        if not self.effects.ambient_pressure or self.law.lacks("ambient_pressure"):
            return 0.0
        bare = self._reaction_at(without_pressure(self._at)).static
        total = self.reaction.static
        if not is_symbolic(total) and not float(as_number(total)) > 0.0:
            return 0.0
        return 1.0 - bare / total

    def describe(self) -> str:
        """Return, for a numeric scene, a clause that names it."""
        spring = " of a repelling spring, as printed," if self.effects.printed.repelling_spring else ""
        angle, height, stiffness, inertia, speed = (
            float(as_number(value))
            for value in (self.cone.half_angle, self.cone.height, self.stiffness, self.inertia, self.tow_speed)
        )
        return (
            f"share of half angle {math.degrees(angle):.3g} deg and height {height:.3g} m in {self.soil.name}, on"
            f" {stiffness / 1e3:.4g} kN/m{spring} with {inertia:.3g} kg at {speed:.3g} m/s"
        )

    def warnings(self) -> tuple[str, ...]:
        """Return, for a numeric scene, what a reader of its results must know about the theory's limits."""
        found = []
        if errors := self.effects.printed.errors:
            found.append(
                f"these are the source's equations as printed ({', '.join(errors)}), not physics: their results only"
                " show what the print's errors do; for all else take formulation = 'derived'"
            )
        found += self.law.warnings(self._whole)
        if self.effects.random_strength is not None:
            found.append("random strength counts in the stationary RMS, and not in a simulated motion")
            rate, speed = (float(as_number(x)) for x in (self._stationary.speed_rms, self.tow_speed))
            if _SURELY * rate > speed > 0.0:
                found.append(
                    f"under random strength the share's speed varies by {rate:.3g} m/s (RMS): three times that exceed"
                    f" the tow speed of {speed:.3g} m/s, so the share stops or retreats now and then, which the"
                    " linearised stationary RMS does not know"
                )
        share = float(as_number(self.ambient_share))
        if share > 0.0:
            pressure = float(as_number(self.soil.ambient_pressure))
            text = f"ambient pressure ({pressure / 1e3:.4g} kPa) carries {100 * share:.0f} % of the static draft"
            if pressure > _DEEPEST:
                text += (
                    "; soil with open pores would feel only the overburden, a few kPa: set soil.ambient_pressure for"
                    " that reading"
                )
            found.append(text)
        return tuple(found)
