"""What one controller does on many plants drawn from what a record left uncertain.

Stability of every drawn loop is counted by the phase of det(I + Q G) on a common grid, the peaks of each loop's S and T
(the others closed) are read from the diagonal of (I + Q G)^-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.compiled import compiled
from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix
from trueplant.tune import levels
from trueplant.tune.response import frequencies


@dataclass(frozen=True, eq=False)
class Peaks:
    """What one controller does on many plants."""

    stable: BoolArray
    """(count,)"""
    Ms: Array
    """(count, n_u) peak of |S| of the loop broken at each input, the others closed; meaningless where unstable."""
    Mt: Array
    """(count, n_u) the same of |T|."""

    def within(self, limit: float) -> BoolArray:
        """(count, n_u): stable, and both peaks of this loop no higher than the limit."""
        return np.asarray(self.stable[:, None] & (np.maximum(self.Ms, self.Mt) <= limit * (1 + levels.ROUNDING)))

    @cached_property
    def share_stable(self) -> float:
        """Of all plants."""
        return float(np.mean(self.stable))


def peaks(response: ComplexArray, law: ComplexArray, w: Array, unstable: int = 0) -> Peaks:
    """Stability and peaks of the loops of G (count, n_w, n_y, n_u) and Q (n_w, n_u, n_y) on the grid w.

    The plants must be stable but for integrators; `unstable` is the number of unstable poles of the controller. The
    grid must be fine enough to follow det(I + Q G), reach down to where its integrators rule and up to where the loop
    gain is small: see `common_grid`.
    """
    start, order, ms, mt = _peaks(np.ascontiguousarray(response), np.ascontiguousarray(law), np.log(w))
    expected = -np.pi / 2 * np.round(order) - np.pi * unstable
    return Peaks(np.asarray(np.abs(start - expected) < np.pi / 2), ms, mt)


@compiled
def _peaks(response: ComplexArray, law: ComplexArray, log_w: Array) -> tuple[Array, Array, Array, Array]:
    count, n_w, n_y, n_u = response.shape
    start, order = np.empty(count), np.empty(count)
    ms, mt = np.zeros((count, n_u)), np.zeros((count, n_u))
    a = np.empty((n_u, n_u), dtype=np.complex128)
    inverse = np.empty((n_u, n_u), dtype=np.complex128)
    for p in range(count):
        total, before, first = 0.0, 1.0 + 0.0j, 0.0
        for k in range(n_w):
            for i in range(n_u):
                for j in range(n_u):
                    value = 1.0 + 0.0j if i == j else 0.0j
                    for m in range(n_y):
                        value += law[k, i, m] * response[p, k, m, j]
                    a[i, j] = value
                    inverse[i, j] = 1.0 if i == j else 0.0
            # Gauss and Jordan with row pivots; the determinant falls out on the way
            determinant = 1.0 + 0.0j
            for c in range(n_u):
                pivot = c
                for i in range(c + 1, n_u):
                    if abs(a[i, c]) > abs(a[pivot, c]):
                        pivot = i
                if pivot != c:
                    determinant = -determinant
                    for j in range(n_u):
                        a[c, j], a[pivot, j] = a[pivot, j], a[c, j]
                        inverse[c, j], inverse[pivot, j] = inverse[pivot, j], inverse[c, j]
                scale = a[c, c]
                determinant *= scale
                if scale == 0:
                    break
                for j in range(n_u):
                    a[c, j] /= scale
                    inverse[c, j] /= scale
                for i in range(n_u):
                    factor = a[i, c]
                    if i != c and factor != 0:
                        for j in range(n_u):
                            a[i, j] -= factor * a[c, j]
                            inverse[i, j] -= factor * inverse[c, j]
            for i in range(n_u):
                ms[p, i] = max(ms[p, i], abs(inverse[i, i]))
                mt[p, i] = max(mt[p, i], abs(1 - inverse[i, i]))
            if determinant == 0:
                ms[p, :] = np.inf
                determinant = 1e-300 + 0.0j
            if k == 0:
                first = np.log(abs(determinant))
            else:
                total += np.angle(determinant / before)
            if k == 1:
                order[p] = -(np.log(abs(determinant)) - first) / (log_w[1] - log_w[0])
            before = determinant
        start[p] = np.angle(before) - total
    return start, order, ms, mt


def common_grid(plant: TransferMatrix, controller: Controller, crossover: float) -> Array:
    """Frequencies (n_w,) for `peaks`, for this plant and those near it, with crossovers up to the one given.

    Ends at half the scan rate where the controller is sampled.
    """
    elements = [element for row in plant.elements for element in row if not element.is_zero]
    usual = frequencies(elements)
    rates = [usual[0]]
    for entry in controller.entries.values():
        if isinstance(entry, PID):
            kp, ki, _, _ = entry.parallel
            rates += [levels.DRAWN_BELOW_RESET * abs(ki / kp)] if ki and kp else []
        else:
            size = np.abs(entry.tf.poles)
            rates += [levels.DRAWN_BELOW_RESET * float(size[size > 0].min())] if np.any(size > 0) else []
    scans = [entry.sample_time for entry in controller.entries.values() if entry.sample_time is not None]
    top = levels.DRAWN_TOP * crossover
    if scans:
        top = min(top, float(np.pi / min(scans)))
    low = levels.DRAWN_BELOW * min(rates)
    w = np.geomspace(low, top, int(np.ceil(levels.DRAWN_PER_DECADE * np.log10(top / low))))
    # resonances of the plant, which `frequencies` has marked
    return np.unique(np.concatenate([w, usual[(usual > low) & (usual < top)][:: levels.EVERY_RESONANCE]]))
