"""Designs for uncertain soil: distributions, mean and spread over common soils, verification on fresh soils."""

from plough_opt.studies.uncertainty import *  # noqa: F403
from plough_opt.studies.uncertainty import __all__ as __all__
