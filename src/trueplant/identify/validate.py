"""Does the fitted plant hold: simulated fit, data not used, whiteness, correlation with the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, fit_row, residuals
from trueplant.identify.linear_algebra import eliminated
from trueplant.identify.noise import fit_ar, whiten
from trueplant.identify.pieces import Piece
from trueplant.identify.portmanteau import correlogram, normal_scores
from trueplant.identify.row import Row
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferFunction


def fit_percent(y: Array, simulated: Array) -> float:
    """100 (1 - |y - yhat|/|y - mean y|) over the measured samples."""
    ok = np.isfinite(y) & np.isfinite(simulated)
    spread = np.linalg.norm(y[ok] - y[ok].mean()) if ok.any() else 0.0
    if spread == 0:
        return float("nan")
    return float(100 * (1 - np.linalg.norm(y[ok] - simulated[ok]) / spread))


def simulate_piece(piece: Piece, systems: Sequence[tuple[int, TransferFunction]], lags: Sequence[float]) -> Array:
    """Simulated output (N,) of a piece, with offset, free response of the given lags and loads fitted to its data.

    Where a system integrates a slope is fitted too: at which input it rests nobody has measured.
    """
    total = np.zeros(piece.y.size)
    for column, system in systems:
        total += sampled_response(system, piece.inputs[column], piece.h, piece.hold[column])
    t = piece.h * np.arange(piece.y.size)
    columns = [np.ones(t.size)]
    for start in ([] if piece.starts_at_rest else [0]) + list(piece.restarts):
        since = t - piece.h * start
        columns += [np.where(since >= 0, np.exp(-np.maximum(since, 0) / lag), 0.0) for lag in lags if lag > 0]
    columns += [(np.arange(t.size) >= jump).astype(float) for jump in piece.jumps]
    if any(np.any(system.poles == 0) for _, system in systems):
        columns.append(np.asarray(t, dtype=float))
    known = dict(systems)
    columns += [
        sampled_response(known[load.column], load.course(piece.times), piece.h, piece.hold[load.column])
        for load in piece.stepping
        if load.column in known
    ]
    z = np.column_stack(columns)
    out: Array = total + z @ eliminated(z[piece.valid], (piece.y - total)[piece.valid])[0]
    return out


@dataclass(frozen=True, eq=False)
class Validation:
    """Fit on data that took no part in the estimate."""

    kind: str
    """"other experiments" or "last third"."""
    fit_percent: float
    fit_percent_same_data: float
    """Of the final estimate on the same stretch."""
    trained: RowFit
    """The estimate without those data."""
    pieces: tuple[Piece, ...]
    """The data."""


def validate(fit: RowFit) -> Validation | None:
    """Refit without a part of the data, and simulate that part: whole experiments, else the last third."""
    pieces = fit.row.pieces
    experiments = sorted({p.experiment for p in pieces})
    if len(experiments) > 1:
        kind, held = "other experiments", experiments[-1]
        train = [p for p in pieces if p.experiment != held]
        test = [p for p in pieces if p.experiment == held]
    else:
        kind = "last third"
        train, test = _divided(pieces)
    row = replace(fit.row, pieces=tuple(train))
    test = [p for p in test if p.y.size >= levels.SAMPLES_PER_PARAMETER * fit.theta.size]
    samples = sum(int(row.measured(k)[1].sum()) for k in range(len(train)))
    if not test or samples < levels.SAMPLES_PER_PARAMETER * (fit.theta.size + fit.ar.size):
        return None
    trained = fit_row(row, fit.theta, fit.ar, free=fit.free, iterations=30)
    # Data that say little about some parameter would condemn the plant for that: it keeps its value there.
    unseen, seen = (_score(fit, theta, tuple(test)) for theta in (trained.theta, fit.theta))
    return Validation(kind, unseen, seen, trained, tuple(test))


def _divided(pieces: Sequence[Piece]) -> tuple[list[Piece], list[Piece]]:
    """The first two thirds of the samples of some pieces in order of time, and the last third."""
    before, after = [], []
    cut = 2 * sum(p.y.size for p in pieces) // 3
    for piece in pieces:
        if cut > 0:
            before.append(piece.from_sample(0, min(cut, piece.y.size)))
        if cut < piece.y.size:
            after.append(piece.from_sample(max(cut, 0)))
        cut -= piece.y.size
    return before, after


def _score(fit: RowFit, theta: Array, pieces: tuple[Piece, ...]) -> float:
    row = fit.row
    systems = row_systems(row, theta)
    lags = [s.structure.lag(theta[part]) for s, part in zip(row.specs, row.slices, strict=True)]
    measured = np.concatenate([np.where(p.valid, p.y, np.nan) for p in pieces])
    return fit_percent(measured, np.concatenate([simulate_piece(p, systems, lags) for p in pieces]))


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Tests on the prediction errors, at the strided samples."""

    t: Array
    """Time since the first sample, pieces on end."""
    e: Array
    lags: NDArray[np.intp]
    acf: Array
    bound: float
    """Two-sided bound at the confidence level for a single lag."""
    whiteness_p: float
    """Ljung-Box over `lags`."""
    size_p: float
    """That they keep their size (`squares_p`)."""
    ccf: Array
    """(n_columns, n_lags): correlation of e, as `normal_scores`, with past inputs (whitened)."""
    cross_p: Array
    """(n_columns,) that e is unrelated to the past of each input."""


