"""Certificate of the optimum of `subsoiler_frame`, and comparison with brute force in NumPy alone.

Brute force takes no derivative and no integrator of the toolkit: it follows (27) by Runge and Kutta's fourth order
until the oscillation lasts, for many designs side by side, and evolves a population of designs. Of the nine variables
three follow from the others, because a limit holds exactly where only cost grows beyond it: the height that just
loosens the whole width, the tube that just bears its load, the slip that just pulls.
"""

from collections.abc import Iterable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, nnls
from subsoiler_frame import GRAVITY, STRENGTH, TRACTOR, VARIABLES, WAVE, machine, solved, traction

import plough_opt as po

Array = NDArray[np.float64]
FREE = ("wedge angle", "spacing", "stiffness", "speed", "bracket", "ballast")
# Tolerances of limits: rounding for a limit that is met, the optimiser's tolerance for an active limit.
_ROUNDING, _ACTIVE = 1e-9, 1e-7


def check(c: SimpleNamespace, m: SimpleNamespace, best: po.Optimum) -> None:
    """Print the residuals of the optimality conditions, and the best design of brute force."""
    n, fuel = len(m.scenes), best(m.fuel)
    stationary = kkt_residual(c, m, best)
    at_best = evaluate(np.array([[best.variables[name]] for name in FREE]), n)
    print("certificate")
    print(f"  least margin of a requirement, over its limit: {least_margin(m, best):.1e}")
    print(f"  part of the fuel's gradient that no limit balances: {stationary:.1e}")
    print(
        f"  optimiser's fuel against a tight integration: {best.gap:.1e}; by a second method {best.error_estimate:.1e}"
    )
    print(f"  the same design in NumPy alone: fuel differs by {at_best.fuel[0] / fuel - 1.0:.1e}")
    found, designs = brute_force(n)
    more = 100.0 * (found.fuel / fuel - 1.0)
    print(f"brute force: of {designs} designs the best that meets all limits takes {more:+.4f} % more fuel")
    for name in VARIABLES:
        print(f"  {name:12s} {best.variables[name]:11.5g} {found.variables[name]:11.5g} {VARIABLES[name][3]}")


def least_margin(m: SimpleNamespace, best: po.Optimum) -> float:
    """Return the smallest relative margin of all requirements (absolute for a limit of 0)."""
    sizes = {name: abs(most if most is not None else least) or 1.0 for name, (_, least, most, _) in m.limits.items()}
    return min(margin / sizes[name] for name, margin in best.margins.items())


def kkt_residual(c: SimpleNamespace, m: SimpleNamespace, best: po.Optimum) -> float:
    """Return the part of the fuel's gradient that the active limits do not balance, with multipliers computed here.

    Gradients by CasADi's automatic differentiation through the runs, which the optimiser does not use; variables in
    parts of their ranges.
    """
    symbols, at = ca.vertcat(*vars(c).values()), list(best.variables.values())
    bounds = [([symbol], *VARIABLES[name][1:]) for name, symbol in zip(best.variables, vars(c).values(), strict=True)]
    passed = ca.vertcat(*beyond_limits([*m.limits.values(), *bounds]))
    function = ca.Function("slopes", [symbols], [passed, ca.jacobian(m.fuel, symbols), ca.jacobian(passed, symbols)])
    beyond, slope, slopes = (np.asarray(result) for result in function(at))
    ranges = np.array([upper - lower for _, lower, upper, _ in VARIABLES.values()])
    decide = np.abs(beyond.ravel()) < _ACTIVE * np.maximum(1.0, np.linalg.norm(slopes * ranges, axis=1))
    target = -(slope.ravel() * ranges)
    return float(nnls((slopes[decide] * ranges).T, target)[1] / np.linalg.norm(target))


def beyond_limits(limits: Iterable[tuple[list[Any], float | None, float | None, str]]) -> list[Any]:
    """Return the relative violation of every limit; negative inside."""
    return [sign * (value - limit) / (abs(limit) or 1.0)
            for values, least, most, _ in limits for value in values
            for sign, limit in ((-1.0, least), (1.0, most)) if limit is not None]  # fmt: skip


