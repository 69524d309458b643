"""Problem files: a design question as a TOML file of quantities with units."""

from plough_opt.core.files import text_of
from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.reading import read_problem

__all__ = ["Problem", "read_problem", "template"]


def template() -> str:
    """Return the commented problem file that `plough-opt init` writes."""
    return text_of(__name__, "template.toml")
