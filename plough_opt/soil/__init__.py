"""Soil and share: soil properties, share geometry, plastic gas, elastic medium, strength along the path."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["elastic", "plastic"])
