"""Exports: scenes as C, CasADi Function, OpenMDAO component or FMU, and shares as parts.

Users import the functions from `plough_opt.export`.
"""
