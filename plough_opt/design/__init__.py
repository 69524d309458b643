"""Designs: variables, an objective and named requirements, solved by IPOPT with exact derivatives."""

from plough_opt.design.boxed import Over
from plough_opt.design.exploring import Progress
from plough_opt.design.local_optimum import Limit, LocalOptimum, Search
from plough_opt.design.optimum import Choice, Optimum, Rounded
from plough_opt.design.problem import Design
from plough_opt.design.sensitivity import Sensitivity
from plough_opt.design.tolerance import Spread

__all__ = [
    "Choice",
    "Design",
    "Limit",
    "LocalOptimum",
    "Optimum",
    "Over",
    "Progress",
    "Rounded",
    "Search",
    "Sensitivity",
    "Spread",
]
