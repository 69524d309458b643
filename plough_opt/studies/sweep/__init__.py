"""Sweeps: a function, a simulation or a whole optimisation at every point of a grid or a sample, resumable.

Workers import this package for its module `work` alone: what only the sweep itself needs is not imported here.
"""
