"""Effects: the choice of effects in a scene, and checks of which exclude each other."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_choice, check_kind, check_switch, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_symbolic
from plough_opt.core.plain_data import ByName
from plough_opt.core.quantities import MOST_WAVES, read_fields
from plough_opt.laws.law import Formulation, Printed, errors_of
from plough_opt.motion.effects.own import OwnResistance, check_own
from plough_opt.motion.effects.profile import SpeedProfile
from plough_opt.motion.effects.terms import Smooth, StickSlip
from plough_opt.soil.strength import RandomStrength, Spectrum, StrengthWave, turns_of


@dataclass(frozen=True)
class Effects:
    """Choice of the effects in a scene. An effect that is off adds no node, state or parameter to the equation.

    Args:
        motion: integrate the equation of motion; False: quasi-static, the share follows the strut rigidly and the draft
            is the soil's resistance, without the force M s'' that a ramp would need.
        inertial_drag: include the resistance B rho0 L'^2.
        added_mass: include the soil that the share carries along, C rho0 h L''.
        ambient_pressure: include the soil's ambient pressure p_a in A; False sets p_a = 0.
        contact: ``"resisting"``: the resistance always points backwards, as printed in (27). It would also push a
            resting or retreating share, so a run in which that happens carries a warning. Under `Smooth` and
            `StickSlip` the soil never pushes.
        start: ``"equilibrium"``: at the steady deflection for the strut's initial speed; ``"rest"``: travel and
            speed of the share zero, spring relaxed; ``"towed"``: travel zero, spring relaxed, at the strut's speed.
        entry: the share enters the soil at travel 0. With the buried length H = min(max L, h), F0 and Fd grow as H^2
            and the added mass as H^3. Needs the start ``"rest"`` or ``"towed"``.
        strength_wave: periodic soil strength along the path: a wave, or a tuple of several whose sum multiplies F0 and
            must keep it at least 0; or None.
        random_strength: random soil strength along the path, as a `RandomStrength` or a tabulated `Spectrum`, or None.
            It enters stationary results such as `Scene.stationary_force_rms`, not the simulated motion.
        tow_ramp: time [s] in which the strut's speed rises from 0 by a C2 smoothstep; None or 0: full speed from the
            start. An expression with the value 0 means 1e-9 s, too short to matter, so that derivatives exist.
        tow_profile: speed of the strut over time relative to the tow speed, or None. ``simulate(..., tow_speed=...)``
            makes it of a table. Laws of resistance are evaluated at the tow speed itself.
        damping: viscous damper c in the mount [N s/m], or None.
        speed_term: lambda [s/m] of F0 (1 + lambda L'), for calibration, or None. Not in the source: blades and chisels
            were measured to grow linearly with speed (Onwualu and Watts 1998; Al-Neama and Herlitzius 2016).
        rate_term: kappa [s^2/m^2] of F0 (1 + kappa L'^2), for calibration, or None. Not in the source. Together with a
            speed term the two factors multiply.
        own: resistances of the user's own classes, added to that of the soil: see `OwnResistance`.
        orbit: ``"transient"``: motion from the start over the duration; ``"periodic"``: one wavelength of the periodic
            orbit under the strength wave, without a duration.
        formulation: ``"derived"``; ``"printed"``: equations (25)-(27) with the errors of the print, to show their
            effect; or a `Printed` with some of them. Printed equations are not physics, and a run warns of it.

    Raises:
        InputError: an unknown choice, or effects that exclude each other; the message says why.
        DomainError: a value outside its domain.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(damping="400 N*s/m", strength_wave=po.StrengthWave(0.3, "20 cm")).damping
        400.0
    """

    motion: bool = True
    inertial_drag: bool = True
    added_mass: bool = True
    ambient_pressure: bool = True
    contact: Literal["resisting"] | Annotated[Smooth | StickSlip, ByName()] = "resisting"
    start: Literal["equilibrium", "rest", "towed"] = "equilibrium"
    entry: bool = False
    strength_wave: StrengthWave | tuple[StrengthWave, ...] | None = None
    random_strength: Annotated[RandomStrength | Spectrum, ByName()] | None = None
    tow_ramp: Expression | None = None
    tow_profile: SpeedProfile | None = None
    damping: Expression | None = None
    speed_term: Expression | None = None
    rate_term: Expression | None = None
    own: tuple[Annotated[OwnResistance, ByName()], ...] = ()
    orbit: Literal["transient", "periodic"] = "transient"
    formulation: Formulation = "derived"

    def __post_init__(self) -> None:
        for name in ("motion", "inertial_drag", "added_mass", "ambient_pressure", "entry"):
            check_switch(name, getattr(self, name))
            object.__setattr__(self, name, bool(getattr(self, name)))
        if not isinstance(self.contact, Smooth | StickSlip):
            check_choice("contact", self.contact, ("resisting",), ", Smooth(width) or StickSlip(breakaway)")
        check_choice("orbit", self.orbit, ("transient", "periodic"))
        check_choice("start", self.start, ("equilibrium", "rest", "towed"))
        check_kind("tow_profile", self.tow_profile, SpeedProfile | None, "None or a SpeedProfile")
        wanted = "None, a RandomStrength such as RandomStrength(rms=0.2, correlation_length=0.3), or a Spectrum"
        check_kind("random_strength", self.random_strength, RandomStrength | Spectrum | None, wanted)
        if self.strength_wave == () or not all(isinstance(wave, StrengthWave) for wave in self.waves):
            raise InputError(
                f"strength_wave = {shown(self.strength_wave)} must be None or a StrengthWave, such as"
                " StrengthWave(amplitude=0.3, wavelength=0.2), or a tuple of several"
            )
        if len(self.waves) > MOST_WAVES:
            raise InputError(f"strength_wave has {len(self.waves)} waves: give at most the {MOST_WAVES} largest")
        read_fields(self, **{name: f"effects.{name}" for name in ("tow_ramp", "damping", "speed_term", "rate_term")})
        check_own(self.own, resting=isinstance(self.contact, StickSlip))
        for why, excluded in self._exclusions().items():
            if excluded:
                raise InputError(why)
        # Templates of scenes have SX as placeholders of numbers; no orbit takes SX, as `integrators.embed` says.
        if self.orbit != "transient" and not any(isinstance(wave.wavelength, ca.SX) for wave in self.waves):
            turns_of(self.waves)  # refuses waves without a common length

    def _exclusions(self) -> dict[str, bool]:
        """Return the reasons for which effects exclude each other, and whether these do."""
        still, orbit, varies = not self.motion, self.orbit != "transient", self.tow_profile is not None
        started, contact = self.start != "equilibrium", self.contact != "resisting"
        repels, ramp = self.printed.repelling_spring, self.tow_ramp is not None
        return {
            "entry begins at first contact, before any steady state: use start = 'rest' or 'towed'":
                self.entry and not started,
            "the print has no contact law: use contact = 'resisting' with its repelling spring": repels and contact,
            f"start = '{self.start}' needs motion: a quasi-static share follows the strut from the start":
                still and started,
            "damping needs motion: in a quasi-static scene the mount never moves, so omit it":
                still and self.damping is not None,
            "a contact law needs motion: a quasi-static share never stops or retreats": still and contact,
            "the print's repelling spring needs motion, for a repelled share never follows the strut:"
            " use formulation = 'derived'": still and repels,
            "an orbit needs motion: a quasi-static share repeats itself from the start": orbit and still,
            "an orbit needs a strength_wave: without one the share ends up sliding steadily": orbit and not self.waves,
            "an orbit under several strength waves cannot have own resistances: simulate from a start":
                orbit and len(self.waves) > 1 and bool(self.own),
            "an orbit needs contact = 'resisting': simulate other contacts from a start until settled":
                orbit and contact,
            "an orbit has no start: omit start, tow_ramp and entry": orbit and (started or ramp or self.entry),
            "the print's repelling spring has no periodic orbit: use formulation = 'derived'": orbit and repels,
            "a tow speed that varies has no periodic orbit: leave orbit out, or use a constant speed": varies and orbit,
            "tow_ramp and a varying tow speed both prescribe the strut's motion: leave one out": varies and ramp,
            "the events of StickSlip and entry are located at constant tow speed or with tow_ramp only: use"
            " Smooth(width) without entry, or integrate scene.equation(controls=('tow_speed',)) with its events":
                varies and self.events,
            "random strength has stationary results at a constant tow speed only: leave one of them out":
                varies and self.random_strength is not None,
        }  # fmt: skip

    @property
    def waves(self) -> tuple[StrengthWave, ...]:
        """The strength waves: none, one or several."""
        if self.strength_wave is None:
            return ()
        return self.strength_wave if isinstance(self.strength_wave, tuple) else (self.strength_wave,)

    @property
    def turns(self) -> tuple[int, ...]:
        """Number of periods of each strength wave in the period common to all: see `turns_of`."""
        return turns_of(self.waves)

    @cached_property
    def printed(self) -> Printed:
        """Errors of the print that the formulation keeps; none unless it says so."""
        return errors_of(self.formulation)

    @property
    def events(self) -> bool:
        """Whether the motion has events that an integrator must locate: stick and slip, or the end of entry."""
        return self.entry or isinstance(self.contact, StickSlip)

    @property
    def ramps(self) -> bool:
        """Whether the strut's speed ramps up. A ramp of zero duration does not count."""
        return self.tow_ramp is not None and (is_symbolic(self.tow_ramp) or bool(np.any(as_number(self.tow_ramp) > 0)))

    @property
    def accelerates(self) -> bool:
        """Whether the strut's speed varies."""
        return self.ramps or self.tow_profile is not None
