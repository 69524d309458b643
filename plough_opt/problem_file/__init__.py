"""Problem files: a design question as a TOML file of quantities with units."""

from importlib.resources import files

from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.reading import read_problem

__all__ = ["Problem", "read_problem", "template"]


def template() -> str:
    """Return the commented problem file that `plough-opt init` writes."""
    return (files(__name__) / "template.toml").read_text(encoding="utf-8")
