"""Effects of a scene, and their terms in the equation of motion."""

from plough_opt.motion.effects.damping import Damping
from plough_opt.motion.effects.effects import MOST_HARMONICS, Effects, HarmonicBalance
from plough_opt.motion.effects.entry import Entry
from plough_opt.motion.effects.inertial_drag import InertialDrag
from plough_opt.motion.effects.own import OWN_EFFECTS, Own, OwnResistance, RestingResistance, slopes
from plough_opt.motion.effects.rate_term import RateTerm
from plough_opt.motion.effects.smooth import Smooth, SmoothContact
from plough_opt.motion.effects.stick_slip import StickSlip, StickSlipContact
from plough_opt.motion.effects.strength_waves import StrengthWaves, wave_names
from plough_opt.motion.effects.term import Changed, Parameters, Place, Term, resisted
from plough_opt.motion.effects.tow_ramp import Strut, TowRamp, ramp_time

__all__ = [
    "MOST_HARMONICS", "OWN_EFFECTS", "TERMS", "Changed", "Damping", "Effects", "Entry", "HarmonicBalance", "Own",
    "OwnResistance", "Parameters", "Place", "RestingResistance", "Smooth", "SmoothContact", "StickSlip",
    "StickSlipContact", "StrengthWaves", "Strut", "Term", "TowRamp", "ramp_time", "resisted", "slopes", "wave_names",
]  # fmt: skip

TERMS: tuple[type[Term], ...] = (
    StrengthWaves, RateTerm, InertialDrag, Entry, SmoothContact, StickSlipContact, Own, TowRamp, Damping,
)  # fmt: skip
"""Classes of all terms, in the order in which the resistance is built up from them."""
