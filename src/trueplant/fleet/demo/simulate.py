"""A loop of the demo site over weeks: its plant may change while it runs, its valve may stick, hands may be on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.compiled import compiled
from trueplant.loop.valve import stem


@dataclass(frozen=True)
class Loop:
    """n loops that share a plant, at N instants that are `h` apart; lags and dead times in the unit of `h`."""

    h: float
    gain: Array
    """(N, n, n); of an integrating element its slope."""
    lag: Array
    """(n, n); 0: it integrates."""
    dead_time: Array
    """(n, n)"""
    Kc: Array
    """(n,)"""
    Ti: Array
    """(n,)"""
    stick: Array
    """(n,) of each valve, in units of OP."""
    slave: float
    """Lag of the slave loops below; 0: none."""


def simulate(loop: Loop, r: Array, automatic: NDArray[np.bool_], d: Array) -> tuple[Array, Array, Array]:
    """PV, OP and what the plant is given of OP, each (N, n), from set-points r and disturbances d of PV, both (N, n).

    Around 0, exact for what is held between samples; the PI controllers are in velocity form (backward Euler).
    """
    integrating = loop.lag == 0
    pole = np.where(integrating, 1.0, np.exp(-loop.h / np.where(integrating, 1.0, loop.lag)))
    slave = 0.0 if loop.slave == 0 else float(np.exp(-loop.h / loop.slave))
    # what is left of the slave's own start when the master's lag has passed it on, over one sample
    if loop.slave == 0:
        passed = np.zeros_like(pole)
    else:
        rate = np.where(integrating, 0.0, 1 / np.where(integrating, 1.0, loop.lag))
        passed = np.where(integrating, 1.0, rate) * (slave - pole) / (rate - 1 / loop.slave)
    dead = np.round(loop.dead_time / loop.h)
    elements = np.stack([pole, np.where(integrating, loop.h, 1 - pole), dead, passed])
    laws = np.stack([loop.Kc, loop.h / loop.Ti, loop.stick, np.full(loop.Kc.size, slave)])
    y, u, v = _run(r, automatic, d, loop.gain, elements, laws)
    return y, u, v


@compiled
def _run(
    r: Array, automatic: NDArray[np.bool_], d: Array, gain: Array, elements: Array, laws: Array
) -> tuple[Array, Array, Array]:
    samples, n = r.shape
    y, u, v = np.zeros((samples, n)), np.zeros((samples, n)), np.zeros((samples, n))
    x, position, error = np.zeros((n, n)), np.zeros((samples, n)), np.zeros(n)
    for k in range(samples):
        for i in range(n):
            y[k, i] = d[k, i]
            for j in range(n):
                y[k, i] += x[i, j]
        for j in range(n):
            now = r[k, j] - y[k, j]
            before = u[k - 1, j] if k > 0 else 0.0
            u[k, j] = before
            if automatic[k, j]:
                u[k, j] += laws[0, j] * (now - error[j] + laws[1, j] * now)
            error[j] = now
            position[k, j] = stem(u[k, j], position[k - 1, j] if k > 0 else 0.0, 0.0, laws[2, j], -np.inf, np.inf)
            if laws[3, j] == 0:
                v[k, j] = position[k, j]
            elif k > 0:
                v[k, j] = laws[3, j] * v[k - 1, j] + (1 - laws[3, j]) * position[k - 1, j]
        for i in range(n):
            for j in range(n):
                back = k - int(elements[2, i, j])
                given = position[back, j] if back >= 0 else 0.0
                late = v[back, j] - given if back >= 0 else 0.0
                x[i, j] *= elements[0, i, j]
                x[i, j] += gain[k, i, j] * (elements[1, i, j] * given + elements[3, i, j] * late)
    return y, u, v


@compiled
def kept(values: Array, band: float) -> NDArray[np.bool_]:
    """Which of the samples (N,) a historian stores that leaves out what is within a band of the last that it stored."""
    out = np.zeros(values.size, dtype=np.bool_)
    last = np.inf
    for k in range(values.size):
        if abs(values[k] - last) > band:
            out[k] = True
            last = values[k]
    return out
