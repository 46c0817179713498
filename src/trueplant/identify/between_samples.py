"""What OP did between its samples, where it acts at other instants than those recorded, and PV between looks at it.

A controller that scans faster than the record writes an OP that nobody recorded, and answers within a sample to noise
that shows in the next one: no fit can see it. How much depends on it the record itself says, looked at as if it had
been sampled half as often: what that hides moves the estimate by more than what is hidden already (Richardson's
extrapolation; an error that grows with the sample time in proportion moves it by as much). How far it moves counts as
an error, beside that of the instants.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import most_moved
from trueplant.identify.estimate import best_dead_times, with_own_noise
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row


def covariance_between_samples(fit: RowFit, timing: float) -> Array:
    """(size, size) of what inputs did between their samples; 0 where they act at the instants recorded (`timing` 0)."""
    if not timing:
        return np.zeros((fit.theta.size, fit.theta.size))
    row = replace(most_moved(fit.row), per_look=1)  # or dead times would be kept twice as far from half as many looks
    found = _refitted(fit, row).theta
    sparse = [_refitted(fit, _thinned(row, phase)).theta for phase in range(2)]
    moved = np.mean(sparse, axis=0) - found
    return np.asarray(np.outer(moved, moved))


def covariance_between_looks(fit: RowFit) -> Array:
    """(size, size) of what PV did between two looks; 0 where each measurement is looked at, and in open loop.

    In closed loop OP acted on all of it, and tells more of the disturbance than the PV that is seen. So does the mean
    of the PV that was measured from one look to the next. How far that moves the estimate counts as an error.
    """
    if fit.row.per_look == 1:
        return np.zeros((fit.theta.size, fit.theta.size))
    row = most_moved(fit.row)
    moved = _refitted(fit, by_means(row)).theta - _refitted(fit, row).theta
    return np.asarray(np.outer(moved, moved))


def by_means(row: Row) -> Row:
    """The row as the mean of the measurements up to each look shows it: the mean of inputs moves that of PV."""
    return replace(row, pieces=tuple(_averaged(piece, row.per_look, row.stride) for piece in row.pieces), per_look=1)


def fitted_to_means(fit: RowFit) -> RowFit:
    """The fit to the means, with a noise model of theirs; the fit itself where nothing is left out."""
    return fit if fit.row.per_look == 1 else _refitted(fit, by_means(fit.row))


def again_to_means(fit: RowFit, means: RowFit) -> RowFit:
    """Likewise, with a noise model of the order that it has in another fit to `means`."""
    if fit.row.per_look == 1:
        return fit
    row, settled = by_means(fit.row), levels.TRIED_SETTLED
    return fit_row(row, fit.theta, means.ar, weights=means.weights, free=means.free, reweight=False, settled=settled)


def _refitted(fit: RowFit, row: Row) -> RowFit:
    again = fit_row(row, fit.theta, np.zeros(0), free=fit.free)
    return best_dead_times(with_own_noise(again, levels.TRIED_STEPS), reach=1, rounds=1)


def _thinned(row: Row, phase: int) -> Row:
    """The row as every second sample shows it, from the first or the second on."""
    return replace(row, pieces=tuple(_every_second(piece.from_sample(phase)) for piece in row.pieces))


def _every_second(piece: Piece) -> Piece:
    restarts, jumps = (tuple(-(-k // 2) for k in of) for of in (piece.restarts, piece.jumps))
    inputs = np.ascontiguousarray(piece.inputs[:, ::2])
    sent = None if piece.sent is None else np.ascontiguousarray(piece.sent[:, ::2])
    y, valid = np.ascontiguousarray(piece.y[::2]), np.ascontiguousarray(piece.valid[::2])
    spikes = None if piece.spikes is None else piece.spikes[::2]
    thinned = replace(piece, h=2 * piece.h, y=y, valid=valid, inputs=inputs, sent=sent, spikes=spikes)
    return replace(thinned, restarts=restarts, jumps=jumps)


def _averaged(piece: Piece, count: int, stride: int) -> Piece:
    """Each sample the mean of the `count` measured in a stride up to it; PV between others where it was not measured.

    Loads and jumps stay steps: within the one look that they step in, they are not averaged.
    """
    there, apart = np.flatnonzero(piece.valid), stride // count
    if not there.size:
        return piece
    whole = np.interp(np.arange(piece.y.size), there, piece.y[there])
    valid = _means(piece.valid.astype(float), count, apart) > 0.5
    valid[: (count - 1) * apart] = False
    y = np.where(valid, _means(whole, count, apart), 0.0)
    sent = None if piece.sent is None else _means(piece.sent, count, apart)
    return replace(piece, y=y, valid=valid, inputs=_means(piece.inputs, count, apart), sent=sent)


def _means(x: Array, count: int, apart: int) -> Array:
    """(..., N) of x (..., N), which is 0 before its first sample."""
    total = x.copy()
    for k in range(apart, count * apart, apart):
        total[..., k:] += x[..., :-k]
    return np.asarray(total / count)
