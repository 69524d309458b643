"""Computing of reports and rendering as HTML: template, scripts and numbers in one file that loads nothing else."""

from importlib.resources import files
from typing import Any, Final

from plough_opt.app.page import content, series
from plough_opt.app.page.content import Report
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.process import optional
from plough_opt.design import Progress, Sensitivity
from plough_opt.motion import Run
from plough_opt.motion.machine import Machine
from plough_opt.problem_file import Problem
from plough_opt.studies.accuracy.study import study_accuracy

ASSETS: Final = files("plough_opt.app.page") / "assets"
# Time limit [s] of one use of an integration method: every efficient one needs less than a tenth of it.
_ALLOWANCE: Final = 0.1


def reported(problem: Problem, notify: Progress, *, seed: int = 0, accuracy: bool = True) -> Report:
    """Return the contents of a report without its provenance.

    Args:
        problem: the file.
        notify: called with the present step in words and the fraction done.
        seed: seed of the search's samples.
        accuracy: whether to compare integration methods.
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
    assert isinstance(run, Run)  # the command refuses several shares
    study = None
    if accuracy:
        duration: Any = problem.values().get("scene.duration")
        study = study_accuracy(run.scene, duration, allowance=_ALLOWANCE, derivatives=False, thin=True, progress=notify)
    return Report(problem, run, best, sensitivities, unknown, study)


def page(report: Report) -> str:
    """Return a report as HTML.

    All texts of the file and of the results are escaped. The page's content security policy forbids all requests.

    Raises:
        InputError: jinja2 is not installed.
    """
    return _rendered("page.html", report=report, c=content, data=data(report))


def motion_page(run: Run, title: str) -> str:
    """Return an HTML page with the animation of a run.

    Raises:
        InputError: jinja2 is not installed.
    """
    return _rendered("motion.html", title=title, data={"motion": series.motion(run)})


def _rendered(name: str, **values: Any) -> str:
    jinja = optional("jinja2", "report")
    around = jinja.Environment(autoescape=True, loader=jinja.FunctionLoader(asset), undefined=jinja.StrictUndefined,
                               trim_blocks=True, lstrip_blocks=True)  # fmt: skip
    text: str = around.get_template(name).render(asset=asset, **values)
    return text


def data(report: Report) -> dict[str, Any]:
    """Return the data that the page's scripts draw."""
    return {
        "charts": series.charts(report),
        "search": series.search(report),
        "accuracy": series.study(report),
        "bodies": series.bodies(report),
        "motion": series.motion(report.run),
    }


def asset(name: str) -> str:
    """Return the text of one of the files that make up the page."""
    return (ASSETS / name).read_text(encoding="utf-8")
