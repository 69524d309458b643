"""Problem files: a design question as a TOML file of quantities with units."""

from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.reading import read_problem
from plough_opt.problem_file.template import TEMPLATE

__all__ = ["TEMPLATE", "Problem", "read_problem"]
