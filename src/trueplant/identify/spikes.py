"""Samples at which PV leaves its course for a moment: a spike of its sensor, not a disturbance.

A disturbance goes on as the noise model says, and leaves one large prediction error. A spike is gone at the next
sample, and leaves the coefficients of the noise model, one after the other (Fox 1972; Chen and Liu 1993). Such samples
are looked for in turn with plant and noise model. Each then counts for as much as all others say of it, and costs a
degree of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import toeplitz
from scipy.stats import chi2

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify import levels
from trueplant.identify.estimate import free_of_noise, with_own_noise
from trueplant.identify.fit import RowFit, residuals
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
from trueplant.record import levels as record_levels
from trueplant.record.sensor import quantum
from trueplant.record.types import Segment


def without_spikes(fit: RowFit) -> RowFit:
    """The fit beside the spikes of its PV, with a noise model of its own; the fit itself where none are found."""
    if free_of_noise(fit):
        return fit
    rounding = [_rounding(piece, fit.row.stride) for piece in fit.row.pieces]
    best, known = fit, _sizes(fit.row)
    for _ in range(levels.SPIKE_ROUNDS):
        every = zip(residuals(best), known, rounding, strict=True)
        sizes = [_Errors(e, best.ar, least).sizes(own) for (_, e, _), own, least in every]
        if all(np.array_equal(own != 0, before != 0) for own, before in zip(sizes, known, strict=True)):
            break
        best, known = with_own_noise(replace(best, row=_beside(best.row, sizes)), levels.TRIED_STEPS), sizes
    return best


def set_aside(segments: Sequence[Segment], output: int, fit: RowFit) -> tuple[Segment, ...]:
    """The segments with the spikes of a fit of this output taken off, and none but these."""
    changed = []
    for segment in segments:
        before = segment.taken_off
        spikes = before.copy()
        spikes[:, output] = 0.0
        for piece in fit.row.pieces:
            if piece.spikes is not None and piece.experiment == segment.experiment:
                at = np.flatnonzero(piece.spikes)
                places = np.rint((piece.times[at] - segment.t[0]) / segment.h).astype(int)
                here = (places >= 0) & (places < len(segment))
                spikes[places[here], output] = piece.spikes[at[here]]
        changed.append(replace(segment, y=segment.y + before - spikes, spikes=spikes if spikes.any() else None))
    return tuple(changed)


def _sizes(row: Row) -> list[Array]:
    """(n,) of each piece at the strided samples: what is taken off PV, 0 at most of them."""
    every = [np.zeros(piece.y.size) if piece.spikes is None else piece.spikes for piece in row.pieces]
    return [sizes[:: row.stride] for sizes in every]


def _beside(row: Row, sizes: Sequence[Array]) -> Row:
    """The row with spikes of these sizes instead of those that it has."""
    pieces = []
    for piece, before, own in zip(row.pieces, _sizes(row), sizes, strict=True):
        y, spikes = piece.y.copy(), np.zeros(piece.y.size)
        y[:: row.stride] += before - own
        spikes[:: row.stride] = own
        pieces.append(replace(piece, y=y, spikes=spikes if spikes.any() else None))
    return replace(row, pieces=tuple(pieces))


def _rounding(piece: Piece, stride: int) -> float:
    """Standard error of PV by the digits that were recorded."""
    return quantum(piece.y[piece.valid][::stride]) / float(np.sqrt(12))


@dataclass(frozen=True, eq=False)
class _Errors:
    """The prediction errors of a piece, and the spikes that show in them."""

    errors: Array
    """(n,) NaN where there are none."""
    ar: Array
    rounding: float

    @cached_property
    def there(self) -> BoolArray:
        return np.isfinite(self.errors)

    @cached_property
    def e(self) -> Array:
        return np.where(self.there, self.errors, 0.0)

    @cached_property
    def taps(self) -> Array:
        return np.concatenate([[1.0], self.ar])

    @cached_property
    def usual(self) -> float:
        """Standard deviation of the errors, whatever a few of them are."""
        return max(_spread(self.errors), self.rounding)

    @cached_property
    def around(self) -> Array:
        """(n, m) the errors about each sample, NaN beyond the ends."""
        beyond = np.full(levels.SPIKE_AROUND, np.nan)
        return sliding_window_view(np.concatenate([beyond, self.errors, beyond]), 2 * beyond.size + 1)

    def scales(self, places: IntArray) -> Array:
        """(n,) standard deviations of the errors about these places, the usual one where that is larger."""
        return np.maximum([_spread(errors) for errors in self.around[places]], self.usual)

    def by_chance(self, m: int) -> float:
        """What m samples in a row gain in -2 log likelihood by chance, over all that are tried."""
        tried = levels.SPIKE_SAMPLES * max(int(self.there.sum()), 1)
        return float(chi2.isf(levels.SPIKE / tried, m))

    def sizes(self, known: Array) -> Array:
        """(n,) of the spikes: those taken off already, with `known` sizes (n,), and those found besides."""
        places = np.union1d(np.flatnonzero(known), self._found())
        sizes = np.zeros(known.size)
        for near in np.split(places, np.flatnonzero(np.diff(places) >= self.taps.size) + 1):
            if near.size:
                self._put(sizes, near, known[near])
        return sizes

    def _put(self, sizes: Array, places: IntArray, known: Array) -> None:
        """Neighbouring spikes into `sizes` (n,), as far as each of them stands beside the others."""
        after = np.arange(places[0], min(places[-1] + self.taps.size, self.e.size))
        lag = after[:, None] - places
        reached = (lag >= 0) & (lag < self.taps.size) & self.there[after][:, None]
        moved = np.where(reached, self.taps[np.clip(lag, 0, self.taps.size - 1)], 0.0)
        raw, least = self.e[after] + moved @ known, self.by_chance(1)
        while places.size:
            variances = inverse(moved.T @ moved)
            own = variances @ (moved.T @ raw)
            told = own**2 / np.diag(variances) / self.scales(places) ** 2
            weakest = int(np.argmin(told))
            if told[weakest] > least:
                sizes[places] = own
                return
            places, moved = np.delete(places, weakest), np.delete(moved, weakest, axis=1)

    def _found(self) -> IntArray:
        """The samples of further spikes, none within the noise model's reach of one that shows more."""
        shown, length = np.zeros(self.e.size), np.zeros(self.e.size, dtype=int)
        for m in range(1, levels.SPIKE_SAMPLES + 1):
            gained = self._gained(m)
            at = np.flatnonzero(gained > self.by_chance(m) * self.usual**2)
            variances = self.scales(at) ** 2
            more = gained[at] / variances - self.by_chance(m)
            beyond = gained[at] - self._by_disturbances(at, m)
            told = (more > shown[at]) & (beyond > -2 * np.log(levels.SPIKE) * variances)
            shown[at[told]], length[at[told]] = more[told], m
        taken: list[int] = []
        reach = self.taps.size + levels.SPIKE_SAMPLES
        for s in map(int, np.argsort(-shown, kind="stable")[: np.count_nonzero(shown)]):
            if length[s]:
                taken += range(s, s + int(length[s]))
                length[max(s - reach, 0) : s + reach] = 0
        return np.array(taken, dtype=np.intp)

    def _gained(self, m: int) -> Array:
        """(n,) by how much the squares of the errors fall with m spikes from each sample on."""
        own = np.correlate(self.taps, self.taps, "full")[self.taps.size - 1 :]
        gram = toeplitz(np.concatenate([own, np.zeros(m)])[:m])
        along = np.correlate(np.concatenate([self.e, np.zeros(self.taps.size + m)]), self.taps, "valid")
        told = np.stack([along[i : i + self.e.size] for i in range(m)])
        return np.asarray(np.sum(told * np.linalg.solve(gram, told), axis=0))

    def _by_disturbances(self, places: IntArray, m: int) -> Array:
        """(n,) by how much they fall with the m disturbances at most that explain most where such spikes are seen."""
        seen = self.taps.size - 1 + m
        squares = sliding_window_view(np.concatenate([self.e**2, np.zeros(seen)]), seen)[places]
        return np.asarray(np.sum(np.partition(squares, seen - m, axis=1)[:, seen - m :], axis=1))


def _spread(errors: Array) -> float:
    """Standard deviation of normal errors by the median of their sizes; 0 where there are none."""
    there = errors[np.isfinite(errors)]
    return record_levels.NORMAL_MAD * float(np.median(np.abs(there))) if there.size else 0.0
