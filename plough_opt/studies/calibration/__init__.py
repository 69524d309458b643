"""Calibration: soil and model parameters from measured draft, with their uncertainty and identifiability."""

from plough_opt.studies.calibration.calibrate import Calibration, calibrate
from plough_opt.studies.calibration.fit import Fit
from plough_opt.studies.calibration.measurements import Measurements, read_measurements

__all__ = ["Calibration", "Fit", "Measurements", "calibrate", "read_measurements"]
