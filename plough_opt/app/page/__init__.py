"""A report as one page of HTML that needs nothing beside it."""

from plough_opt.app.page.content import Report
from plough_opt.app.page.writing import page, write_page

__all__ = ["Report", "page", "write_page"]
