"""Resumable sweeps: a function, a simulation or a whole optimisation at every point of a grid or a sample.

This package imports nothing here, because workers need only its module `work`.
"""
