"""Transcriptions of a design, whose optimum converges to the true one with the order of the method.

The true optimum of problem R1 is the best of 1.9 million simulations on a grid, polished with exact gradients to a
residual of 1e-9 and checked in long double.
"""

import casadi as ca
import numpy as np
import pytest
from helpers.problem_files import REFERENCE
from helpers.small_designs import softest

import plough_opt as po
from plough_opt.core.errors import InputError
from plough_opt.design.program import Program
from plough_opt.studies.accuracy.local_solve import Start, solve_transcribed
from plough_opt.studies.accuracy.transcription import Mesh, Question, transcribe

L3 = (39.11469851, 0.2002828632, 37505.6423, 0.9164459115)


def question_of(d):
    program = Program(d.declared)
    p = np.array([parameter.value for parameter in d._parameters])
    program.build(p)
    return Question.of(program, p)


@pytest.fixture(scope="module")
def r1():
    return question_of(po.read_problem(REFERENCE).design()[0])


def solved(question, form, truth):
    """Return the objective and the variables of the optimum beside a true one."""
    given = (po.deg(truth[0]), truth[1], truth[2])
    y = np.array([v.scaled(x) for v, x in zip(question.program.declared.variables, given, strict=True)])
    scalar = isinstance(form, Mesh) and form.degree > 0
    found = solve_transcribed(transcribe(question, form, y), Start(y, True, 60.0), scalar=scalar)()
    return found.f * question.program.objective_scale, question.program.values(found.y)


# The finer mesh leaves errors of 1e-8 to 1e-4, far above those of the true optimum, 5e-11.
@pytest.mark.parametrize(
    ("points", "degree", "order", "mesh"), [("legendre", 2, 4, 100), ("legendre", 4, 8, 30), ("radau", 3, 5, 60)]
)
def test_error_of_the_optimum_falls_in_the_order_of_the_collocation(r1, points, degree, order, mesh):
    errors = []
    for intervals in (mesh, 2 * mesh):
        objective, values = solved(r1, Mesh(intervals, degree=degree, points=points), L3)
        errors.append([abs(objective - L3[3]), abs(values[2] - L3[2]) / L3[2]])
    # With half a step per radian convergence is not quite asymptotic. The next possible order differs by 1 or 2.
    np.testing.assert_allclose(np.log2(np.array(errors[0]) / errors[1]), order, atol=0.3)


def test_shooting_by_segments_has_the_optimum_of_shooting_once(r1):
    coarse, fine = (solved(r1, po.Accuracy("dop853", steps=steps), L3) for steps in (48, 96))
    segments, values = solved(r1, Mesh(8, steps=12), L3)
    # The same steps in another form differ by IPOPT's tolerance.
    assert segments == pytest.approx(fine[0], abs=1e-11)
    np.testing.assert_allclose(values, fine[1], rtol=1e-8)
    assert np.log2(abs(coarse[0] - L3[3]) / abs(fine[0] - L3[3])) > 7.8


# --- every result of a run ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rich(r1_soil, r1_wave):
    """Return a question of one variable that uses outputs, two signals with an RMS and the tow power."""
    d = po.Design()
    k0 = d.variable("stiffness", guess=2e4, lower=1e4, upper=4e4, unit="N/m", log=True)
    damping = d.parameter("damping", 250.0, unit="N s/m")
    share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.2)
    effects = po.Effects(strength_wave=r1_wave, damping=damping, tow_ramp=0.13, start="rest")
    run = po.simulate(po.Scene(r1_soil, share, k0, 25.0, 2.0, effects), 0.5, outputs=10)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3 + run.displacement_rms / 1e-2 + run.tow_power / 1e3)
    d.require("deflection", run.deflection, at_most=0.5, unit="m")
    d.require("force", run.mount_force, at_least=-1e4, at_most=1e4, unit="N")
    return question_of(d)


COLLOCATIONS = [Mesh(40, degree=5, points=points) for points in ("radau", "legendre")]


@pytest.mark.parametrize("form", [po.Accuracy("dop853", steps=200), Mesh(20, steps=10), *COLLOCATIONS], ids=str)
def test_every_result_of_a_run_is_that_of_the_tight_integration(rich, form):
    own = transcribe(rich, form)
    # With the variable fixed at its guess, IPOPT solves for the run alone.
    start = own.given["x0"]
    held = {end: np.r_[start[:1], own.given[end][1:]] for end in ("lbx", "ubx")}
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    options |= {"ipopt.fixed_variable_treatment": "make_constraint"}
    solver = ca.nlpsol("held", "ipopt", {"x": own.x, "f": own.f, "g": ca.vertcat(*own.g)}, options)
    found = solver(**own.given | held)
    assert solver.stats()["return_status"] == "Solve_Succeeded"
    (objective, *requirements), _ = rich.program.exact_values(start[:1], rich.p)
    truth = np.concatenate([(v / s).ravel() for v, s in zip(requirements, rich.program.scales, strict=True)])
    # The ramp ends at a node of every mesh. Collocation of order 9 or 10 leaves some 1e-9.
    assert float(found["f"]) * rich.program.objective_scale == pytest.approx(objective.item(), rel=1e-8)
    np.testing.assert_allclose(np.asarray(found["g"]).ravel()[: len(truth)], truth, rtol=0.0, atol=1e-8)


def test_a_run_with_events_is_not_put_on_a_mesh(r1_soil, r1_wave):
    question = question_of(softest(r1_soil, r1_wave, duration=0.2, contact=po.StickSlip()))
    for form in (Mesh(4, steps=5), Mesh(4, degree=3)):
        with pytest.raises(InputError, match="events cannot be put on a mesh"):
            transcribe(question, form)
