"""Disk margin of all loops at once."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import UnstableLoop, UsageError
from trueplant.loop import Controller, unstable_poles
from trueplant.lti import TransferMatrix
from trueplant.robust.blocks import diagonal
from trueplant.robust.grid import on_axis, rates_of
from trueplant.robust.mu import mu
from trueplant.robust.peaks import Peak, loop_grid, sharpened


def multiloop_disk_margin(plant: TransferMatrix, controller: Controller, at: str = "input") -> Peak:
    """The disk margin a that all channels share when each changes on its own and at the same time.

    Every input (or output) may take any gain within (2 - a)/(2 + a)..(2 + a)/(2 - a), any phase change up to
    2 atan(a/2), or both, independently of the others: a = 1/max mu(S - I/2) with a diagonal Delta and S that of the
    channels (Seiler, Packard and Gahinet 2020). `lower` is guaranteed, `upper` is where the loss of stability is
    known. Raises UnstableLoop, UsageError.
    """
    if at not in ("input", "output"):
        raise UsageError(f'at must be "input" or "output", not {at!r}')
    poles = unstable_poles(plant, controller)
    if poles:
        raise UnstableLoop(f"the loop is unstable ({poles} unstable poles), so it has no margins")
    count = plant.shape[1] if at == "input" else plant.shape[0]
    eye = np.eye(count)

    def system(w: Array) -> ComplexArray:
        s = on_axis(w, plant)
        G, Q = plant(s), controller(s)
        around = Q @ G if at == "input" else G @ Q
        return np.asarray(np.linalg.inv(eye + around) - eye / 2, dtype=np.complex128)

    def bounds(M: ComplexArray) -> tuple[Array, Array]:
        result = mu(M, diagonal(count))
        return result.lower, result.upper

    w = loop_grid(plant, controller, rates_of(plant, controller))
    worst = sharpened(bounds, system, w, *bounds(system(w)))
    return Peak(1 / worst.upper, 1 / worst.lower, worst.frequency)
