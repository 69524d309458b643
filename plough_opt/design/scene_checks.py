"""The scenes in a design's expressions, checked with the numbers of many designs."""

from collections.abc import Callable, Iterator, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.labels import Call
from plough_opt.design.split import Split
from plough_opt.motion.batch.batch import DomainCheck
from plough_opt.motion.scene import Scene

Vector = NDArray[np.float64]


def has_own_law(scene: Scene) -> bool:
    """Return whether a user's class is the law of resistance, which may raise an error of any kind."""
    return type(scene.law).__module__.partition(".")[0] != __name__.partition(".")[0]


class SceneChecks:
    """Checks of all scenes in some expressions, or of those that a condition selects."""

    def __init__(
        self, parts: Split, symbols: Sequence[ca.MX], selected: Callable[[Scene], bool] = lambda _: True
    ) -> None:
        """Take the split expressions, their symbols (columns), and the condition."""
        # Runs that share a template are checked together.
        columns: dict[int, tuple[Scene, list[ca.MX]]] = {}
        for template, column in _scenes(parts):
            if selected(template):
                columns.setdefault(id(template), (template, []))[1].append(column)
        self._checks: list[tuple[DomainCheck, ca.Function]] = []
        for template, own in columns.values():
            rows = list(zip(*map(ca.vertsplit, own), strict=True))
            fixed = [_constant(row) for row in rows[:-1]]
            varying = [ca.horzcat(*row) for row, number in zip(rows, [*fixed, None], strict=True) if number is None]
            quantities = ca.Function("quantities", list(symbols), [ca.densify(ca.vertcat(*varying))])
            self._checks.append((DomainCheck(template, fixed), quantities))

    def reasons(self, *rows: Vector, declared: bool = True) -> dict[int, str]:
        """Return number -> reason of every design with a scene outside the model's domain.

        Args:
            rows: values of each symbol, a row for each design.
            declared: as in `DomainCheck.reasons`.
        """
        reasons: dict[int, str] = {}
        for check, quantities in self._checks:
            found = np.asarray(quantities.map(len(rows[0]))(*(row.T for row in rows)))
            for k, reason in check.reasons(found, declared=declared).items():
                reasons.setdefault(k // quantities.size2_out(0), reason)
        return reasons


def _constant(values: Sequence[ca.MX]) -> float | None:
    """Return the number that all expressions are, or None."""
    numbers = {float(value) if value.is_constant() else None for value in values}
    return numbers.pop() if len(numbers) == 1 else None


def _scenes(parts: Split) -> Iterator[tuple[Scene, ca.MX]]:
    """Yield the template of each scene, and a column of its quantities and duration."""
    for run in parts.runs:
        yield run.embedding.template, ca.vertcat(run.quantities, run.inputs[-1])
    for meaning, carried in parts.labels:
        given = meaning.template[0][:1] if isinstance(meaning, Call) else (meaning,)
        for scene in given:
            if isinstance(scene, Scene):
                # The duration does not matter to a scene without a run.
                yield scene, ca.vertcat(ca.vec(carried), 1.0)
