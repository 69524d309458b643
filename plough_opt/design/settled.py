"""Variables that enter no run and all else in proportion, as a peak's bound: solved from the algebra in place."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from plough_opt.design.declarations import Variable
from plough_opt.design.ipopt import Vector
from plough_opt.design.split import split

# Slopes below this, scaled, are none.
_NO_SLOPE = 1e-300


@dataclass(frozen=True)
class Linear:
    """A variable whose changes change objective and requirements in proportion, whatever the design.

    Attributes:
        number: of the variable.
        variable: the variable.
        objective: slope of the objective.
        rows: slopes of the requirements' rows.
    """

    number: int
    variable: Variable
    objective: float
    rows: Vector

    def settled(self, points: Vector, f: Vector, g: Vector, low: Vector, high: Vector) -> tuple[Vector, Vector, Vector]:
        """Return designs with this variable where it is best, the others held, with their objective and rows.

        Args:
            points: scaled variables, a row for each design.
            f: objective, in its unit.
            g: rows of the requirements, in their units.
            low: lower limits of the rows.
            high: upper limits.
        """
        v, moving = self.variable, np.flatnonzero(np.abs(self.rows) > _NO_SLOPE)
        y = points[:, self.number]
        value = np.asarray(v.unscaled(y))
        slopes, own = self.rows[moving], g[:, moving]
        with np.errstate(invalid="ignore"):
            ends = (low[moving] - own) / slopes, (high[moving] - own) / slopes
        least = np.where(slopes > 0.0, *ends).max(axis=1, initial=-np.inf)
        most = np.where(slopes > 0.0, *ends[::-1]).min(axis=1, initial=np.inf)
        nearest = np.minimum(np.maximum(0.0, least), most)
        wanted = least if self.objective > 0.0 else most if self.objective < 0.0 else nearest
        best = np.clip(np.where(np.isnan(wanted), value, value + wanted), v.lower, v.upper)
        moved = points.copy()
        moved[:, self.number] = np.clip(v.scaled(best), 0.0, 1.0)
        change = best - value
        return moved, f + self.objective * change, g + change[:, None] * self.rows


def linear_variables(
    expressions: Sequence[ca.MX], variables: Sequence[Variable], parameters: Sequence[ca.MX], p: Vector
) -> list[Linear]:
    """Return the variables that enter no run, and objective and requirements in proportion; no two the same row.

    Args:
        expressions: objective and requirements of the variables and parameters.
        variables: of the design, one of which at least is left out.
        parameters: their symbols.
        p: parameters.
    """
    symbols = [v.symbol for v in variables]
    parts = split(list(expressions), [*symbols, *parameters])
    given = ca.vertcat(*(ca.vec(item) for run in parts.runs for item in (run.inputs, run.quantities)))
    f, g = parts.expressions[0], ca.vertcat(*(ca.vec(one) for one in parts.expressions[1:]))
    changing = ca.vertcat(*symbols, *parts.results)
    found: list[Linear] = []
    taken = np.zeros(g.numel(), dtype=bool)
    for number, v in enumerate(variables):
        if len(found) == len(variables) - 1 or (given.numel() and ca.depends_on(given, v.symbol)):
            continue
        slopes = ca.vertcat(ca.jacobian(f, v.symbol), ca.jacobian(g, v.symbol))
        if ca.depends_on(slopes, changing):
            continue
        numbers = ca.Function("slopes", list(parameters), [ca.densify(slopes)]).call([*map(ca.DM, p)])[0]
        objective, *rows = np.asarray(numbers).ravel().tolist()
        own = np.array(rows)
        if np.any(taken & (own != 0.0)) or not np.all(np.isfinite(own)):
            continue
        taken |= own != 0.0
        found.append(Linear(number, v, objective, own))
    return found
