"""A plant with its controller for small changes: what margins, robustness and retuning start from."""

from __future__ import annotations

from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from trueplant.loop.closed import LoopFunctions, loop_functions
from trueplant.loop.controller import Controller
from trueplant.lti.transfer import TransferMatrix


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """y = G u + v, u = Q (F r - y): a plant and the controllers around it, linearised about their operating point."""

    plant: TransferMatrix
    """G (n_y, n_u)"""
    controller: Controller
    """Q (n_u, n_y), without a pv_transform (`Controller.linearised`)."""

    @property
    def inputs(self) -> tuple[int, ...]:
        """The inputs that a controller writes, in order."""
        return tuple(sorted({i for i, _ in self.controller.entries}))

    def on(self, plant: TransferMatrix) -> LinearLoop:
        """The same controller on another plant."""
        return replace(self, plant=plant)

    def functions(self, s: ArrayLike) -> LoopFunctions:
        """S, T, Q S and S G at the complex points s (n_s,)."""
        return loop_functions(self.plant, self.controller, s)
