"""The report: one HTML file that opens offline and says what changed in the plant, and how surely."""

from trueplant.report.page import render

__all__ = ["render"]
