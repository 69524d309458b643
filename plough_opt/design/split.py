"""Splits a design's expressions into the runs inside them and the algebra around those runs."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.labels import Call, meaning_of, without_labels
from plough_opt.motion.integrators import Embedding, Integration, embedding_of

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
