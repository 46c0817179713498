"""Load steps: instants from which on something nobody recorded acts like an input, found from the prediction errors.

A load that steps at the plant's input moves PV as a step of OP would. An autoregression that has to make up for it takes
noise for slow that is not, and a plant that explains how the controller answered it is a wrong one. Loads are looked
for one after the other, each where a step of an input explains most of what the prediction errors have left over, and
stay as long as they explain more than chance would over all inputs and instants. Beside a plant that explains loads as
well they are not found: the search begins at the model too, and the likeliest of all is taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import most_moved
from trueplant.identify.estimate import fit_noise, largest_order, polished
from trueplant.identify.fit import RowFit, Whitening, evaluate, fit_row
from trueplant.identify.initial_state import Load
from trueplant.identify.likelihood import rise
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.noise import whiten
from trueplant.identify.row import Row


def with_loads(fit: RowFit) -> RowFit:
    """The fit, or a likelier one that takes load steps along.

    Records of which only a part is searched are left as they are.
    """
    if most_moved(fit.row) is not fit.row or not fit.ar.size:
        return fit
    found = [fit]
    for start in _starts(fit):
        loaded = _settled(start)
        if _count(loaded.row):
            if not np.array_equal(loaded.free, fit.free):
                loaded = _settled(_refitted(replace(loaded, free=fit.free), loaded.row))
            found.append(polished(loaded))
    return found[int(np.argmin(_criteria(found)))]


def _starts(fit: RowFit) -> Iterator[RowFit]:
    """The fit, and the model with the noise that it leaves."""
    yield fit
    if all(spec.initial is not None for spec in fit.row.specs):
        model = np.concatenate([np.array(spec.initial, dtype=float) for spec in fit.row.specs])
        none = np.zeros(model.size, dtype=bool)
        held = fit_row(
            fit.row, np.clip(model, *fit.row.bounds()), fit.ar, weights=fit.weights, free=none, reweight=False
        )
        yield _renewed(held)


def _settled(fit: RowFit) -> RowFit:
    """Loads and noise model in turn: all that are found, each where it explains most beside the others, or left out."""
    for _ in range(levels.LOAD_ROUNDS):
        before = {(k, load) for k, piece in enumerate(fit.row.pieces) for load in piece.loads}
        fit = _more(fit)
        for k, load in sorted(before):
            fit = _moved(fit, k, load)
        after = {(k, load) for k, piece in enumerate(fit.row.pieces) for load in piece.loads}
        if after == before:
            break
        fit = _renewed(fit)
    return fit


def _more(fit: RowFit) -> RowFit:
    """The fit with further loads, as long as they gain beyond chance."""
    most = fit.count // levels.SAMPLES_PER_LOAD
    while _count(fit.row) < most:
        found = _likeliest(fit)
        if found is None:
            break
        other = _refitted(fit, _with(fit.row, *found))
        if rise(other, fit) < _cost(fit):
            break
        fit = other
    return fit


def _moved(fit: RowFit, k: int, load: Load) -> RowFit:
    """The fit with one load where it explains most, or without it."""
    without = _refitted(fit, _without(fit.row, k, load))
    place = _likeliest(without)
    if place is not None and place != (k, load):
        other = _refitted(without, _with(without.row, *place))
        fit = other if other.cost < fit.cost else fit
    return fit if rise(fit, without) > _cost(fit) else without


def _refitted(fit: RowFit, row: Row) -> RowFit:
    return fit_row(
        row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False, iterations=levels.TRIED_STEPS
    )


def _renewed(fit: RowFit) -> RowFit:
    """The fit with a noise model chosen anew."""
    ar = fit_noise(fit, None, largest_order(fit.row, levels.LARGEST_ORDER))
    return _refitted(replace(fit, ar=ar), fit.row)


def _count(row: Row) -> int:
    return sum(len(piece.loads) for piece in row.pieces)


def _with(row: Row, k: int, load: Load) -> Row:
    """The row with one load more, in piece k."""
    piece = row.pieces[k]
    return replace(row, pieces=(*row.pieces[:k], replace(piece, loads=(*piece.loads, load)), *row.pieces[k + 1 :]))


def _without(row: Row, k: int, load: Load) -> Row:
    """The row without one load of piece k."""
    piece = row.pieces[k]
    kept = replace(piece, loads=tuple(own for own in piece.loads if own != load))
    return replace(row, pieces=(*row.pieces[:k], kept, *row.pieces[k + 1 :]))


def _cost(fit: RowFit) -> float:
    """What a load gains in -2 log likelihood by chance, over all inputs and samples, in LOAD_STEP of records."""
    return float(chi2.isf(levels.LOAD_STEP / max(fit.count * len(fit.row.specs), 1), 1))


def _criteria(fits: list[RowFit]) -> list[float]:
    """-2 log likelihood over the samples that all can predict, and what noise models and loads cost."""
    longest, found = max(fit.ar.size for fit in fits), []
    for fit in fits:
        point = evaluate(fit.row, fit.theta, np.append(fit.ar, np.zeros(longest - fit.ar.size)), fit.weights)
        count = max(point.count, 1)
        deviance = fit.left * np.log(max(point.cost, 1e-300) / count)
        found.append(float(deviance + np.log(count) * fit.ar.size + _count(fit.row) * _cost(fit)))
    return found


def _likeliest(fit: RowFit) -> tuple[int, Load] | None:
    """Piece and load that gain most; None where none gains beyond chance."""
    best = _cost(fit)
    found: tuple[int, Load] | None = None
    for k, gains in load_gains(fit).items():
        m, at = np.unravel_index(int(np.argmax(gains)), gains.shape)
        if gains[m, at] > best:
            best, found = float(gains[m, at]), (k, Load(fit.row.specs[m].column, int(at) * fit.row.stride))
    return found


def load_gains(fit: RowFit) -> dict[int, Array]:
    """By piece: (n_specs, n) what a load like each input, from each sample on, gains in -2 log likelihood.

    To first order, plant and noise model renewed. A load shows in many errors: single samples that explain more than
    any load, misread or hit by an error of their own, are taken out first.
    """
    scans, e = _scans(fit)
    for _ in range(levels.LOAD_ROUNDS):
        unit = max(float(e @ e) / fit.left, np.finfo(float).tiny)
        found = {scan.number: scan.gains(e) / unit for scan in scans}
        most = max((float(gains.max()) for gains in found.values()), default=0.0)
        single = [scan.single(e, max(most, _cost(fit)) * unit) for scan in scans]
        if not any(np.any(errors) for errors in single):
            break
        e = e - np.concatenate(single)
    return found


def _scans(fit: RowFit) -> tuple[list[_Scan], Array]:
    """The pieces that have prediction errors, and these without what plant and noise model explain to first order."""
    pieces = enumerate(zip(fit.row.pieces, Whitening.of(fit), strict=True))
    every = [(k, piece, whitening) for k, (piece, whitening) in pieces if whitening is not None]
    if not every:
        return [], np.zeros(0)
    free = np.concatenate([fit.free, np.ones(fit.ar.size, dtype=bool)])
    basis = orthonormal(np.hstack([whitening.jacobian[free] for _, _, whitening in every]).T)
    e = np.concatenate([whitening.errors for _, _, whitening in every])
    scans, first = [], 0
    for k, piece, whitening in every:
        part = slice(first, first + whitening.errors.size)
        scans.append(_Scan(fit, k, whitening, part, np.vstack([basis[part].T, whitening.basis.T])))
        first = part.stop
    return scans, e - basis @ (basis.T @ e)


class _Scan:
    """One piece, ready for what loads would explain of its prediction errors."""

    def __init__(self, fit: RowFit, number: int, whitening: Whitening, part: slice, explained: Array) -> None:
        """`part` of all errors are its own, and orthonormal rows `explained` (m, n_used) explained otherwise."""
        self.number, self._part, self._use = number, part, whitening.use
        row, piece = fit.row, fit.row.pieces[number]
        self._taps = np.concatenate([[1.0], fit.ar])
        n = self._count = len(range(0, piece.y.size, row.stride))
        others = np.fft.rfft(self._laid(np.vstack([np.ones(explained.shape[1]), explained])), 2 * n)
        self._shapes, self._left = np.zeros((len(row.specs), n + 1), dtype=complex), np.zeros((len(row.specs), n))
        for m, (spec, own) in enumerate(zip(row.specs, row.slices, strict=True)):
            if not piece.input_spread[spec.column] > 0:
                continue
            step, hold = np.ones(piece.y.size), piece.hold[spec.column]
            answer = spec.structure.response(fit.theta[own], step, piece.h, hold, row.stride)
            # before the load there is nothing: its errors begin with it
            shape = whitening.weight * whiten(fit.ar, np.concatenate([np.zeros(fit.ar.size), answer]))
            self._shapes[m] = np.conj(np.fft.rfft(shape, 2 * n))
            squares = np.fft.irfft(others[0] * np.conj(np.fft.rfft(shape**2, 2 * n)), 2 * n)[:n]
            shared = np.fft.irfft(others[1:] * self._shapes[m], 2 * n)[:, :n]
            left = squares - np.sum(shared**2, axis=0)
            p = fit.theta[own]
            seen = n - int((spec.structure.lag(p) + spec.structure.longest_dead_time(p)) / (piece.h * row.stride))
            told = (left > levels.LOAD_TOLD * squares) & (np.arange(n) < seen)
            self._left[m] = np.where(told, left, 0.0)

    def _laid(self, rows: Array) -> Array:
        """Rows (m, n_used) of prediction errors where they belong among all samples (m, n)."""
        out = np.zeros((len(rows), self._count))
        out[:, self._taps.size - 1 :][:, self._use] = rows
        return out

    def gains(self, e: Array) -> Array:
        """(n_specs, n) squares of the errors of all pieces that loads explain."""
        n, seen = self._count, np.fft.rfft(self._laid(e[None, self._part]), 2 * self._count)
        products = np.fft.irfft(seen * self._shapes, 2 * n)[:, :n]
        return np.divide(products**2, self._left, out=np.zeros_like(products), where=self._left > 0)

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
