"""Scenes for other tools: C, a serialised CasADi Function, OpenMDAO, an FMU; and shares as parts.

Users import the functions from `plough_opt.export`.
"""
