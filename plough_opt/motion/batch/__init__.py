"""Batches: averages of very many designs, integrated side by side in the processor's vector registers."""

from plough_opt.motion.batch.batch import UNSTABLE, Batch, BatchResult

__all__ = ["UNSTABLE", "Batch", "BatchResult"]
