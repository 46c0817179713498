"""Structures that are kept though the record rejects them, as they were asked for, or leaves open whether they suffice.

The parameters of a structure that is too simple are those of whatever comes nearest to the plant under the noise model
that goes with it: as sure as the noise lets them be, and off. What it shares with the richer one that the record asks
for is a gain at rest and a time to answer, the first two moments of an impulse response. Where these differ the answer
counts both, as either may be meant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.moments import directions, moments
from trueplant.identify.output import OutputEstimate, averaged
from trueplant.identify.row import Row
from trueplant.result.budget import Source


def with_richer(
    estimate: OutputEstimate, richer: OutputEstimate, columns: Sequence[int], confidence: float
) -> OutputEstimate:
    """The estimate, no surer of the elements in these columns than the `richer` one of the same row lets it be."""
    apart = {
        m: (_by_data(estimate, m), _by_data(richer, [one.column for one in richer.row.specs].index(spec.column)))
        for m, spec in enumerate(estimate.row.specs)
        if spec.column in columns
    }
    return counting(estimate, apart, levels.RICHER_MEANT, confidence)


@dataclass(frozen=True, eq=False)
class Told:
    """What a fit says of the gain and the time of an element."""

    integrators: int
    values: Array
    """(2,) gain at rest (slope where the element integrates), and time to answer."""
    variances: Array
    """(2,)"""

    @classmethod
    def of(cls, row: Row, m: int, theta: Array, covariance: Array) -> Told:
        """Of element m of the row, at theta (size,) with its covariance (size, size)."""
        structure, part = row.specs[m].structure, row.slices[m]
        values, by = moments(structure, theta[part])
        return cls(structure.integrators, values, np.einsum("ij,jk,ik->i", by, covariance[part, part], by))


def counting(
    estimate: OutputEstimate, apart: Mapping[int, tuple[Told, Told]], share: float, confidence: float
) -> OutputEstimate:
    """The estimate, where elements are of richer structures with the probability `share`.

    `apart` has what the own structure and the richer one tell of each of them, by its place in the row.
    """
    size = estimate.theta.size
    shifts, spreads = np.zeros((2, size)), np.zeros((2, size, size))
    for m, (own, richer) in apart.items():
        shift, variance = _apart(own, richer)
        part = estimate.row.slices[m]
        along = directions(estimate.row.specs[m].structure, estimate.theta[part])
        shifts[1, part] = shift @ along
        spreads[1, part, part] = (along.T * variance) @ along
    return averaged(estimate, shifts, np.array([1 - share, share]), confidence, Source.STRUCTURE, spreads)


def _apart(own: Told, richer: Told) -> tuple[Array, Array]:
    """How far the richer one's gain and time are away, and by how much less both are known (2,)."""
    if own.integrators != richer.integrators:
        return np.zeros(2), own.values**2
    return richer.values - own.values, np.maximum(richer.variances - own.variances, 0.0)


def _by_data(estimate: OutputEstimate, m: int) -> Told:
    """With what the prior adds to the covariance taken off: it keeps finite what the record does not tell."""
    by_data = np.maximum(estimate.fit.standard_errors_by_data**2 - np.diag(estimate.covariance), 0.0)
    return Told.of(estimate.row, m, estimate.theta, estimate.covariance + np.diag(by_data))
