"""Designs: variables, an objective and named requirements, solved by IPOPT with exact derivatives."""

from plough_opt.design.optimum import Choice, Limit, LocalOptimum, Optimum, Rounded
from plough_opt.design.problem import Design
from plough_opt.design.search import Progress, Scan
from plough_opt.design.sensitivity import Sensitivity

__all__ = ["Choice", "Design", "Limit", "LocalOptimum", "Optimum", "Progress", "Rounded", "Scan", "Sensitivity"]
