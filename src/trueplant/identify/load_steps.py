"""Load steps: instants from which on something other than an input moves an output, found from its prediction errors.

A load that steps at the plant's input moves PV through the plant's own dynamics: by a step and free responses of its
modes. An autoregression that has to make up for it takes noise for slow that is not, and a plant that explains how the
controller answered it is a wrong one. Loads are therefore looked for beside noise models of low order, one after the
other, each where the prediction errors are most like what a load leaves: beyond what could also explain them, which is
the plant and its noise model renewed, a richer structure, an error of that one sample, a PV misread there. Loads and
the noise model that goes with them are taken if together they explain the record better than a noise model alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.estimate import fit_noise, largest_order
from trueplant.identify.fit import RowFit, Whitening, evaluate, fit_row
from trueplant.identify.likelihood import rise
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.rivals import rivals
from trueplant.identify.row import Row, differenced


def with_load_steps(fit: RowFit) -> RowFit:
    """The fit, or a better one that takes load steps along."""
    limit = largest_order(fit.row, levels.LARGEST_ORDER)
    found = [fit]
    for order in levels.ORDERS_BESIDE_LOADS:
        if order >= fit.ar.size:
            continue
        loaded = _with_loads(_kept(fit, _of_differences(fit, limit), order, limit))
        if any(piece.loads for piece in loaded.row.pieces):
            found.append(_settled(_renewed(replace(loaded, free=fit.free), loaded.row, None, limit), limit))
    return found[int(np.argmin(_criteria(found)))]


def _of_differences(fit: RowFit, limit: int) -> Array:
    """theta that explains the differences best: there a step is gone after one sample."""
    begun = fit_row(differenced(fit.row), fit.theta, np.zeros(0), weights=fit.weights, free=fit.free)
    return _renewed(begun, begun.row, None, limit).theta


def _kept(fit: RowFit, theta: Array, order: int, limit: int) -> RowFit:
    """The row with theta held, and a noise model of that order."""
    none = np.zeros(theta.size, dtype=bool)
    begun = fit_row(fit.row, theta, fit.ar, weights=fit.weights, free=none, reweight=False, iterations=0)
    return _renewed(begun, fit.row, order, limit)


def _renewed(fit: RowFit, row: Row, order: int | None, limit: int) -> RowFit:
    """The fit of a row, with a noise model of that order (None: chosen)."""
    ar = fit_noise(fit if fit.row is row else replace(fit, row=row), order, limit)
    return _refitted(replace(fit, ar=ar), row)


def _refitted(fit: RowFit, row: Row) -> RowFit:
    return fit_row(
        row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False, iterations=levels.TRIED_STEPS
    )


def _with_loads(fit: RowFit) -> RowFit:
    """The fit with loads taken along, one by one, as long as each may gain beyond chance."""
    for _ in range(levels.MOST_LOADS - sum(1 for _ in _places(fit.row))):
        place = _likeliest(fit)
        if place is None:
            break
        other = _refitted(fit, _loaded(fit.row, *place))
        if rise(other, fit) < _cost(fit) or not _shows(fit, *place):
            break
        fit = other
    return fit


def _settled(fit: RowFit, limit: int) -> RowFit:
    """Loads and noise model in turn: each load where it explains most beside all else, or left out; others found."""
    for _ in range(levels.LOAD_ROUNDS):
        before = set(_places(fit.row))
        for k, sample in sorted(before):
            fit = _moved(fit, k, sample)
        fit = _with_loads(_renewed(fit, fit.row, None, limit))
        if set(_places(fit.row)) == before:
            break
    return fit


def _moved(fit: RowFit, k: int, sample: int) -> RowFit:
    """The fit with one load where it explains most, or without it."""
    without = _refitted(fit, _without(fit.row, k, sample))
    place = _likeliest(without)
    other = fit if place is None else _refitted(without, _loaded(without.row, *place))
    best, at = min(((fit, (k, sample)), (other, place or (k, sample))), key=lambda one: one[0].cost)
    return best if rise(best, without) > _cost(without) and _shows(without, *at) else without


def _shows(fit: RowFit, k: int, sample: int) -> bool:
    """Does a load show in many errors? Few large ones are none."""
    gains = load_gains(fit, levels.LARGEST_ERROR)[k]
    return bool(gains[max(sample // fit.row.stride - fit.ar.size, 0)] > _cost(fit))


def _places(row: Row) -> Iterator[tuple[int, int]]:
    return ((k, sample) for k, piece in enumerate(row.pieces) for sample in piece.loads)


def _cost(fit: RowFit) -> float:
    """What a load gains in -2 log likelihood by chance, over all samples, in LOAD_STEP of records."""
    return float(chi2.isf(levels.LOAD_STEP / max(fit.count, 1), _freedom(fit)))


def _criteria(fits: list[RowFit]) -> list[float]:
    """-2 log likelihood over the samples that all can predict, and what noise models and loads cost."""
    longest, found = max(fit.ar.size for fit in fits), []
    for fit in fits:
        point = evaluate(fit.row, fit.theta, np.append(fit.ar, np.zeros(longest - fit.ar.size)), fit.weights)
        count = max(point.count, 1)
        loads = sum(1 for _ in _places(fit.row))
        found.append(count * np.log(max(point.cost, 1e-300)) + np.log(count) * fit.ar.size + loads * _cost(fit))
    return found


def _without(row: Row, k: int, sample: int) -> Row:
    """The row without one load of piece k."""
    piece = row.pieces[k]
    kept = replace(piece, loads=tuple(own for own in piece.loads if own != sample))
    return replace(row, pieces=(*row.pieces[:k], kept, *row.pieces[k + 1 :]))


def _loaded(row: Row, k: int, sample: int) -> Row:
    """The row with one load more, in piece k."""
    piece = row.pieces[k]
    pieces = (*row.pieces[:k], replace(piece, loads=(*piece.loads, sample)), *row.pieces[k + 1 :])
    return replace(row, pieces=pieces)


def _freedom(fit: RowFit) -> int:
    """Unknowns that a load brings along: a step, and a free response of each mode."""
    return 1 + fit.row.free_responses


def _likeliest(fit: RowFit) -> tuple[int, int] | None:
    """Piece and sample of the load that explains most of the prediction errors; None where none does beyond chance."""
    best = _cost(fit)
    place: tuple[int, int] | None = None
    for k, gains in load_gains(fit).items():
        if gains.max(initial=0.0) > best:
            best = float(gains.max())
            place = k, (int(np.argmax(gains)) + fit.ar.size) * fit.row.stride
    return place


def load_gains(fit: RowFit, largest: float = np.inf) -> dict[int, Array]:
    """By piece: (n,) what a load from each prediction error on gains in -2 log likelihood, to first order.

    No error counts as larger than `largest` standard deviations of normal ones.
    """
    return {part.number: _gains(fit, part) for part in _unexplained(fit, largest)}


@dataclass(frozen=True, eq=False)
class _Part:
    """One piece of a fit, ready for what loads would explain of it."""

    number: int
    """Of the piece."""
    errors: Array
    """(n,) prediction errors, 0 where there are none, without what is explained already."""
    variance: float
    """Of the errors of all pieces."""
    explained: Array
    """(q, n) what plant, noise model, operating points and rivals explain: of all pieces orthonormal rows."""


def _unexplained(fit: RowFit, largest: float) -> list[_Part]:
    """The pieces that have prediction errors."""
    pieces = enumerate(zip(fit.row.pieces, Whitening.of(fit), strict=True))
    every = [(k, piece, w) for k, (piece, w) in pieces if w is not None]
    known = [
        np.vstack([w.jacobian, *(w(rivals(fit, m, piece)) for m in range(len(fit.row.specs)))]) for _, piece, w in every
    ]
    basis = orthonormal(np.hstack(known).T)
    e = _winsorised(np.concatenate([w.errors for _, _, w in every]), largest)
    e, found, first = e - basis @ (basis.T @ e), [], 0
    variance = float(e @ e) / fit.left
    for k, piece, w in every:
        part = slice(first, first + w.errors.size)
        rows = np.vstack([e[part], basis[part].T, w.basis.T])
        whole = np.zeros((len(rows), len(range(0, piece.y.size, fit.row.stride)) - fit.ar.size))
        whole[:, w.use] = rows
        found.append(_Part(k, whole[0], variance, whole[1:]))
        first = part.stop
    return found


def _winsorised(e: Array, largest: float) -> Array:
    limit = largest * np.median(np.abs(e)) / norm.ppf(0.75)
    return np.asarray(np.clip(e, -limit, limit)) if limit > 0 else e


def _gains(fit: RowFit, part: _Part) -> Array:
    """(n,) what a load from each sample on gains in -2 log likelihood, beside a wrong sample there.

    0 where it would move PV by less than the inputs do: it could not be told from the plant's answer to them.
    """
    k, n, weight = part.number, part.errors.size, fit.weights[part.number]
    if n <= 2 * levels.QUIET_SAMPLES:
        return np.zeros(n)
    loads = _loads(fit, k, n)
    shapes = np.vstack([_wrong_samples(fit, n), lfilter(np.concatenate([[1.0], fit.ar]), [1.0], loads, axis=1)])
    seen = np.fft.rfft(weight * np.vstack([part.errors, part.explained]), 2 * n)
    products = np.fft.irfft(seen[:, None] * np.conj(np.fft.rfft(shapes, 2 * n)), 2 * n)[..., :n].T
    grams = weight**2 * np.cumsum(shapes.T[:, :, None] * shapes.T[:, None, :], axis=0)[::-1]
    sizes = np.diagonal(grams, axis1=1, axis2=2)
    grams = grams - products[:, :, 1:] @ products[:, :, 1:].transpose(0, 2, 1)
    explained, weights = _explained(grams, products[:, :, 0], sizes)
    wrong = len(shapes) - len(loads)
    gains = (
        explained - _explained(grams[:, :wrong, :wrong], products[:, :wrong, 0], sizes[:, :wrong])[0]
    ) / part.variance
    lag = max(spec.structure.lag(fit.theta[own]) for spec, own in zip(fit.row.specs, fit.row.slices, strict=True))
    soon = min(int(lag / fit.row.pieces[k].h / fit.row.stride) + 1, n - 1)
    moved = np.abs(weights[:, wrong:] @ loads[:, soon])
    gains[moved < _moved_by_inputs(fit, k, soon + 1)[fit.ar.size :]] = 0.0
    gains[: levels.QUIET_SAMPLES] = gains[-levels.QUIET_SAMPLES :] = 0.0
    return np.asarray(gains)


def _explained(grams: Array, moments: Array, sizes: Array) -> tuple[Array, Array]:
    """(n,) squares that columns with these products explain, and their weights (n, m).

    `sizes` (n, m) are the squares of the columns before what else explains them was taken out: what is left of some is
    rounding.
    """
    scale = np.sqrt(np.maximum(sizes, levels.SMALLEST))
    normal = grams / (scale[:, :, None] * scale[:, None, :]) + levels.LOST * np.eye(moments.shape[1])
    weights = np.linalg.solve(normal, (moments / scale)[..., None])[..., 0] / scale
    return np.sum(moments * weights, axis=1), weights


def _wrong_samples(fit: RowFit, n: int) -> Array:
    """(2, n) prediction errors from a sample on, if it was hit by an error of its own, and if PV was misread there."""
    found = np.zeros((2, n))
    found[0, 0] = 1.0
    found[1, : fit.ar.size + 1] = np.concatenate([[1.0], fit.ar])[:n]
    return found


def _loads(fit: RowFit, k: int, n: int) -> Array:
    """(m, n) what a load that steps at the first sample may do to PV."""
    begun = replace(fit.row.pieces[k], restarts=(), jumps=(), loads=(0,))
    return replace(fit.row, pieces=(begun,)).unknown(fit.theta, 0).rows[-_freedom(fit) :, :n]


def _moved_by_inputs(fit: RowFit, k: int, soon: int) -> Array:
    """(n,) how far the inputs move PV within so many samples from each one on."""
    answer = fit.row.response(fit.theta, k)
    ahead = -(soon // 2)
    return np.asarray(maximum_filter1d(answer, soon, origin=ahead) - minimum_filter1d(answer, soon, origin=ahead))
