"""Whole plants drawn from what a record left uncertain, and what one controller does on all of them.

The elements of one output are estimated together, so they are drawn together; rows are independent of each other.
Stability of every drawn loop is counted by the phase of det(I + Q G) on a common grid, the peaks of each loop's S and T
(the others closed) are read from the diagonal of (I + Q G)^-1.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller
from trueplant.lti import Structure, TransferFunction, TransferMatrix
from trueplant.tune.response import axis, frequencies
from trueplant.tune.uncertain import responses

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]

_MOST_ROUNDS = 500
_PER_DECADE = 45
_TOP = 40.0
"""The grid ends at this multiple of the highest crossover that is looked at."""


@dataclass(frozen=True, eq=False)
class KnownRow:
    """What is known of some elements of one output: columns and structures, in order, with their parameters."""

    columns: tuple[int, ...]
    structures: tuple[Structure, ...]
    theta: Array
    """(n,) the parameters of all these elements, one after the other."""
    covariance: Array
    """(n, n)"""

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where each element's parameters are."""
        ends = np.cumsum([len(s.names) for s in self.structures])
        return tuple(slice(int(e) - len(s.names), int(e)) for e, s in zip(ends, self.structures, strict=True))


@dataclass(frozen=True, eq=False)
class UncertainPlant:
    """A plant, and what is uncertain about it. Elements that no row names are as in `nominal`."""

    nominal: TransferMatrix
    rows: Mapping[int, KnownRow]
    """By output."""
    steady: Collection[tuple[int, int]] = ()
    """(output, input) of the elements whose gain keeps its sign in every draw: those that a loop is closed over."""

    def first(self, n_u: int) -> UncertainPlant:
        """The first n_u columns alone, such as the inputs without measured disturbances."""
        rows = {}
        for i, row in self.rows.items():
            kept = [m for m, j in enumerate(row.columns) if j < n_u]
            if kept:
                index = np.concatenate([np.arange(row.theta.size)[row.slices[m]] for m in kept])
                columns = tuple(row.columns[m] for m in kept)
                structures = tuple(row.structures[m] for m in kept)
                rows[i] = KnownRow(columns, structures, row.theta[index], row.covariance[np.ix_(index, index)])
        elements = tuple(row[:n_u] for row in self.nominal.elements)
        steady = [(i, j) for i, j in self.steady if j < n_u]
        return UncertainPlant(TransferMatrix(elements, self.nominal.time_unit), rows, steady)

    def draw(self, count: int, seed: int) -> DrawnPlants:
        """Normal draws within the bounds of the structures. Raises LoopError where almost none is inside."""
        streams = np.random.default_rng(seed).spawn(len(self.nominal.elements))
        found: dict[tuple[int, int], tuple[Structure, Array]] = {}
        for i, row in self.rows.items():
            drawn = self._row(i, row, count, streams[i])
            for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
                found[i, j] = structure, drawn[:, part]
        return DrawnPlants(self.nominal, found, count)

    def _row(self, i: int, row: KnownRow, count: int, rng: np.random.Generator) -> Array:
        scale = np.sqrt(np.maximum(np.diag(row.covariance), 0.0))
        safe = np.where(scale > 0, scale, 1.0)
        values, vectors = np.linalg.eigh(row.covariance / np.outer(safe, safe))
        root = safe[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        bounds = [structure.bounds() for structure in row.structures]
        low, high = (np.concatenate(ends) for ends in zip(*bounds, strict=True))
        kept: list[Array] = []
        have = 0
        for _ in range(_MOST_ROUNDS):
            draws = row.theta + rng.standard_normal((count, row.theta.size)) @ root.T
            inside = np.all((draws >= low) & (draws <= high), axis=1)
            for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
                if (i, j) in self.steady:
                    gains = slice(part.start, part.start + structure.delayed)
                    inside &= np.sign(draws[:, gains].sum(axis=1)) == np.sign(row.theta[gains].sum())
            kept.append(draws[inside])
            have += int(inside.sum())
            if have >= count:
                return np.concatenate(kept)[:count]
        raise LoopError("almost no draw has a plant that can be: the parameters are far too uncertain to tune for")


@dataclass(frozen=True, eq=False)
class DrawnPlants:
    """Plants drawn at random; what was not drawn is as in `nominal`."""

    nominal: TransferMatrix
    parameters: Mapping[tuple[int, int], tuple[Structure, Array]]
    """By (output, input): structure and (count, n_p) parameters."""
    count: int

    def response(self, w: Array) -> ComplexArray:
        """(count, n_w, n_y, n_u) at j w."""
        nominal = self.nominal(axis(w))
        found = np.broadcast_to(nominal, (self.count, *nominal.shape)).copy()
        for (i, j), (structure, parameters) in self.parameters.items():
            found[:, :, i, j] = responses(structure, parameters, w)
        return found

    def plant(self, k: int) -> TransferMatrix:
        """The plant of draw k."""
        rows = [
            tuple(self._element(i, j, k, element) for j, element in enumerate(row))
            for i, row in enumerate(self.nominal.elements)
        ]
        return TransferMatrix(tuple(rows), self.nominal.time_unit)

    def _element(self, i: int, j: int, k: int, nominal: TransferFunction) -> TransferFunction:
        if (i, j) not in self.parameters:
            return nominal
        structure, parameters = self.parameters[i, j]
        return structure.transfer(parameters[k])


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
        return np.asarray(self.stable[:, None] & (np.maximum(self.Ms, self.Mt) <= limit * (1 + 1e-9)))

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


@njit(cache=True)
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
            rates += [1e-3 * abs(ki / kp)] if ki and kp else []
        else:
            size = np.abs(entry.tf.poles)
            rates += [1e-3 * float(size[size > 0].min())] if np.any(size > 0) else []
    scans = [entry.sample_time for entry in controller.entries.values() if entry.sample_time is not None]
    top = _TOP * crossover
    if scans:
        top = min(top, float(np.pi / min(scans)))
    low = 1e-2 * min(rates)
    w = np.geomspace(low, top, int(np.ceil(_PER_DECADE * np.log10(top / low))))
    # resonances of the plant, which `frequencies` has marked
    return np.unique(np.concatenate([w, usual[(usual > low) & (usual < top)][::10]]))
