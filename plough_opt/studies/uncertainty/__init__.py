"""Designs for uncertain soil: distributions, robust measures over common samples, verification on fresh samples."""

from plough_opt.studies.uncertainty.distribution import Marginal, SoilDistribution, SoilSamples
from plough_opt.studies.uncertainty.measures import (
    cvar,
    expected,
    mean_plus,
    probability,
    quantile,
    standard_deviation,
    worst,
)
from plough_opt.studies.uncertainty.result import SobolIndices, sobol_indices
from plough_opt.studies.uncertainty.robust import Check, Robust, Verification, verify

__all__ = [
    "Check", "Marginal", "Robust", "SobolIndices", "SoilDistribution", "SoilSamples", "Verification", "cvar",
    "expected", "mean_plus", "probability", "quantile", "sobol_indices", "standard_deviation", "verify", "worst",
]  # fmt: skip
