"""Command line: plough-opt init, check, simulate, optimise, tradeoff, sweep, accuracy, soils."""

from plough_opt.app.main import main

__all__ = ["main"]
