"""plough_opt: design of subsoiler ploughshares by optimisation with exact derivatives.

SI units and radians throughout. Every physical function takes floats, NumPy arrays where that makes
sense, or CasADi expressions, and returns the like.
"""

from plough_opt import plastic
from plough_opt.accuracy import Accuracy
from plough_opt.errors import (
    DomainError,
    InfeasibleDesign,
    InputError,
    IntegrationError,
    NotConverged,
    PloughError,
)
from plough_opt.forces import (
    added_mass,
    loosened_radius,
    resistance,
    resistance_coefficients,
    soil_reaction,
)
from plough_opt.geometry import Cone, Wedge, deg
from plough_opt.motion import Run, simulate
from plough_opt.scene import Effects, Scene, StrengthWave
from plough_opt.soil import Soil, named_soil, soil_names

__all__ = [
    "Accuracy",
    "Cone",
    "DomainError",
    "Effects",
    "InfeasibleDesign",
    "InputError",
    "IntegrationError",
    "NotConverged",
    "PloughError",
    "Run",
    "Scene",
    "Soil",
    "StrengthWave",
    "Wedge",
    "added_mass",
    "deg",
    "loosened_radius",
    "named_soil",
    "plastic",
    "resistance",
    "resistance_coefficients",
    "simulate",
    "soil_names",
    "soil_reaction",
]