def settled_averages(scene: po.Scene, waves: int = 7, steps: int = 64) -> SimpleNamespace:
    """Return the averages over the last of ``waves`` wavelengths, each of ``steps`` fourth-order Runge-Kutta steps."""
    soil, effects, speed, stiffness = scene.reaction, scene.effects, scene.tow_speed, scene.stiffness
    dt = WAVE.wavelength / speed / steps

    def rates(t: Array, z: Array, v: Array) -> tuple[Array, Array]:
        own = speed - v
        wave = 1.0 + WAVE.amplitude * np.sin(2.0 * np.pi / WAVE.wavelength * (speed * t - z))
        resistance = soil.static * (1.0 + effects.rate_term * own**2) * wave + soil.drag * own**2
        resistance = resistance + sum(leg.force(0.0, own) for leg in effects.own)
        return v, (resistance - stiffness * z - effects.damping * v) / scene.inertia

    z, v, last = scene.steady_resistance / stiffness, 0.0 * speed, []
    for step in range(waves * steps):
        t = step * dt
        a1, b1 = rates(t, z, v)
        a2, b2 = rates(t + dt / 2, z + dt / 2 * a1, v + dt / 2 * b1)
        a3, b3 = rates(t + dt / 2, z + dt / 2 * a2, v + dt / 2 * b2)
        a4, b4 = rates(t + dt, z + dt * a3, v + dt * b3)
        z, v = z + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4), v + dt / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        if step >= (waves - 1) * steps:
            last.append((z, stiffness * z + effects.damping * v))
    swing, force = np.moveaxis(np.array(last), 1, 0)
    return SimpleNamespace(
        mean_draft=np.mean(force, axis=0), force_rms=np.std(force, axis=0), displacement_rms=np.std(swing, axis=0)
    )


def evaluate(rows: Array, n: int) -> SimpleNamespace:
    """Return fuel [MJ/ha], worst violation and all variables of designs, given as rows of their `FREE` variables."""
    c = SimpleNamespace(**{name.replace(" ", "_"): row for name, row in zip(FREE, rows, strict=True)})
    c.height, c.tube, c.slip = 1.0 + 0.0 * c.spacing, 0.2 + 0.0 * c.spacing, 0.1 + 0.0 * c.spacing
    radii = machine(c, n, lambda _: SimpleNamespace(mean_draft=1.0, force_rms=0.0, displacement_rms=0.0)).radii
    c.height = c.spacing / np.min([a + b for a, b in pairwise(radii)], axis=0)
    first = machine(c, n, settled_averages)

    def again() -> SimpleNamespace:
        runs = iter(first.runs)
        return machine(c, n, lambda _: next(runs))

    # Stress falls with the cube of the tube's side.
    c.tube = c.tube * (np.max(np.abs(first.limits["stress"][0]), axis=0) / STRENGTH) ** (1.0 / 3.0)
    pull, weight = again().pull, (TRACTOR + c.ballast) * GRAVITY
    low, high = (np.full_like(pull, bound) for bound in VARIABLES["slip"][1:3])
    for _ in range(50):
        c.slip = (low + high) / 2.0
        pulls = traction(c.slip, weight)[1] >= pull
        low, high = np.where(pulls, low, c.slip), np.where(pulls, c.slip, high)
    c.slip = high
    done = again()
    bounds = [([getattr(c, name.replace(" ", "_"))], *rest) for name, (_, *rest) in VARIABLES.items()]
    worst = np.max(beyond_limits([*done.limits.values(), *bounds]), axis=0)
    return SimpleNamespace(fuel=done.fuel, worst=worst, variables=c)


def brute_force(n: int, generations: int = 150, size: int = 20, seed: int = 1) -> tuple[SimpleNamespace, int]:
    """Return the best design that differential evolution finds within the bounds, and the number of designs tried."""
    tried = 0

    def cost(rows: Array) -> Array:
        nonlocal tried
        tried += rows.shape[1]
        found = evaluate(rows, n)
        return np.where(found.worst <= _ROUNDING, found.fuel, 1e5 * (1.0 + found.worst))

    bounds = [VARIABLES[name][1:3] for name in FREE]
    result = differential_evolution(cost, bounds, maxiter=generations, popsize=size, tol=0.0, seed=seed, polish=False,
                                    vectorized=True, updating="deferred")  # fmt: skip
    best = evaluate(result.x[:, None], n)
    variables = {name: float(getattr(best.variables, name.replace(" ", "_"))[0]) for name in VARIABLES}
    return SimpleNamespace(fuel=float(best.fuel[0]), worst=float(best.worst[0]), variables=variables), tried


if __name__ == "__main__":
    check(*solved())
