"""Designs for uncertain soil: distributions, robust measures over common samples, verification on fresh samples."""

from plough_opt.studies.uncertainty import *  # noqa: F403
from plough_opt.studies.uncertainty import __all__ as __all__
