"""Equation of motion (27) of the share on its mount, integrated by CasADi."""

from plough_opt.motion.run import Averages, Run
from plough_opt.motion.simulation import simulate
from plough_opt.motion.solvers.plan import OUTPUTS

__all__ = ["OUTPUTS", "Averages", "Run", "simulate"]
