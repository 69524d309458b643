"""Sweeps: a function, a simulation or a whole optimisation at every point of a grid or a sample."""
