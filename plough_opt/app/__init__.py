"""Command line, its tables and pictures, and reports as HTML pages."""

from plough_opt.app.main import main

__all__ = ["main"]
