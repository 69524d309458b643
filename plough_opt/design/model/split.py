"""Splits a design's expressions into the runs inside them and the algebra around those runs, and checks its scenes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import Call, meaning_of, without_labels
from plough_opt.core.errors import InputError
from plough_opt.motion.batch.batch import DomainCheck
from plough_opt.motion.integrators import Embedding, Integration, embedding_of
from plough_opt.motion.scene import Scene

_GIVEN_RESULTS = "a run in a design cannot depend on the results of another run: give both the same variables instead"


@dataclass(frozen=True)
class EmbeddedRun:
    """A run inside a design's expressions.

    Attributes:
        embedding: method, times, structure and scene of the run.
        inputs: its parameters, with the duration last, as expressions of the design's symbols.
        quantities: all quantities of its scene, as expressions of the design's symbols.
        outputs: its results in the graph: states, means, variances.
    """

    embedding: Embedding
    inputs: ca.MX
    quantities: ca.MX
    outputs: tuple[ca.MX, ...]

    @property
    def integration(self) -> Integration:
        """Method, times and structure of the run."""
        return self.embedding.integration


@dataclass(frozen=True)
class Split:
    """Expressions in which symbols replace the results of every run.

    Attributes:
        runs: the runs, each once.
        expressions: the expressions in terms of the design's symbols and the runs' results.
        results: for each run a symbol of its stacked results: states column by column, means, variances.
        labels: the meaning of each label in the expressions, with the quantities that the label carries.
    """

    runs: tuple[EmbeddedRun, ...]
    expressions: tuple[ca.MX, ...]
    results: tuple[ca.MX, ...]
    labels: tuple[tuple[object, ca.MX], ...]


def split(expressions: list[ca.MX], symbols: list[ca.MX]) -> Split:
    """Return expressions of ``symbols`` with the runs in them replaced by symbols of their results.

    Raises:
        InputError: a run's parameters depend on the results of another run.
    """
    found, calls = _calls(ca.Function("whole", symbols, expressions, {"never_inline": True}))
    labels = _carried(calls, symbols, bool(found))
    if calls:
        expressions = without_labels(expressions, [node for _, node in calls])
        found, _ = _calls(ca.Function("whole", symbols, expressions, {"never_inline": True}))
    results = tuple(
        ca.MX.sym(f"results_{i}", sum(output.numel() for output in run.outputs)) for i, run in enumerate(found)
    )
    old: list[ca.MX] = []
    new: list[ca.MX] = []
    for run, result in zip(found, results, strict=True):
        ends = np.cumsum([0, *(output.numel() for output in run.outputs)]).tolist()
        old += run.outputs
        new += [ca.reshape(result[i:j], o.shape) for o, i, j in zip(run.outputs, ends, ends[1:], strict=False)]
    inputs, quantities = [run.inputs for run in found], [run.quantities for run in found]
    groups = [expressions, inputs, quantities]
    if found:
        flat = iter(ca.graph_substitute([item for group in groups for item in group], old, new))
        groups = [[next(flat) for _ in group] for group in groups]
    expressions, inputs, quantities = groups
    taken, given = [ca.vertcat(*(ca.vec(item) for item in items)) for items in (results, inputs)]
    if found and ca.depends_on(given, taken):
        raise InputError(_GIVEN_RESULTS)
    independent = (
        replace(run, inputs=given, quantities=scene)
        for run, given, scene in zip(found, inputs, quantities, strict=True)
    )
    return Split(tuple(independent), tuple(expressions), results, tuple(labels))


def _carried(calls: list[tuple[object, ca.MX]], symbols: list[ca.MX], runs: bool) -> list[tuple[object, ca.MX]]:
    """Return labels with the quantities they carry, except laws of a run's results: these are unknown before the run.

    Raises:
        InputError: a label that is not a law's carries results of a run.
    """
    found = []
    # Hardly any design has a label that carries results: all labels are looked through at once first.
    every = [node.dep(1) for _, node in calls]
    runs = runs and bool(_calls(ca.Function("carried", symbols, every, {"never_inline": True}))[0])
    for meaning, node in calls:
        if not runs or not _calls(ca.Function("carried", symbols, [node.dep(1)], {"never_inline": True}))[0]:
            found.append((meaning, node.dep(1)))
        elif not isinstance(meaning, Call):
            raise InputError(_GIVEN_RESULTS)
    return found


def _calls(whole: ca.Function) -> tuple[list[EmbeddedRun], list[tuple[object, ca.MX]]]:
    """Return the runs and the labels that a Function's graph calls, each once."""
    runs: dict[int, EmbeddedRun] = {}
    labels: dict[int, tuple[object, ca.MX]] = {}
    for k in range(whole.n_instructions()):
        if whole.instruction_id(k) != ca.OP_CALL:
            continue
        node = whole.instruction_MX(k)
        if (meaning := meaning_of(node.which_function())) is not None:
            labels[hash(node)] = (meaning, node)
        elif (run := embedding_of(node.which_function())) is not None:
            outputs = tuple(node.get_output(i) for i in range(run.integration.function.n_out()))
            runs[hash(node)] = EmbeddedRun(run, node.dep(0), node.dep(1), outputs)
    return list(runs.values()), list(labels.values())


Vector = NDArray[np.float64]


def is_own(item: Any) -> bool:
    """Return whether a class or a function is the user's, which may raise an error of any kind."""
    return str(item.__module__).partition(".")[0] != __name__.partition(".")[0]


def has_own_law(scene: Scene) -> bool:
    """Return whether a user's class is the law of resistance."""
    return is_own(type(scene.law))


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
