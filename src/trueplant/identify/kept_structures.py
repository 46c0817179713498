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
        (structure, p, covariance), other = _element(estimate, column), _element(richer, column)
        shift, variance = _apart(_moments(structure, p, covariance), _moments(*other))
        part, directions = _place(estimate, column), _directions(structure, p)
        shifts[1, part] = shift @ directions
        spreads[1, part, part] = (directions.T * variance) @ directions
    shares = np.array([1 - levels.RICHER_MEANT, levels.RICHER_MEANT])
    return averaged(estimate, shifts, shares, confidence, Source.STRUCTURE, spreads)


@dataclass(frozen=True, eq=False)
class _Moments:
    integrators: int
    gain: float
    """At rest; the slope where the element integrates."""
    time: float
    """To answer: lags and dead times less leads, its mean residence time."""
    variances: Array
    """(2,) of the logarithm of the gain, and of the time."""


def _apart(own: _Moments, other: _Moments) -> tuple[Array, Array]:
    """How far the other element is away in its relative gain and its time, and by how much less both are known (2,)."""
    if own.integrators != other.integrators:
        return np.zeros(2), np.array([1.0, own.time**2])
    ratio = other.gain / own.gain
    variances = other.variances * [ratio**2, 1.0]
    return np.array([ratio - 1, other.time - own.time]), np.maximum(variances - own.variances, 0.0)


def _moments(structure: Structure, p: Array, covariance: Array) -> _Moments:
    gain, time, by_gain, by_time = _values(structure, p)
    variances = [by @ covariance @ by for by in (by_gain / gain, by_time)]
    return _Moments(structure.integrators, gain, time, np.array(variances))


def _values(structure: Structure, p: Array) -> tuple[float, float, Array, Array]:
    """Gain and time of an element, and their derivatives by its parameters."""
    gains, dead_times = p[structure.is_gain], structure.dead_times(p)
    frequency, damping = p[structure.is_frequency], p[structure.is_damping]
    gain = float(gains.sum())
    delay = float(gains @ dead_times) / gain
    time = float(p[structure.is_lag].sum() + np.sum(2 * damping / frequency) - p[structure.is_lead].sum() + delay)
    by_time = structure.is_lag.astype(float) - structure.is_lead
    by_time[structure.is_gain] = (dead_times - delay) / gain
    by_time[structure.is_frequency], by_time[structure.is_damping] = -2 * damping / frequency**2, 2 / frequency
    if structure.has_dead_time:
        by_time[structure.is_dead_time] = gains / gain
    return gain, time, structure.is_gain.astype(float), by_time


def _directions(structure: Structure, p: Array) -> Array:
    """(2, n_p) how the parameters move with the relative gain, and with the time: by lags, or else by dead time."""
    slower = np.where(structure.is_lag, p, 0.0) - np.where(structure.is_frequency, p, 0.0)
    lags = float(p[structure.is_lag].sum() + np.sum(2 * p[structure.is_damping] / p[structure.is_frequency]))
    by_time = slower / lags if lags > 0 else structure.is_dead_time.astype(float)
    return np.array([np.where(structure.is_gain, p, 0.0), by_time])


def _place(estimate: OutputEstimate, column: int) -> slice:
    return next(
        part for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True) if spec.column == column
    )


def _element(estimate: OutputEstimate, column: int) -> tuple[Structure, Array, Array]:
    """Structure, parameters and covariance, which the prior keeps finite and here does not."""
    part = _place(estimate, column)
    structure = next(spec.structure for spec in estimate.row.specs if spec.column == column)
    by_data = np.maximum(estimate.fit.standard_errors_by_data[part] ** 2 - np.diag(estimate.covariance)[part], 0.0)
    return structure, estimate.theta[part], estimate.covariance[part, part] + np.diag(by_data)
