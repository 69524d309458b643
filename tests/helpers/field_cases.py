"""Bodies, soils and points for tests of the elastic field, and comparison of the toolkit with precise numbers.

An input is one flat tuple: x, y (or r), E, nu, density, speed, then the positions and half thicknesses of all nodes
except the first, which is (0, 0). Every number that a user gives can thus be varied, rounded or differentiated.
"""

import functools
import itertools
import math

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from helpers import high_precision as hp
from helpers import oracle
from helpers.equations import mp

EPS = 2.0**-52

BODIES = {
    "wedge": ((0.5,), (0.05,)),
    "diamond": ((0.25, 0.5), (0.025, 0.0)),
    "ogive": ((0.1, 0.3, 0.5), (0.03, 0.05, 0.055)),
    "tapered": ((0.2, 0.4, 0.7), (0.03, 0.04, 0.01)),
}
NU, RHO, SHEAR_WAVE = 0.3, 1600.0, 100.0
MU = RHO * SHEAR_WAVE**2
INPUTS = ("x", "y", "E", "nu", "density", "speed")


def inputs(x, y, body, speed_ratio=0.3, nu=NU):
    """Return the flat input for a point beside a body (positions, half thicknesses), the speed in units of c2."""
    positions, thicknesses = BODIES.get(body, body)
    modulus = 2.0 * MU * (1.0 + nu)
    return (x, y, modulus, nu, RHO, speed_ratio * SHEAR_WAVE, *positions, *thicknesses)


def nodes_of(values):
    count = (len(values) - len(INPUTS)) // 2
    rest = values[len(INPUTS) :]
    return [(0.0, 0.0), *zip(rest[:count], rest[count:], strict=True)]


def soil_of(values, **others):
    _, _, modulus, nu, density, *_ = values
    strength = {"density_ratio": 0.8, "cohesion": 15e3, "friction_angle": 0.5, "tool_friction": 0.3}
    given = strength | {"ambient_pressure": 0.0} | others
    return po.Soil(density=density, youngs_modulus=modulus, poisson_ratio=nu, **given)


def ground(speed_ratio=0.3, nu=NU, **others):
    """Return a soil and a speed."""
    values = inputs(0.0, 0.0, "wedge", speed_ratio, nu)
    return soil_of(values, **others), values[5]


def wedge(*values):
    """Return all results of the toolkit at a point beside a wedge, in the order of the oracle."""
    x, y, _, _, _, speed, *_ = values
    at = (x, y, nodes_of(values), soil_of(values), speed)
    stress, gradient = po.elastic.wedge_stress(*at), po.elastic.wedge_gradient(*at)
    return oracle.Wedge(**vars(stress), **vars(gradient), uy=po.elastic.wedge_displacement(*at))


def cone(*values):
    """Return all results of the toolkit at a point beside a cone, in the order of the oracle."""
    x, r, _, _, _, speed, *_ = values
    at = (x, r, nodes_of(values), soil_of(values), speed)
    return oracle.Cone(**vars(po.elastic.cone_displacement(*at)), **vars(po.elastic.cone_stress(*at)))


def slow(cases, *first):
    """Return cases that run with the slow tests only, each after the given arguments."""
    return [pytest.param(*first, case, marks=pytest.mark.slow) for case in cases]


def _pieces_of(field):
    def evaluate(*values):
        x, y, modulus, nu, density, speed, *_ = values
        medium = oracle.Medium(modulus, nu, density, speed)
        return [field(x, y, piece, medium) for piece in itertools.pairwise(nodes_of(values))]

    return evaluate


precise_wedge = _pieces_of(oracle.wedge)
precise_cone = _pieces_of(oracle.cone)
_AXIAL_STRESS, _RADIAL_STRESS = (oracle.Cone._fields.index(name) for name in ("xx", "rr"))


