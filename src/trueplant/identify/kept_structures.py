"""Structures that are kept though the record rejects them, as they were asked for, or leaves open whether they suffice.

The parameters of a structure that is too simple are those of whatever comes nearest to the plant under the noise model
that goes with it: as sure as the noise lets them be, and off. What it shares with the richer one that the record asks
for is a gain at rest and a time to answer, the first two moments of an impulse response. Where these differ the answer
counts both, as either may be meant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.moments import directions, moments
from trueplant.identify.output import OutputEstimate, averaged
from trueplant.identify.row import Row
from trueplant.result.budget import Source


def with_richer(estimate: OutputEstimate, richer: OutputEstimate, confidence: float) -> OutputEstimate:
    """The estimate, no surer of any element than the `richer` one of the same row lets it be."""
    return counting(estimate, _by_data(estimate), [_by_data(richer)], np.array([levels.RICHER_MEANT]), confidence)


@dataclass(frozen=True, eq=False)
class Told:
    """What a fit says of the gain and the time of an element."""

    integrators: int
    values: Array
    """(2,) gain at rest (slope where the element integrates), and time to answer."""
    variances: Array
    """(2,)"""

    @classmethod
    def of(cls, row: Row, theta: Array, covariance: Array) -> list[Told]:
        """Of each element of the row, at theta (size,) with its covariance (size, size)."""
        told = []
        for spec, part in zip(row.specs, row.slices, strict=True):
            values, by = moments(spec.structure, theta[part])
            variances = np.einsum("ij,jk,ik->i", by, covariance[part, part], by)
            told.append(cls(spec.structure.integrators, values, variances))
        return told


def counting(
    estimate: OutputEstimate, own: Sequence[Told], richer: Sequence[Sequence[Told]], shares: Array, confidence: float
) -> OutputEstimate:
    """The estimate, where the row is one of several richer ones with the probabilities `shares` (n,).

    `own` and each of `richer` have what a row tells of its elements, in order: of those that keep their structure too,
    as what one of them lacked the others may have taken on.
    """
    size = estimate.theta.size
    shifts, spreads = np.zeros((1 + len(richer), size)), np.zeros((1 + len(richer), size, size))
    for m, (spec, part) in enumerate(zip(estimate.row.specs, estimate.row.slices, strict=True)):
        along = directions(spec.structure, estimate.theta[part])
        for k, row in enumerate(richer, start=1):
            shift, variance = _apart(own[m], row[m])
            shifts[k, part] = shift @ along
            spreads[k, part, part] = (along.T * variance) @ along
    probabilities = np.array([1 - shares.sum(), *shares])
    return averaged(estimate, shifts, probabilities, confidence, Source.STRUCTURE, spreads)


def _apart(own: Told, richer: Told) -> tuple[Array, Array]:
    """How far the richer one's gain and time are away, and by how much less both are known (2,)."""
    if own.integrators != richer.integrators:
        return np.zeros(2), own.values**2
    return richer.values - own.values, np.maximum(richer.variances - own.variances, 0.0)


def _by_data(estimate: OutputEstimate) -> list[Told]:
    """With what the prior adds to the covariance taken off: it keeps finite what the record does not tell."""
    by_data = np.maximum(estimate.fit.standard_errors_by_data**2 - np.diag(estimate.covariance), 0.0)
    return Told.of(estimate.row, estimate.theta, estimate.covariance + np.diag(by_data))
