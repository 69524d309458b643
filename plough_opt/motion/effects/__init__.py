"""Effects of a scene, and their terms in the equation of motion."""

from plough_opt.motion.effects.effects import Effects
from plough_opt.motion.effects.own import OWN_EFFECTS, Own, OwnResistance, RestingResistance, slopes
from plough_opt.motion.effects.profile import SpeedProfile, TowProfile, profile_of
from plough_opt.motion.effects.terms import (
    Damping,
    Entry,
    InertialDrag,
    RateTerm,
    Smooth,
    SmoothContact,
    SpeedTerm,
    StickSlip,
    StickSlipContact,
    StrengthWaves,
    Term,
    TowRamp,
    wave_names,
)

__all__ = [
    "OWN_EFFECTS", "TERMS", "Damping", "Effects", "Entry", "Own", "OwnResistance", "RestingResistance", "Smooth",
    "SmoothContact", "SpeedProfile", "StickSlip", "StickSlipContact",
    "StrengthWaves", "Term", "TowProfile", "TowRamp", "profile_of", "slopes", "wave_names",
]  # fmt: skip

TERMS: tuple[type[Term], ...] = (
    StrengthWaves, SpeedTerm, RateTerm, InertialDrag, Entry, SmoothContact, StickSlipContact, Own, TowRamp, TowProfile,
    Damping,
)  # fmt: skip
"""Classes of all terms, in the order in which the resistance is built up from them."""
