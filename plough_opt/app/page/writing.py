"""A report written as HTML: template, style, scripts and numbers in one file that asks nothing of a network."""

from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from plough_opt.app.page import content, series
from plough_opt.app.page.content import Report
from plough_opt.core.errors import InputError
from plough_opt.core.files import write_file
from plough_opt.motion import Run

ASSETS: Final = files("plough_opt.app.page") / "assets"


def write_page(report: Report, path: str | Path) -> Path:
    """Write a report as HTML, whole or not at all; return its path.

    Raises:
        InputError: jinja2 is not installed, or a place that cannot be written.
    """
    return write_file(path, "report", page(report))


def page(report: Report) -> str:
    """Return a report as HTML.

    Every text of the file and of the results is escaped. A policy in the page forbids it every request.

    Raises:
        InputError: jinja2 is not installed.
    """
    return _rendered("page.html", report=report, c=content, data=data(report))


def motion_page(run: Run, title: str) -> str:
    """Return the animation of a run as a page of its own.

    Raises:
        InputError: jinja2 is not installed.
    """
    return _rendered("motion.html", title=title, data={"motion": series.motion(run)})


def _rendered(name: str, **values: Any) -> str:
    try:
        from jinja2 import Environment, FunctionLoader, StrictUndefined
    except ModuleNotFoundError:
        raise InputError("jinja2 is not installed: pip install 'plough_opt[report]'") from None
    around = Environment(autoescape=True, loader=FunctionLoader(asset), undefined=StrictUndefined, trim_blocks=True,
                         lstrip_blocks=True)  # fmt: skip
    return around.get_template(name).render(asset=asset, **values)


def data(report: Report) -> dict[str, Any]:
    """Return the numbers that the page's scripts draw."""
    return {
        "charts": series.charts(report),
        "search": series.search(report),
        "accuracy": series.study(report),
        "bodies": series.bodies(report),
        "motion": series.motion(report.run),
    }


def asset(name: str) -> str:
    """Return the text of a file that is part of the page."""
    return (ASSETS / name).read_text(encoding="utf-8")
