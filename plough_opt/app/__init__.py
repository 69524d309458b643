"""Command line, its tables and pictures, and reports as HTML pages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["plots"])
