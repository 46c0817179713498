"""Robustness: margins, uncertainty and performance weights, structured singular values, robust performance."""

from trueplant.robust.margins import Margins, margins, niederlinski, rga

__all__ = ["Margins", "margins", "niederlinski", "rga"]
