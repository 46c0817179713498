"""What loads that step would explain of prediction errors, at every instant at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, Whitening
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.noise import whiten
from trueplant.record.types import Load


@dataclass(frozen=True)
class Gain:
    """A load, and what it gains in -2 log likelihood."""

    experiment: int
    load: Load
    gain: float


def likeliest_load(fits: Mapping[int, RowFit], cost: float) -> Gain | None:
    """The load that gains most over all outputs, of one size in all of them; None where none gains more than `cost`.

    To first order, plant and noise models renewed. A load shows in many errors: single samples that explain more than
    any load, misread or hit by an error of their own, are taken out first.
    """
    scans = [_Scan(fit) for fit in fits.values()]
    best: Gain | None = None
    for _ in range(levels.LOAD_ROUNDS):
        best = _best(scans)
        least = cost if best is None else max(best.gain, cost)
        if not sum(scan.without_single(least) for scan in scans):  # of every scan, so not any()
            break
    return best if best is not None and best.gain > cost else None


def _best(scans: list[_Scan]) -> Gain | None:
    """The likeliest load of all instants and inputs."""
    seen: dict[tuple[int, int], list[_Seen]] = {}
    for scan in scans:
        for one in scan.seen():
            seen.setdefault((one.experiment, one.column), []).append(one)
    found: list[Gain] = []
    for (experiment, column), ones in seen.items():
        first, h = min(one.start for one in ones), min(one.h for one in ones)
        places = [np.round((one.start - first) / h + np.arange(one.left.size) * one.h / h).astype(int) for one in ones]
        products, left = np.zeros((2, 1 + max(int(place[-1]) for place in places)))
        for one, place in zip(ones, places, strict=True):
            products[place] += one.products
            left[place] += one.left
        gains = np.divide(products**2, left, out=np.zeros_like(products), where=left > 0)
        at = int(np.argmax(gains))
        found.append(Gain(experiment, Load(column, first + at * h), float(gains[at])))
    return max(found, key=lambda one: one.gain, default=None)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Loads like one input as one piece sees them."""

    experiment: int
    column: int
    start: float
    h: float
    """Between instants."""
    products: Array
    """(n,) with the errors, of a load of size 1 from each instant on; in units of their variance."""
    left: Array
    """(n,) squares of what it moves beyond what is explained otherwise, likewise; 0 where it cannot be told."""


class _Scan:
    """One fit; its prediction errors are those that are left."""

    def __init__(self, fit: RowFit) -> None:
        self._fit = fit
        found = enumerate(Whitening.of(fit))
        every = [(k, whitening) for k, whitening in found if whitening is not None]
        free = np.concatenate([fit.free, np.ones(fit.ar.size, dtype=bool)])
        known = [whitening.jacobian[free] for _, whitening in every]
        basis = orthonormal(np.hstack(known).T) if known else np.zeros((0, 0))
        e = np.concatenate([np.zeros(0), *(whitening.errors for _, whitening in every)])
        self._errors = e - basis @ (basis.T @ e)
        self._pieces, first = [], 0
        for k, whitening in every:
            part = slice(first, first + whitening.errors.size)
            first = part.stop
            self._pieces.append(_Piece(fit, k, whitening, part, np.vstack([basis[part].T, whitening.basis.T])))

    @property
    def _variance(self) -> float:
        return max(float(self._errors @ self._errors) / self._fit.left, np.finfo(float).tiny)

    def seen(self) -> list[_Seen]:
        variance = self._variance
        return [one for piece in self._pieces for one in piece.seen(self._errors, variance)]

    def without_single(self, least: float) -> bool:
        """Take out what single samples explain that gain more than `least` each; were there any?"""
        single = [piece.single(self._errors, least * self._variance) for piece in self._pieces]
        self._errors = self._errors - np.concatenate([np.zeros(0), *single])
        return any(np.any(errors) for errors in single)


class _Piece:
    """One piece of a fit, ready for what loads would explain of its prediction errors."""

    def __init__(self, fit: RowFit, number: int, whitening: Whitening, part: slice, explained: Array) -> None:
        """`part` of all errors are its own, and orthonormal rows `explained` (m, n_used) explained otherwise."""
        self._part, self._use = part, whitening.use
        row, piece = fit.row, fit.row.pieces[number]
        self._experiment, self._start, self._h = piece.experiment, piece.start, piece.h * row.stride
        self._taps = np.concatenate([[1.0], fit.ar])
        n = self._count = len(range(0, piece.y.size, row.stride))
        others = np.fft.rfft(self._laid(np.vstack([np.ones(explained.shape[1]), explained])), 2 * n)
        self._shapes: dict[int, tuple[Array, Array]] = {}
        for spec, own in zip(row.specs, row.slices, strict=True):
            p = fit.theta[own]
            seen = n - int((spec.structure.lag(p) + spec.structure.longest_dead_time(p)) / self._h)
            if not piece.input_spread[spec.column] > 0 or seen <= 0:
                continue
            step, hold = np.ones(piece.y.size), piece.hold[spec.column]
            answer = spec.structure.response(p, step, piece.h, hold, row.stride)
            # before the load there is nothing: its errors begin with it
            shape = whitening.weight * whiten(fit.ar, np.concatenate([np.zeros(fit.ar.size), answer]))
            spectrum = np.conj(np.fft.rfft(shape, 2 * n))
            squares = np.fft.irfft(others[0] * np.conj(np.fft.rfft(shape**2, 2 * n)), 2 * n)[:n]
            left = squares - np.sum(np.fft.irfft(others[1:] * spectrum, 2 * n)[:, :n] ** 2, axis=0)
            told = (left > levels.LOAD_TOLD * squares) & (np.arange(n) < seen)
            self._shapes[spec.column] = spectrum, np.where(told, left, 0.0)

    def _laid(self, rows: Array) -> Array:
        """Rows (m, n_used) of prediction errors where they belong among all samples (m, n)."""
        out = np.zeros((len(rows), self._count))
        out[:, self._taps.size - 1 :][:, self._use] = rows
        return out

    def seen(self, e: Array, variance: float) -> list[_Seen]:
        n, spectrum = self._count, np.fft.rfft(self._laid(e[None, self._part])[0], 2 * self._count)
        found = []
        for column, (shape, left) in self._shapes.items():
            products = np.where(left > 0, np.fft.irfft(spectrum * shape, 2 * n)[:n], 0.0)
            found.append(_Seen(self._experiment, column, self._start, self._h, products / variance, left / variance))
        return found

    def single(self, e: Array, least: float) -> Array:
        """(n_used,) what single samples, misread or hit by an error of their own, explain; more than `least` each."""
        whole, out = self._laid(e[None, self._part])[0], np.zeros(self._count)
        for taps in (np.ones(1), self._taps):
            size = float(taps @ taps)
            sizes = np.correlate(whole - out, taps, "full")[taps.size - 1 :] / size
            squares = sizes**2 * size
            peak = (squares > least) & (squares == maximum_filter1d(squares, 2 * taps.size - 1))
            out += np.convolve(np.where(peak, sizes, 0.0), taps)[: self._count]
        return np.asarray(out[self._taps.size - 1 :][self._use])
