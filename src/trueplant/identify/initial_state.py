"""The unknown initial state of a record: free responses of the modes of a row, with their derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels


@dataclass(frozen=True, eq=False)
class Mode:
    """One free response (n,), its derivatives by the parameters that shape it, and how large it may be."""

    response: Array
    derivatives: Mapping[int, Array]
    largest: float


@dataclass(frozen=True, eq=False)
class Unknown:
    """The linear unknowns of a piece: an offset, free responses, jumps."""

    columns: Array
    """(n, n_z)"""
    largest: Array
    """(n_z,) amplitude that each may have. Elements may work against each other: what one of them does can be many
    times what PV shows."""
    derivatives: tuple[Mapping[int, Array], ...]
    """Of the free responses, which follow the offset."""
    size: int
    """Parameters of the row."""

    def gradient(self, weights: Array) -> Array:
        """Derivative (n, size) of `columns @ weights` by theta: only lags and pairs move the columns."""
        out = np.zeros((self.size, len(self.columns)))
        of_modes = weights[1 : 1 + len(self.derivatives)]
        for weight, derivatives in zip(of_modes, self.derivatives, strict=True):
            for index, derivative in derivatives.items():
                out[index] += weight * derivative
        return out.T


def lag_mode(tau: float, index: int, clock: Array, began: BoolArray, largest: float) -> Mode:
    """Free response of a lag, of which theta[index] is the time constant tau.

    `clock` (n,) is the time since the start, 0 before it; `began` (n,) is where it has begun.
    """
    decay, derivative = np.zeros(clock.size), np.zeros(clock.size)
    live = slice(int(np.argmax(began)), int(np.searchsorted(clock, levels.FREE_RESPONSE_GONE * tau, side="right")))
    decay[live] = np.where(began[live], np.exp(-clock[live] / tau), 0.0)
    derivative[live] = decay[live] * clock[live] / tau**2
    return Mode(decay, {index: derivative}, largest)


def pair_modes(omega0: float, zeta: float, index: int, clock: Array, began: BoolArray, largest: float) -> list[Mode]:
    """The two free responses of a complex pair, theta[index] and the next; derivatives by differences."""

    def both(w: float, z: float) -> Array:
        damping = np.where(began, np.exp(-min(z, 1.0) * w * clock), 0.0)
        angle = w * np.sqrt(max(1 - z**2, 0.0)) * clock
        return np.array([damping * np.cos(angle), damping * np.sin(angle)])

    base, step = both(omega0, zeta), 1e-6
    by_w = (both(omega0 * (1 + step), zeta) - base) / (step * omega0)
    by_z = (both(omega0, zeta * (1 + step)) - base) / (step * zeta)
    return [Mode(base[c], {index: by_w[c], index + 1: by_z[c]}, largest) for c in range(2)]
