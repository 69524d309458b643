"""Linear elastic medium around a share that moves steadily below the shear wave speed: equations (1)-(4).

The thin wedge (plane strain) and the slender cone (axisymmetry) have closed forms for piecewise-linear profiles, which
accept floats, arrays or CasADi expressions. `plough_opt.soil.elastic.fourier` evaluates the Fourier integrals
themselves, for a profile of any shape.

Coordinates move with the body: its tip is at x = 0, and the medium streams towards +x. Tension is positive.
"""

from plough_opt.soil.elastic import fourier
from plough_opt.soil.elastic.cone import ConeDisplacement, ConeStress, cone_displacement, cone_pressure, cone_stress
from plough_opt.soil.elastic.medium import (
    knots,
    longitudinal_wave_speed,
    rayleigh_speed,
    shear_modulus,
    shear_wave_speed,
)
from plough_opt.soil.elastic.wedge import (
    WedgeGradient,
    WedgeStress,
    cone_force,
    wedge_displacement,
    wedge_force,
    wedge_gradient,
    wedge_pressure,
    wedge_stress,
)

__all__ = [
    "ConeDisplacement", "ConeStress", "WedgeGradient", "WedgeStress", "cone_displacement", "cone_force",
    "cone_pressure", "cone_stress", "fourier", "knots", "longitudinal_wave_speed", "rayleigh_speed",
    "shear_modulus", "shear_wave_speed", "wedge_displacement", "wedge_force", "wedge_gradient", "wedge_pressure",
    "wedge_stress",
]  # fmt: skip
