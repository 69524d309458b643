"""Designs: variables, an objective and named requirements, solved by IPOPT with exact derivatives."""

from plough_opt.design.confirmation import Spread
from plough_opt.design.question import Design, NonlinearProgram
from plough_opt.design.result.optimum import Choice, Limit, LocalOptimum, Optimum, Rounded, Search
from plough_opt.design.result.sensitivity import Sensitivity
from plough_opt.design.search.explore import Progress

__all__ = [
    "Choice", "Design", "Limit", "LocalOptimum", "NonlinearProgram", "Optimum", "Progress", "Rounded", "Search",
    "Sensitivity", "Spread",
]  # fmt: skip
