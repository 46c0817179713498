"""Robustness: margins, uncertainty and performance weights, structured singular values, robust performance."""

from trueplant.robust.blocks import Block, Full, Repeated, diagonal
from trueplant.robust.margins import Margins, margins, niederlinski, rga
from trueplant.robust.mu import MuResult, mu

__all__ = ["Block", "Full", "Margins", "MuResult", "Repeated", "diagonal", "margins", "mu", "niederlinski", "rga"]
