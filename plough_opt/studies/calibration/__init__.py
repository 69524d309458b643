"""Calibration: soil and model parameters from measured draft, with their uncertainty and identifiability."""

from plough_opt.studies.calibration.calibrate import Calibration, calibrate
from plough_opt.studies.calibration.fit import Fit
from plough_opt.studies.calibration.model import Measurements, read_measurements
from plough_opt.studies.calibration.quality import Candidate, NextMeasurement

__all__ = ["Calibration", "Candidate", "Fit", "Measurements", "NextMeasurement", "calibrate", "read_measurements"]
