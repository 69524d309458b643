"""Studies of many runs or designs: trade-offs, uncertain soil, calibration, sweeps, accuracy, comparison of laws."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["crosscheck"])
