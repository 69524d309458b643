"""Errors of derivatives from differences of runs side by side, against the runs' own Taylor coefficients."""

import numpy as np
import pytest

from plough_opt.core.compiler import find_compiler
from plough_opt.design.derivatives import error_of_derivatives
from plough_opt.motion.derivatives import difference_of_jets, finer_than, jets


@pytest.mark.parametrize("damping", [None, 300.0])
@pytest.mark.parametrize("refinement", [0.25, 0.5])
def test_differences_of_runs_tell_the_same_error_as_their_derivatives(build_r1, refinement, damping):
    if find_compiler() is None:
        pytest.skip("without a compiler there are no differences of very many runs")
    d = build_r1(damping=damping).design
    d.solve(search="near")
    program, y, none = d._program, d._program.start(), np.empty(0)
    program.build(none, refinement, [y])
    (own,) = program.nlp.groups
    p = own.inputs(y, none).full().ravel()
    scales = p[list(own.varying)]
    columns = np.array([1.0, *scales, *(a * b for k, a in enumerate(scales) for b in scales[k:])])
    used, better = (
        np.asarray(jets(one.structure, one.timeline, own.varying, 2)(p)) * columns
        for one in (own.solver, finer_than(own.solver))
    )
    exact = difference_of_jets(own.solver, p, used, better, own.first)
    assert exact > 1e-9
    # Changes by 0.3 rad of the phase bend an error that oscillates with it by 0.3**2/12 of itself.
    assert error_of_derivatives(program, y, none) == pytest.approx(exact, rel=0.01)
