"""Compute the contents of a report: the optimum, its sensitivities, and the cost of accuracy for its scene."""

from plough_opt.app.page.content import Report
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.design import Progress, Sensitivity
from plough_opt.motion import Run
from plough_opt.motion.machine import Machine
from plough_opt.problem_file import Problem
from plough_opt.studies.accuracy.study import study_accuracy

# Time [s] that one use of a contestant may take: those worth their time take a tenth of it.
_ALLOWANCE = 0.1


def reported(problem: Problem, notify: Progress, *, seed: int = 0, accuracy: bool = True) -> Report:
    """Return what a report says of a problem, without its provenance.

    Args:
        problem: the file.
        notify: called with the present step in words, and the part done.
        seed: of the search's samples.
        accuracy: whether to study what accuracy costs.
    """
    best, unknown = None, ""
    run: Run | Machine
    sensitivities: tuple[Sensitivity, ...] = ()
    if problem.variables:
        best, run = problem.optimise(notify, parameters=True, seed=seed)
        notify("sensitivities", 1.0)
        try:
            sensitivities = best.every_sensitivity()
        except (InputError, NotConverged) as error:
            unknown = str(error)
    else:
        notify("simulating", 0.0)
        run = problem.simulate()
    assert isinstance(run, Run)  # several shares are refused
    study = None
    if accuracy:
        lasting = run.scene.effects.orbit != "transient"
        duration = None if lasting else problem.values().get("scene.duration")
        study = study_accuracy(run.scene, duration, allowance=_ALLOWANCE, derivatives=False, thin=True, progress=notify)
    return Report(problem, run, best, sensitivities, unknown, study)
