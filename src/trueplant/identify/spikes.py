"""Wrong samples of PV that its own changes do not show: found by the prediction errors.

A wrong sample adds w (1, a1, a2, ...) to the prediction errors from its own on. A shock to the plant adds to one of
them alone, as what follows it follows from it. A sample is left out where being wrong explains more than it would by
chance in any sample, and more than a shock at it or within its reach (additive and innovational outliers, Fox 1972;
one after the other as in Chen and Liu 1993).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import chi2

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify import levels
from trueplant.identify.estimate import free_of_noise
from trueplant.identify.fit import RowFit, linearised
from trueplant.record.types import Segment

Spikes = Mapping[int, Sequence[tuple[int, float]]]
"""By output: experiment and time of each wrong sample."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """Prediction errors of one piece, 0 where there are none, with as many before and after as the noise model has."""

    number: int
    errors: Array
    """(n + order,)"""
    exist: BoolArray
    """(n + order,)"""


def find_spikes(fit: RowFit) -> list[tuple[int, float]]:
    """Experiment and time of the samples that are wrong."""
    if free_of_noise(fit):
        return []
    taps = np.concatenate([[1.0], fit.ar])
    pieces = list(_pieces(fit))
    wrong = [np.zeros(piece.exist.size - fit.ar.size, dtype=bool) for piece in pieces]
    count = sum(int(piece.exist.sum()) for piece in pieces)
    limit = float(chi2.isf(levels.SPIKE / max(count, 1), 1))
    for _ in range(levels.SPIKE_ROUNDS):
        left = max(count - sum(int(some.sum()) for some in wrong), 1)
        variance = sum(float(piece.errors @ piece.errors) for piece in pieces) / left
        more = [_likeliest(piece, taps, limit * variance) for piece in pieces]
        if not any(found.size for found in more):
            break
        pieces = [_without(piece, taps, found) for piece, found in zip(pieces, more, strict=True)]
        for some, found in zip(wrong, more, strict=True):
            some[found] = True
    return [place for piece, some in zip(pieces, wrong, strict=True) for place in _places(fit, piece.number, some)]


def without_spikes(segments: Sequence[Segment], spikes: Spikes) -> tuple[Segment, ...]:
    """The segments without the samples that are wrong."""
    if not spikes:
        return tuple(segments)
    out = []
    for segment in segments:
        y = segment.y.copy()
        for i, found in spikes.items():
            times = np.array([time for experiment, time in found if experiment == segment.experiment])
            index = np.round((times - segment.t[0]) / segment.h).astype(int)
            y[index[(index >= 0) & (index < len(segment))], i] = np.nan
        out.append(replace(segment, y=y))
    return tuple(out)


def _pieces(fit: RowFit) -> Iterator[_Piece]:
    order = fit.ar.size
    for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
        n = piece.output_errors.size
        errors, exist = np.zeros(n + order), np.zeros(n + order, dtype=bool)
        exist[order:n][piece.use] = True
        errors[exist] = piece.errors
        yield _Piece(piece.number, errors, exist)


def _explained(piece: _Piece, taps: Array) -> tuple[Array, Array]:
    """(n,) how wrong each sample would be, and by how much that lessens the sum of squares.

    Of a sample without an error of its own, after a gap, one cannot tell which of those before it is wrong.
    """
    along = np.correlate(piece.errors, taps, "valid")
    told = np.correlate(piece.exist.astype(float), taps**2, "valid")
    size = np.divide(along, told, out=np.zeros_like(along), where=piece.exist[: along.size])
    return size, size * along


def _likeliest(piece: _Piece, taps: Array, limit: float) -> IntArray:
    """Samples whose being wrong explains more than the limit, than a shock, and than any other within reach."""
    order = taps.size - 1
    _, explained = _explained(piece, taps)
    shocks = sliding_window_view(piece.errors**2, order + 1).max(axis=1)
    nearby = sliding_window_view(np.pad(explained, order), 2 * order + 1).max(axis=1)
    return np.flatnonzero((explained > limit) & (explained >= shocks) & (explained >= nearby))


def _without(piece: _Piece, taps: Array, found: IntArray) -> _Piece:
    """The piece with these samples put right."""
    sizes, errors = _explained(piece, taps)[0], piece.errors.copy()
    for k in found:
        errors[k : k + taps.size] -= sizes[k] * taps
    return replace(piece, errors=np.where(piece.exist, errors, 0.0))


def _places(fit: RowFit, number: int, wrong: BoolArray) -> Iterator[tuple[int, float]]:
    piece = fit.row.pieces[number]
    for time in piece.times[:: fit.row.stride][wrong]:
        yield piece.experiment, float(time)
