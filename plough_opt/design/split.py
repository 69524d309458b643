"""Expressions of a design, split into the runs inside them and the algebra around those runs."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from plough_opt.errors import InputError
from plough_opt.motion.integrators import Integration, integration_of


@dataclass(frozen=True)
class EmbeddedRun:
    """A run that stands in a design's expressions.

    Attributes:
        integration: method, times and structure that it was written with.
        inputs: its parameters, the duration last, as expressions of the design's symbols.
        outputs: its results in the graph: states, means, variances.
    """

    integration: Integration
    inputs: ca.MX
    outputs: tuple[ca.MX, ...]


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
        known = integration_of(node.which_function())
        if known is not None:
            outputs = tuple(node.get_output(i) for i in range(known.function.n_out()))
            runs[hash(node)] = EmbeddedRun(known, node.dep(0), outputs)
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
    originals = [*expressions, *(run.inputs for run in found)]
    replaced = ca.graph_substitute(originals, old, new) if found else originals
    independent = tuple(
        EmbeddedRun(run.integration, inputs, run.outputs)
        for run, inputs in zip(found, replaced[len(expressions) :], strict=True)
    )
    if any(ca.depends_on(run.inputs, result) for run in independent for result in results):
        raise InputError("a run of this design is given results of another run: a design takes runs side by side only")
    return Split(independent, tuple(replaced[: len(expressions)]), results)
