"""Designs for uncertain soil: distributions, mean and spread over common soils, verification on fresh soils."""

from plough_opt.studies.uncertainty.distribution import SoilDistribution
from plough_opt.studies.uncertainty.robust import Check, Robust, Verification, expected, standard_deviation, verify

__all__ = ["Check", "Robust", "SoilDistribution", "Verification", "expected", "standard_deviation", "verify"]
