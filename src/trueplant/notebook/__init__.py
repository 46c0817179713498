"""What a notebook works with: frames in, an `Analysis` out, with tables, figures and settings."""

from trueplant.notebook.analysis import Analysis, Elements, load
from trueplant.notebook.commands import check, run, simulate, track
from trueplant.notebook.loops import Loop

__all__ = ["Analysis", "Elements", "Loop", "check", "load", "run", "simulate", "track"]