@functools.cache
def differentiated(field, symbol, size, chosen):
    """Return a Function from a flat input to all components, their gradients and Hessians in the chosen inputs."""
    values = symbol.sym("v", size)
    variables = [symbol.sym(f"v{i}") for i in chosen]
    entries = ca.vertsplit(values)
    for i, variable in zip(chosen, variables, strict=True):
        entries[i] = variable
    components = field(*entries)
    outputs = [ca.vertcat(*components)]
    for component in components:
        hessian, gradient = ca.hessian(component, ca.vertcat(*variables))
        outputs += [gradient, hessian]
    inner = ca.Function("inner", [values, *variables], outputs)

    def evaluate(point):
        found = [np.asarray(part) for part in inner(point, *[point[i] for i in chosen])]
        return found[0].ravel(), [part.ravel() for part in found[1::2]], found[2::2]

    return evaluate


@functools.cache
def precise(field, point, chosen=()):
    """Return components, gradients and Hessians in the chosen inputs, each with its size: precise arrays.

    The first index is that of value, gradient entries and Hessian entries, the second that of the component. The size
    is the sum over the straight pieces of their contributions and of the effect of a unit relative error in every
    input. If every step is accurate, the error is a small multiple of 1.1e-16 of the size. To find the effect, all
    inputs are changed at once by one part in 1e20, with several patterns of signs that distinguish any two inputs.

    Derivatives in the moduli can pass through zero, as those of strains at rest in E do. Their errors are relative to
    the differentiated quantity f, so f/E, and f for Poisson's ratio, are added to the size. For a cone f/r is added to
    derivatives in r, which near the axis are small differences of singular terms. The radial stress is as accurate as
    the axial stress, with which it shares the dilatation.
    """
    exact = [mp.mpf(value) for value in point]
    found = _tensors(field, exact, chosen)
    step = mp.mpf(10) ** -20
    change = 0
    for bit in range((len(exact) - 1).bit_length() + 1):
        moved = [value * (1 + (-1) ** (i >> bit) * step) for i, value in enumerate(exact)]
        change = np.maximum(change, np.abs(_tensors(field, moved, chosen) - found) / step)
    size = (np.abs(found) + change).sum(axis=0)
    n, unit_of = len(chosen), {2: exact[2], 3: mp.mpf(1)}
    if field is precise_cone:
        size[:, _RADIAL_STRESS] += size[:, _AXIAL_STRESS]
        unit_of[1] = exact[1]
    units = [(i, unit_of[which]) for i, which in enumerate(chosen) if which in unit_of]
    for i, unit in units:
        size[1 + i] += size[0] / unit
    gradient, hessian = size[1 : 1 + n], size[1 + n :].reshape(n, n, size.shape[1])
    for i, unit in units:
        hessian[i] += gradient / unit
        hessian[:, i] += gradient / unit
    return found.sum(axis=0), size


def _tensors(field, at, chosen):
    """Return values, gradients and Hessians of every piece in the chosen inputs."""

    def pieces(*moved):
        values = list(at)
        for i, value in zip(chosen, moved, strict=True):
            values[i] = value
        return np.array(field(*values), dtype=object)

    value, gradient, hessian = hp.derivatives(pieces, [at[i] for i in chosen])
    return np.stack([value, *gradient, *itertools.chain.from_iterable(hessian)], axis=1)


def assert_accurate(found, wanted, size, names, multiple):
    """Compare components, each to a multiple of 2.2e-16 of its size."""
    for name, f, w, s in zip(names, found, wanted, size, strict=True):
        assert math.isfinite(f), f"{name}: {f}"
        error = float(abs(mp.mpf(float(f)) - w) / (s * EPS)) if s else math.inf
        told = f"{name}: {float(f):.17g} instead of {mp.nstr(w, 20)}: {error:.3g} units of rounding"
        assert error <= multiple or f == s == 0, told


def assert_derivatives(found, wanted, size, names, multiple, compared=slice(None)):
    """Compare values, gradients and Hessians from `differentiated` with those from `precise`, entry by entry."""
    values, gradients, hessians = found
    for i, name in enumerate(names):
        entries = np.concatenate([[values[i]], gradients[i], hessians[i].ravel()])
        labels = np.array([f"{name}, entry {k}" for k in range(len(entries))])
        assert_accurate(entries[compared], wanted[compared, i], size[compared, i], labels[compared], multiple)
