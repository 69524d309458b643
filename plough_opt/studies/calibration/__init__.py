"""Calibration: soil and model parameters from measured draft, with what the data can and cannot tell."""

from plough_opt.studies.calibration.candidates import Candidate, NextMeasurement
from plough_opt.studies.calibration.csv_file import read_measurements
from plough_opt.studies.calibration.fit import Fit
from plough_opt.studies.calibration.measurements import Measurements
from plough_opt.studies.calibration.question import Calibration, calibrate

__all__ = ["Calibration", "Candidate", "Fit", "Measurements", "NextMeasurement", "calibrate", "read_measurements"]
