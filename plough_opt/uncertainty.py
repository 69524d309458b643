"""Designs for uncertain soil: distributions, robust measures over common samples, verified on fresh ones."""

from plough_opt.studies.uncertainty import (
    Check,
    Marginal,
    Robust,
    SobolIndices,
    SoilDistribution,
    SoilSamples,
    Verification,
    cvar,
    expected,
    mean_plus,
    probability,
    quantile,
    sobol_indices,
    standard_deviation,
    verify,
    worst,
)

__all__ = [
    "Check",
    "Marginal",
    "Robust",
    "SobolIndices",
    "SoilDistribution",
    "SoilSamples",
    "Verification",
    "cvar",
    "expected",
    "mean_plus",
    "probability",
    "quantile",
    "sobol_indices",
    "standard_deviation",
    "verify",
    "worst",
]
