"""Scene: a share on its mount in the soil, the effects to simulate, and its quantities by name."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, TypeVar

from plough_opt.core.checks import (
    DomainLimit,
    check_domain,
    check_kind,
    checked_in_designs,
    declared,
    limits_of_law,
    recorded_limits,
    unlabelled,
)
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, as_number, is_symbolic, kept, rms, sqrt
from plough_opt.core.plain_data import ByName
from plough_opt.core.quantities import BESIDE, QUANTITIES, read_fields
from plough_opt.laws import law_of
from plough_opt.laws.forces import PlasticGas
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction, without_pressure
from plough_opt.motion.driven import MotionEquation, driven_equation, symbols_of
from plough_opt.motion.effects import Effects, Smooth
from plough_opt.motion.equation import Structure, check_strength, parameters
from plough_opt.soil.geometry import Cone, Wedge
from plough_opt.soil.soil import Soil
from plough_opt.soil.strength import PASS, Sliding, Stationary, rare_peak, stationary_response

_Property = TypeVar("_Property")


def _checked_in_designs(law: Callable[[Scene], _Property]) -> Callable[[Scene], _Property]:
    """Decorate a property of `Scene`; designs check it by `Scene.check_bounds`."""
    return checked_in_designs(law, lambda scene: scene.check_bounds())


def _checked_stationary(law: Callable[[Scene], _Property]) -> Callable[[Scene], _Property]:
    """Decorate a property of the linearised motion; designs check it by computing that motion."""
    return checked_in_designs(law, lambda scene: scene._stationary)


@dataclass(frozen=True)
class Scene:
    """A share on an elastic mount, towed through soil.

    Args:
        soil: the soil.
        share: a `Wedge`, which enters by its equivalent cone only, or a `Cone`.
        stiffness: k0 of the mount [N/m], above 0.
        mass: moving mass m without soil [kg], above 0: the moving part of the frame and the share (`Cone.solid_mass`).
        tow_speed: V0 of the strut [m/s], at least 0.
        effects: the effects to simulate.
        medium: law of resistance: a name in `plough_opt.laws.LAWS`, or a `ResistanceLaw` such as
            ``McKyesAli(depth=0.35)``. ``"plastic"``: the plastic gas; ``"elastic"``: the linear elastic medium, which
            gives the steady contact force on the equivalent cone (`po.elastic.cone_force`, an order of magnitude).
            Not every law covers every effect. Laws of steady sliding (the elastic medium, Swick and Perumpral) refuse
            motion and need ``Effects(motion=False)``. A law without added mass omits it with a warning.

    Every number may be a float or a CasADi expression.

    Raises:
        DomainError: a number outside its domain.
        InputError: an unknown medium, an effect that the medium does not cover, or a soil, share or effects of the
            wrong type.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> round(float(scene.cone.height), 3)
        0.25
    """

    soil: Soil
    share: Annotated[Wedge | Cone, ByName()]
    stiffness: Expression
    mass: Expression
    tow_speed: Expression
    effects: Effects = field(default_factory=Effects)
    medium: str | Annotated[ResistanceLaw, ByName()] = "plastic"

    def __post_init__(self) -> None:
        check_kind("the scene's soil", self.soil, Soil, "a Soil, for instance named_soil('serozem')")
        check_kind("the scene's share", self.share, Wedge | Cone, "a Wedge or a Cone")
        check_kind("the scene's effects", self.effects, Effects, "an Effects")
        effects, by_speed = self.effects, ("speed_term", "rate_term")
        for name in ("motion", "strength_wave", "random_strength", "tow_ramp", *by_speed, "own", "entry"):
            if self.law.lacks(name) and getattr(effects, name) not in (None, False, ()):
                raise InputError(self.law.refusal(name))
        if effects.printed.errors and not isinstance(self.law, PlasticGas):
            raise InputError("the printed formulation is one of the plastic gas: use medium = 'plastic' with it")
        read_fields(self, **{name: f"scene.{name}" for name in ("stiffness", "mass", "tow_speed")})
        if effects.random_strength is not None:
            self.check_stationary()

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, without what follows from them."""
        return {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}

    @cached_property
    def law(self) -> ResistanceLaw:
        """Law of resistance that ``medium`` names."""
        return law_of(self.medium)

    @cached_property
    def cone(self) -> Cone:
        """Equivalent cone of the share."""
        if isinstance(self.share, Cone):
            return self.share
        with unlabelled():
            return self.share.equivalent_cone()

    @property
    @_checked_in_designs
    @kept
    def reaction(self) -> SoilReaction:
        """F0 [N], Fd [N s^2/m^2] and added mass [kg]; Fd and the added mass are zero if their effect is off."""
        full = self._reaction_at(self._at)
        drag = full.drag if self.effects.inertial_drag else 0.0
        return SoilReaction(full.static, drag, full.added_mass if self.effects.added_mass else 0.0)

    def limits(self) -> tuple[tuple[DomainLimit, Any], ...]:
        """Return the limits that the law of resistance declares, each with the value that must keep it.

        A limit has the attributes ``name``, ``unit``, ``above``, ``below``, ``at_least``, ``at_most`` and ``why``. A
        design keeps the limits of its scenes.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, 5e4, 30.0, 2.0, medium="asabe_d497")
            >>> [(limit.name, value) for limit, value in scene.limits()][0]
            ('ASABE D497: working depth', 0.25)
        """
        with recorded_limits() as record:
            self._by_law(self._at)
        return tuple(declared(record))

    def check_reaction(self) -> None:
        """Raise DomainError if a numeric scene lies outside the domain of its law of resistance.

        Raises:
            DomainError: for instance a density profile without a compaction front, or strength waves whose amplitudes
                add up to more than 1.
            InputError: by a law of the user.

        Example:
            >>> import plough_opt as po
            >>> waves = (po.StrengthWave(0.6, "0.2 m"), po.StrengthWave(0.6, "0.5 m"))
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, 5e4, 30.0, 2.0, po.Effects(strength_wave=waves))
            >>> try:
            ...     scene.check_reaction()
            ... except po.DomainError as error:
            ...     print(str(error).partition(" if ")[0])
            the sum of the strength waves' amplitudes is 1.2 and must be at most 1
        """
        check_strength(self.effects.waves)
        self._reaction_at(self._at)

    def check_bounds(self) -> None:
        """Raise DomainError if a numeric scene at the bounds of a design has a domain that the design does not keep.

        A design keeps the limits of laws by requirements, and skips designs for which a law is undefined.

        Raises:
            DomainError: as `check_reaction`.
        """
        check_strength(self.effects.waves)
        if self.soil.density_profile is not None:
            self._reaction_at(self._at)

    @property
    def _under_pressure(self) -> ShareInSoil:
        """The share in its soil under ambient pressure, whether or not that effect is on."""
        return ShareInSoil(self.share, self.cone, self.soil, self.tow_speed)

    @property
    def _at(self) -> ShareInSoil:
        """The share in its soil, without ambient pressure if that effect is off."""
        return self._under_pressure if self.effects.ambient_pressure else without_pressure(self._under_pressure)

    def _reaction_at(self, at: ShareInSoil) -> SoilReaction:
        """Return the reaction of the soil in the scene's formulation, with every part that the law gives."""
        return self.effects.printed.reaction(self._by_law(at))

    def _by_law(self, at: ShareInSoil) -> SoilReaction:
        """Return the reaction by the law of resistance; raise DomainError for numbers that are not finite."""
        with unlabelled():
            found = limits_of_law(self.law.label, self.law.reaction)(at)
        why = self.law.without_value("finite value")
        check_domain("static resistance", found.static, "N", why=why)
        check_domain("coefficient of the squared speed", found.drag, "N*s^2/m^2", why=why)
        check_domain("added mass", found.added_mass, "kg", why=why)
        return found

    @property
    @_checked_in_designs
    def carried_soil(self) -> Expression:
        """Mass of soil that the share carries along [kg], by the law of resistance, even if that effect is off.

        Raises:
            InputError: the law of resistance does not give it.
        """
        if self.law.lacks("added_mass"):
            raise InputError(self.law.refusal("added_mass"))
        return self._by_law(self._under_pressure).added_mass

    @property
    @_checked_in_designs
    def loosened_radius(self) -> Expression:
        """Radius to which the soil is loosened at the share's base [m]; r* of the front for the plastic gas.

        Raises:
            InputError: the law of resistance does not give it.
        """
        return self.law.loosened_radius(self._under_pressure)

    @property
    @_checked_in_designs
    def inertia(self) -> Expression:
        """M = m + m_a [kg]."""
        return self.mass + self.reaction.added_mass

    @property
    def restoring_stiffness(self) -> Expression:
        """Force of the spring on the share per unit of deflection [N/m]: k0, or -k0 as equation (27) is printed."""
        return -self.stiffness if self.effects.printed.repelling_spring else self.stiffness

    @property
    @_checked_in_designs
    @kept
    def steady_resistance(self) -> Expression:
        """Resistance [N] by all effects of a share that slides at the tow speed, without the strength wave."""
        return Structure.of(self).steady_resistance(parameters(self), self.tow_speed)

    @property
    @_checked_stationary
    def stationary_force_rms(self) -> Expression:
        """RMS of the mount force about its mean [N] under random strength and strength waves, by linearised motion.

        The motion is linearised about steady sliding along an infinite path: see `plough_opt.soil.strength`. A
        share that follows the strut rigidly (``motion=False``) transmits the whole fluctuation of the soil.

        Raises:
            InputError: constant strength, motion without damping or without speed, own resistances, two strength waves
                of the same length, the elastic medium, or the print's repelling spring.
            DomainError: the response is not finite.
        """
        return self._stationary.force_rms

    @property
    @_checked_stationary
    def stationary_displacement_rms(self) -> Expression:
        """RMS of the deflection about its mean [m]: see `stationary_force_rms`."""
        return self._stationary.displacement_rms

    @property
    @_checked_stationary
    def stationary_peak_force(self) -> Expression:
        """Mount force [N] that at most 5 % of the passes of 1 km exceed: see `plough_opt.soil.strength`.

        The motion is that of `stationary_force_rms`, about the resistance of steady sliding, and strength is Gaussian.

        Raises:
            InputError, DomainError: as `stationary_force_rms`; and for a share that follows the strut rigidly
                (``motion=False``), to which random strength has no finite rate of change.
        """
        found = self._moving
        return self.steady_resistance + rare_peak(found.force_rms, found.force_rate_rms, PASS / self.tow_speed)

    @property
    @_checked_stationary
    def stationary_peak_deflection(self) -> Expression:
        """Deflection [m] that at most 5 % of the passes of 1 km exceed: see `stationary_peak_force`."""
        found = self._moving
        peak = rare_peak(found.displacement_rms, found.speed_rms, PASS / self.tow_speed)
        return self.steady_resistance / self.stiffness + peak

    @property
    def _moving(self) -> Stationary:
        if not self.effects.motion:
            raise InputError("a peak under random strength needs a mount that moves: give motion = true")
        return self._stationary

    @cached_property
    def _stationary(self) -> Stationary:
        """Linearised response about steady sliding."""
        self.check_stationary()
        effects, speed = self.effects, self.tow_speed
        static, drag, inertia = self.reaction.static, self.reaction.drag, self.inertia
        linear, rate = (0.0 if term is None else term for term in (effects.speed_term, effects.rate_term))
        by_speed, by_square = 1.0 + linear * speed, 1.0 + rate * speed**2
        force = static * by_speed * by_square
        slope = static * (linear * by_square + by_speed * 2.0 * rate * speed) + 2.0 * speed * drag
        if not effects.motion:
            variance = sum(wave.amplitude**2 / 2.0 for wave in effects.waves)
            if effects.random_strength is not None:
                variance = variance + effects.random_strength.variance
            return Stationary(force * rms(variance, 1.0), 0.0, 0.0, 0.0)
        if isinstance(effects.contact, Smooth):
            # The smooth step multiplies all resistance, and below its width its slope adds to that of the resistance.
            step, steepness = effects.contact.step(speed)
            force, slope = step * force, step * slope + steepness * (force + drag * speed**2)
        damper = effects.damping if effects.damping is not None else 0.0
        sliding = Sliding(force, self.stiffness, inertia, damper + slope, speed)
        found = stationary_response(sliding, damper, effects.waves, effects.random_strength)
        check_domain("stationary RMS of the mount force", found.force_rms, "N", why="there is hardly any damping")
        return found

    def check_stationary(self) -> None:
        """Raise InputError if the scene has no linearised response about steady sliding.

        Raises:
            InputError: see `stationary_force_rms`.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, 5e4, 30.0, 2.0)
            >>> try:
            ...     scene.check_stationary()
            ... except po.InputError as error:
            ...     print(str(error).partition(":")[0])
            the stationary RMS needs strength that varies
        """
        effects, what = self.effects, "the stationary RMS"
        if self.law.lacks("motion"):
            why = self.law.lacking["motion"]
            raise InputError(f"{what} has no meaning in {self.law.label}, which {why}: use medium = 'plastic'")
        if not effects.waves and effects.random_strength is None:
            raise InputError(f"{what} needs strength that varies: give random_strength or strength_wave")
        if not effects.motion:
            return
        if effects.own:
            raise InputError(f"{what} cannot include own resistances, which are not linearised: omit them, or simulate")
        if effects.printed.repelling_spring:
            raise InputError(f"{what} needs a spring that holds the share: use formulation = 'derived'")
        if not is_symbolic(self.tow_speed) and not float(as_number(self.tow_speed)) > 0.0:
            raise InputError(f"{what} needs a tow speed above 0: a standing share stays in the same soil")
        given = (effects.damping, effects.speed_term, effects.rate_term, 1.0 if effects.inertial_drag else 0.0)
        if not any(is_symbolic(part) or (part is not None and float(as_number(part)) > 0.0) for part in given):
            raise InputError(f"{what} needs some damping: give damping, speed_term or rate_term, or keep inertial_drag")
        lengths = [float(as_number(w.wavelength)) for w in effects.waves if not is_symbolic(w.wavelength)]
        if len({*lengths}) < len(lengths):
            raise InputError(f"{what} needs strength waves of different lengths: merge those of equal length")

    @property
    @_checked_in_designs
    def natural_frequency(self) -> Expression:
        """Undamped angular frequency sqrt(k0/M) [rad/s]; the rate of growth under the print's repelling spring."""
        return sqrt(self.stiffness / self.inertia)

    @property
    @_checked_in_designs
    def wave_frequency(self) -> Expression:
        """Angular frequency 2 pi V0/ell [rad/s] of the first strength wave at the tow speed; 0 without a wave."""
        waves = self.effects.waves
        return 2.0 * math.pi * self.tow_speed / waves[0].wavelength if waves else 0.0

    @property
    def wave_period(self) -> Expression:
        """Time [s] in which a share passes one wavelength, or the common length of several waves.

        Raises:
            InputError: there is no wave, or several waves have no common length.
            DomainError: the tow speed is not above 0.
        """
        waves = self.effects.waves
        if not waves:
            raise InputError("the scene has no strength_wave and therefore no period")
        check_domain("tow speed", self.tow_speed, "m/s", above=0.0, why="a standing share has no orbit")
        return waves[0].wavelength * self.effects.turns[0] / self.tow_speed

    @property
    def branch(self) -> str:
        """Whether a numeric scene's natural frequency is below ("soft") or above ("stiff") the wave's; else ""."""
        if not float(as_number(self.wave_frequency)) > 0.0:
            return ""
        return "soft" if float(as_number(self.natural_frequency / self.wave_frequency)) < 1.0 else "stiff"

    @property
    @_checked_in_designs
    def ambient_share(self) -> Expression:
        """Fraction of the static resistance F0 caused by the ambient pressure [-]; 0 if F0 is 0.

        It is also 0 for a law that gives the force above ambient pressure, such as the elastic medium: there the
        pressure only keeps soil and share in contact.
        """
        if not self.effects.ambient_pressure or self.law.lacks("ambient_pressure"):
            return 0.0
        bare = self._reaction_at(without_pressure(self._at)).static
        total = self.reaction.static
        if not is_symbolic(total) and not float(as_number(total)) > 0.0:
            return 0.0
        return 1.0 - bare / total

    def equation(self, *, controls: Sequence[str] = (), parameters: Sequence[str] = ()) -> MotionEquation:
        """Return the equation of motion as CasADi Functions, for an integrator or an optimiser of one's own.

        Args:
            controls: quantities that change during the motion: "tow_speed" of the strut [m/s], "stiffness" [N/m] or
                "damping" [N s/m] of an active mount. They enter as they are at each moment, and may jump. The law of
                resistance and the orders of magnitude are those at the scene's own tow speed.
            parameters: names of quantities as in problem files, such as "soil.cohesion", that are arguments of the
                Functions. All others have the scene's values.

        Returns:
            See `MotionEquation`. Its domain is that of the scene; the Functions check nothing.

        Raises:
            InputError: a name is unknown, given twice or not in the scene; a quantity cannot be a control; the scene
                holds symbols, is quasi-static or has an orbit; or a tow ramp and a control prescribe the strut's speed.

        Example:
            >>> import plough_opt as po
            >>> scene = po.Scene(po.named_soil("serozem"), po.Cone("10 deg", "25 cm"), "50 kN/m", "30 kg", "2 m/s")
            >>> scene.equation(controls=("tow_speed", "stiffness")).controls
            array([2.e+00, 5.e+04])
        """
        symbols = symbols_of(self, controls, parameters)
        values = [quantity_of(self, name) for name in symbols]
        return driven_equation(self, with_quantities(self, symbols), symbols, values, controls)

    def describe(self) -> str:
        """Return a noun phrase that identifies a numeric scene in messages.

        Example:
            >>> import plough_opt as po
            >>> po.read_problem("problems/cotton_subsoiler.toml").scene().describe()
            'share of half angle 8.93 deg and height 0.25 m in serozem, on 50 kN/m with 23.3 kg at 2 m/s'
        """
        at = "at" if self.effects.tow_profile is None else "at up to"
        spring = " of a repelling spring, as printed," if self.effects.printed.repelling_spring else ""
        given = (self.cone.half_angle, self.cone.height, self.stiffness, self.inertia, self.tow_speed)
        angle, height, stiffness, inertia, speed = (float(as_number(value)) for value in given)
        return (
            f"share of half angle {math.degrees(angle):.3g} deg and height {height:.3g} m in {self.soil.name}, on"
            f" {stiffness / 1e3:.4g} kN/m{spring} with {inertia:.3g} kg {at} {speed:.3g} m/s"
        )

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about the limits of the theory that affect the results of a numeric scene.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> scene.warnings()[0].partition(" (")[0]
            'ambient pressure'
        """
        found = []
        if errors := self.effects.printed.errors:
            found.append(
                f"these are the source's equations as printed ({', '.join(errors)}), not physics: the results only"
                " show the effect of the printing errors; otherwise use formulation = 'derived'"
            )
        found += self.law.warnings(self._under_pressure)
        if self.effects.random_strength is not None:
            found.append("random strength enters the stationary RMS only, not the simulated motion")
            rate, speed = (float(as_number(x)) for x in (self._stationary.speed_rms, self.tow_speed))
            # A Gaussian variable exceeds this many standard deviations for 0.3 % of the time.
            if 3.0 * rate > speed > 0.0:
                found.append(
                    f"under random strength the share's speed varies by {rate:.3g} m/s (RMS): three times that exceeds"
                    f" the tow speed of {speed:.3g} m/s, so the share sometimes stops or retreats, which the"
                    " linearised stationary RMS ignores"
                )
        share = float(as_number(self.ambient_share))
        if share > 0.0:
            pressure = float(as_number(self.soil.ambient_pressure))
            text = f"ambient pressure ({pressure / 1e3:.4g} kPa) carries {100 * share:.0f} % of the static draft"
            # Overburden [Pa] at a depth of about 1.5 m, deeper than any subsoiler works. Higher pressure includes the
            # atmosphere's.
            if pressure > 20e3:
                text += (
                    "; soil with open pores would feel only the overburden, a few kPa: set soil.ambient_pressure if"
                    " the pores are open"
                )
            found.append(text)
        return tuple(found)


def quantity_of(scene: Scene, name: str) -> Expression:
    """Return a scene's quantity by name.

    Raises:
        InputError: the name is unknown, or the scene does not have the quantity.
    """
    if name not in QUANTITIES:
        raise InputError(f"a scene has no quantity '{name}': {nearest(name, QUANTITIES)}")
    value: Expression | None = _at(scene, QUANTITIES[name].path)
    if value is None:
        raise InputError(f"the scene has no '{name}': add it to the scene, or omit the name")
    return value


def quantities_of(scene: Scene) -> dict[str, Expression | None]:
    """Return all quantities by name; those that the scene does not have are None."""
    return {name: _at(scene, quantity.path) for name, quantity in QUANTITIES.items()}


def _at(value: Any, path: tuple[str | int, ...]) -> Any:
    for step in path:
        if isinstance(step, int):  # a single wave is not in a tuple, several are
            several = value if isinstance(value, tuple) else (value,)
            value = several[step] if step < len(several) else None
        else:
            value = getattr(value, step, None)
    return value


def with_quantities(scene: Scene, changes: Mapping[str, Expression]) -> Scene:
    """Return a copy of a scene in which some quantities, by name, have new values: numbers or expressions.

    Raises:
        InputError: a name is unknown, or the scene does not have the quantity.
        DomainError: a number outside the model's domain.
    """
    for name, value in changes.items():
        quantity_of(scene, name)
        scene = _replaced(scene, QUANTITIES[name].path, value)
    return scene


def _replaced(value: Any, path: tuple[str | int, ...], new: Expression) -> Any:
    if not path:
        return new
    step, rest = path[0], path[1:]
    if isinstance(step, int):
        if not isinstance(value, tuple):
            return _replaced(value, rest, new)
        return (*value[:step], _replaced(value[step], rest, new), *value[step + 1 :])
    return dataclasses.replace(value, **{step: _replaced(getattr(value, step), rest, new)})


def duration_of(scene: Scene, duration: Any, stacklevel: int = 2) -> Expression:
    """Return the simulated time [s], for an orbit its period.

    Args:
        scene: the scene.
        duration: time as a number, a text or an expression, or None.
        stacklevel: stack level of a warning of an implausible number, 2 for the caller's line.

    Raises:
        InputError: the duration is missing, or given for an orbit.
        DomainError: it is not above 0.
    """
    if scene.effects.orbit != "transient":
        if duration is not None:
            raise InputError("a periodic orbit lasts one wavelength of the soil's strength: omit the duration")
        return scene.wave_period
    if duration is None:
        raise InputError("the duration is missing: give the time to simulate, in seconds")
    return BESIDE["scene.duration"].read(duration, stacklevel=stacklevel + 1)
