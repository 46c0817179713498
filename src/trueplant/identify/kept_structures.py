"""Structures that the record rejects and that are kept all the same, because they were asked for.

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
from trueplant.lti.structure import Structure
from trueplant.result.budget import Source


def with_richer(
    estimate: OutputEstimate, richer: OutputEstimate, columns: Sequence[int], confidence: float
) -> OutputEstimate:
    """The estimate, no surer of the elements in these columns than the `richer` one of the same row lets it be."""
    size = estimate.theta.size
    shifts, spreads = np.zeros((2, size)), np.zeros((2, size, size))
    for column in columns:
        shift, variance = _apart(_moments(estimate, column), _moments(richer, column))
        part, structure = _element(estimate, column)
        along = directions(structure, estimate.theta[part])
        shifts[1, part] = shift @ along
        spreads[1, part, part] = (along.T * variance) @ along
    shares = np.array([1 - levels.RICHER_MEANT, levels.RICHER_MEANT])
    return averaged(estimate, shifts, shares, confidence, Source.STRUCTURE, spreads)


@dataclass(frozen=True, eq=False)
class _Moments:
    integrators: int
    values: Array
    """(2,) gain at rest (slope where the element integrates), and time to answer."""
    variances: Array
    """(2,)"""


def _apart(own: _Moments, other: _Moments) -> tuple[Array, Array]:
    """How far the other element's gain and time are away, and by how much less both are known (2,)."""
    if own.integrators != other.integrators:
        return np.zeros(2), own.values**2
    return other.values - own.values, np.maximum(other.variances - own.variances, 0.0)


def _moments(estimate: OutputEstimate, column: int) -> _Moments:
    """With what the prior adds to the covariance taken off: it keeps finite what the record does not tell."""
    part, structure = _element(estimate, column)
    values, derivatives = moments(structure, estimate.theta[part])
    by_data = np.maximum(estimate.fit.standard_errors_by_data[part] ** 2 - np.diag(estimate.covariance)[part], 0.0)
    covariance = estimate.covariance[part, part] + np.diag(by_data)
    return _Moments(structure.integrators, values, np.einsum("ij,jk,ik->i", derivatives, covariance, derivatives))


def _element(estimate: OutputEstimate, column: int) -> tuple[slice, Structure]:
    """Its place in theta, and its structure."""
    m = [spec.column for spec in estimate.row.specs].index(column)
    return estimate.row.slices[m], estimate.row.specs[m].structure
