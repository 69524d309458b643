"""Expressions of a design, split into the runs inside them and the algebra around those runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from plough_opt.errors import InputError
from plough_opt.motion.embedding import Embedding, embedding_of
from plough_opt.motion.integrators import Integration


@dataclass(frozen=True)
class EmbeddedRun:
    """A run that stands in a design's expressions.

    Attributes:
        embedding: method, times, structure and scene that it was written with.
        inputs: its parameters, the duration last, as expressions of the design's symbols.
        quantities: every quantity of its scene, as expressions of the design's symbols.
        outputs: its results in the graph: states, means, variances.
    """

    embedding: Embedding
    inputs: ca.MX
    quantities: ca.MX
    outputs: tuple[ca.MX, ...]

    @property
    def integration(self) -> Integration:
        """Method, times and structure that the run was written with."""
        return self.embedding.integration


@dataclass(frozen=True)
class Split:
    """Expressions with every run's results replaced by symbols.

    Attributes:
        runs: the runs found, each once.
        expressions: the expressions in terms of the design's symbols and the runs' results.
        results: for each run, a symbol for its results stacked: states column by column, means, variances.
    """

    runs: tuple[EmbeddedRun, ...]
    expressions: tuple[ca.MX, ...]
    results: tuple[ca.MX, ...]


def split(expressions: list[ca.MX], symbols: list[ca.MX]) -> Split:
    """Find the runs in expressions of ``symbols`` and put symbols in the place of their results.

    Raises:
        InputError: a run's parameters depend on the results of another run.
    """
    whole = ca.Function("whole", symbols, expressions, {"never_inline": True})
    runs: dict[int, EmbeddedRun] = {}
    for k in range(whole.n_instructions()):
        if whole.instruction_id(k) != ca.OP_CALL:
            continue
        node = whole.instruction_MX(k)
        known = embedding_of(node.which_function())
        if known is not None:
            outputs = tuple(node.get_output(i) for i in range(known.function.n_out()))
            runs[hash(node)] = EmbeddedRun(known, node.dep(0), node.dep(1), outputs)
    found = tuple(runs.values())
    results = tuple(
        ca.MX.sym(f"results_{i}", sum(output.numel() for output in run.outputs)) for i, run in enumerate(found)
    )
    old: list[ca.MX] = []
    new: list[ca.MX] = []
    for run, result in zip(found, results, strict=True):
        position = 0
        for output in run.outputs:
            part = result[position : position + output.numel()]
            old.append(output)
            new.append(ca.reshape(part, output.shape))
            position += output.numel()
    originals = [*expressions, *(run.inputs for run in found), *(run.quantities for run in found)]
    replaced = ca.graph_substitute(originals, old, new) if found else originals
    own = replaced[len(expressions) :]
    independent = tuple(
        replace(run, inputs=inputs, quantities=quantities)
        for run, inputs, quantities in zip(found, own[: len(found)], own[len(found) :], strict=True)
    )
    if any(ca.depends_on(run.inputs, result) for run in independent for result in results):
        raise InputError("a run of this design is given results of another run: a design takes runs side by side only")
    return Split(independent, tuple(replaced[: len(expressions)]), results)