def prediction_errors(fit: RowFit) -> Array:
    """Prediction errors (n,) of a fit in order of time, at the strided samples; NaN where PV could not be used."""
    return np.concatenate([e for _, e, _ in residuals(fit)])


def weighted_errors(fit: RowFit) -> list[Array]:
    """Those of each piece as the fit weights them: all of one size, however loud an experiment is."""
    return _weighted([e for _, e, _ in residuals(fit)], fit)


def _weighted(errors: Sequence[Array], fit: RowFit) -> list[Array]:
    return [e * weight for e, weight in zip(errors, fit.weights, strict=True)]


def squares_p(errors: Sequence[Array]) -> float:
    """p-value that errors, one (n,) a piece, NaN where there are none, keep their size (McLeod and Li 1983).

    Squares of errors whose size changes are correlated over time.
    """
    squares = [e**2 for e in errors]
    there = sum(int(np.isfinite(e).sum()) for e in errors)
    if there <= 2 * levels.RESIDUAL_LAGS:
        return 1.0
    mean = sum(float(np.nansum(s)) for s in squares) / there
    return correlogram([s - mean for s in squares], levels.RESIDUAL_LAGS).p_value()


def residual_tests(fit: RowFit, confidence: float = 0.95) -> ResidualTests:
    """Whiteness of the prediction errors, and their correlation with what each input did before.

    The inputs are whitened by an autoregression first, so that the correlations at different lags are
    nearly independent under the hypothesis.
    """
    stride = fit.row.stride
    errors = [e for _, e, _ in residuals(fit)]
    weighted = _weighted(errors, fit)
    own = correlogram(weighted, levels.RESIDUAL_LAGS)
    columns = range(fit.row.pieces[0].inputs.shape[0])
    inputs = [
        [_prewhitened(piece.inputs[c, ::stride][: e.size]) for piece, e in zip(fit.row.pieces, errors, strict=True)]
        for c in columns
    ]
    scores = normal_scores(weighted)
    crossed = [correlogram(scores, levels.RESIDUAL_LAGS, past) for past in inputs]
    begins = np.cumsum([0.0, *(piece.h * piece.y.size for piece in fit.row.pieces)])
    times = [
        begin + piece.h * stride * np.arange(e.size)
        for begin, piece, e in zip(begins[:-1], fit.row.pieces, errors, strict=True)
    ]
    return ResidualTests(
        t=np.concatenate(times),
        e=np.concatenate(errors),
        lags=np.arange(1, levels.RESIDUAL_LAGS + 1),
        acf=own.value[:, 0, 0],
        bound=float(norm.ppf(0.5 + confidence / 2) / np.sqrt(max(own.count, 1))),
        whiteness_p=own.p_value(fit.ar.size),
        size_p=squares_p(weighted),
        ccf=np.array([cross.value[:, 0, 0] for cross in crossed]),
        cross_p=np.array([cross.p_value() for cross in crossed]),
    )


def _prewhitened(u: Array, order: int = 8) -> Array:
    """An input without what an autoregression predicts of it."""
    centred = u - u.mean()
    if not np.any(centred) or centred.size < 4 * order:
        return np.zeros(u.size)
    ar = fit_ar([centred], [np.ones(centred.size, bool)], order)[0]
    out = np.zeros(u.size)
    out[order:] = whiten(ar, centred)
    return out


def row_systems(row: Row, theta: Array) -> list[tuple[int, TransferFunction]]:
    """The transfer function of each element of a row, with the column that drives it."""
    return [(s.column, s.structure.transfer(theta[p])) for s, p in zip(row.specs, row.slices, strict=True)]
