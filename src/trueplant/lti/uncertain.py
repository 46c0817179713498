"""A plant with what a record left uncertain of it, and whole plants drawn from that.

The elements of one output are estimated together, so they are drawn together; rows are independent of each other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.lti import levels
from trueplant.lti.structure import Structure
from trueplant.lti.transfer import TransferFunction, TransferMatrix


@dataclass(frozen=True, eq=False)
class KnownRow:
    """What is known of some elements of one output: columns and structures, in order, with their parameters."""

    columns: tuple[int, ...]
    structures: tuple[Structure, ...]
    theta: Array
    """(n,) the parameters of all these elements, one after the other."""
    covariance: Array
    """(n, n)"""
    unknown: tuple[int, ...] = ()
    """Places in theta of what the data do not answer: held where they are in every draw."""

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

    @property
    def varying(self) -> int:
        """How many parameters are uncertain."""
        return sum(int(np.sum(np.diag(row.covariance) > 0)) for row in self.rows.values())

    def keeping_signs(self, places: Collection[tuple[int, int]]) -> UncertainPlant:
        """The same plant, of which only draws count that keep the sign of these elements' gains: (output, input)."""
        return replace(self, steady=tuple(places))

    def first(self, n_u: int) -> UncertainPlant:
        """The first n_u columns alone, such as the inputs without measured disturbances."""
        rows = {}
        for i, row in self.rows.items():
            kept = [m for m, j in enumerate(row.columns) if j < n_u]
            if kept:
                index = np.concatenate([np.arange(row.theta.size)[row.slices[m]] for m in kept])
                columns = tuple(row.columns[m] for m in kept)
                structures = tuple(row.structures[m] for m in kept)
                unknown = tuple(int(place) for place, k in enumerate(index) if k in row.unknown)
                covariance = row.covariance[np.ix_(index, index)]
                rows[i] = KnownRow(columns, structures, row.theta[index], covariance, unknown)
        steady = [(i, j) for i, j in self.steady if j < n_u]
        return UncertainPlant(self.nominal.columns(0, n_u), rows, steady)

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
        for _ in range(levels.MOST_DRAW_ROUNDS):
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

    def response(self, w: Array | ComplexArray) -> ComplexArray:
        """(count, n_w, n_y, n_u) at j w; a complex w lies off the axis."""
        nominal = self.nominal(1j * w)
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


def responses(structure: Structure, parameters: Array, w: Array | ComplexArray) -> ComplexArray:
    """G(j w) (n_plants, n_w) of plants with the parameters (n_plants, n_p)."""
    s = 1j * w
    value = np.ones((len(parameters), w.size), dtype=np.complex128) / s**structure.integrators
    columns = iter(parameters.T[:, :, None])
    gains = [next(columns) for _ in range(structure.delayed)]
    for _ in range(structure.lags):
        value /= next(columns) * s + 1
    for _ in range(structure.pairs):
        omega, zeta = next(columns), next(columns)
        value /= (s / omega) ** 2 + 2 * zeta * s / omega + 1
    for _ in range(structure.leads):
        value *= next(columns) * s + 1
    delays = [next(columns) if structure.has_dead_time else np.zeros((1, 1)) for _ in range(structure.delayed)]
    return np.asarray(value * sum(g * np.exp(-d * s) for g, d in zip(gains, delays, strict=True)))
