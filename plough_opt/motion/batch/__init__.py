"""Very many designs: their mean and RMS force by compiled steps, a vector register of designs at a time."""

from plough_opt.motion.batch.batch import Batch
from plough_opt.motion.batch.result import BatchResult

__all__ = ["Batch", "BatchResult"]
