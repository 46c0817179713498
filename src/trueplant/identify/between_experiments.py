"""Several experiments of one plant: do they agree, and which estimate to take if they do not.

Each experiment is fitted alone from the common estimate. Where the estimates differ by more than their
covariances justify (Cochran's Q), the variance between runs is estimated by moments (DerSimonian and Laird
1986) and added: the result is then the mean of the runs, and its interval covers their spread.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm, t

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.estimate import noise_signals
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.noise import fit_ar


@dataclass(frozen=True, eq=False)
class Runs:
    """The estimates of single experiments, and their spread."""

    experiments: tuple[int, ...]
    theta: Array
    """(n_runs, n)."""
    covariance: Array
    """(n_runs, n, n)."""
    p_value: Array
    """(n,) that the runs agree; 1 where it cannot be tested."""
    between: Array
    """(n,) standard deviation between runs, 0 where they agree."""
    agree: bool


def single_runs(pooled: RowFit) -> list[tuple[int, RowFit]]:
    """The fit of each experiment alone, started from the pooled one."""
    experiments = sorted({piece.experiment for piece in pooled.row.pieces})
    fits = []
    for experiment in experiments:
        pieces = tuple(piece for piece in pooled.row.pieces if piece.experiment == experiment)
        row = replace(pooled.row, pieces=pieces)
        samples = sum(int(row.measured(k)[1].sum()) for k in range(len(pieces)))
        if samples > levels.SAMPLES_PER_PARAMETER * (pooled.theta.size + pooled.ar.size):
            fits.append((experiment, fit_row(row, pooled.theta, pooled.ar, free=pooled.free, iterations=40)))
    return fits


def compare_runs(pooled: RowFit, significance: float = levels.RUNS_DISAGREE) -> Runs | None:
    """How far single experiments agree with each other; None with fewer than two that can be fitted."""
    if len({piece.experiment for piece in pooled.row.pieces}) < 2:
        return None
    fits = single_runs(pooled)
    if len(fits) < 2:
        return None
    theta = np.array([fit.theta for _, fit in fits])
    covariance = np.array([fit.covariance for _, fit in fits])
    n = theta.shape[1]
    variance = np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-300)
    scale = np.abs(pooled.theta) + pooled.row.lag_of_dead_times(pooled.theta)
    p_value, between = np.ones(n), np.zeros(n)
    for j in range(n):
        take = np.sqrt(variance[:, j]) < levels.RUN_TAKES_PART * scale[j]
        count = int(take.sum())
        if count < 2 or not pooled.free[j]:
            continue
        w = 1 / variance[take, j]
        values = theta[take, j]
        mean = np.sum(w * values) / w.sum()
        q = float(np.sum(w * (values - mean) ** 2))
        p_value[j] = float(chi2.sf(q, count - 1))
        excess = q - (count - 1)
        between[j] = np.sqrt(max(excess / (w.sum() - np.sum(w**2) / w.sum()), 0.0))
    agree = bool(np.min(p_value) > significance / max(n, 1))
    experiments = tuple(experiment for experiment, _ in fits)
    return Runs(experiments, theta, covariance, p_value, np.zeros(n) if agree else between, agree)


def combine_runs(pooled: RowFit, runs: Runs, confidence: float = 0.95) -> tuple[Array, Array]:
    """Mean of the runs and its covariance, weighted by within- and between-run variance.

    Runs that say next to nothing about a parameter leave it to the others through their covariance.
    """
    d = np.diag(runs.between**2)
    n = pooled.theta.size
    total, moment = np.zeros((n, n)), np.zeros(n)
    for theta, covariance in zip(runs.theta, runs.covariance, strict=True):
        weight = np.linalg.pinv(covariance + d, rcond=1e-13, hermitian=True)
        total += weight
        moment += weight @ theta
    combined = np.linalg.pinv(total, rcond=1e-13, hermitian=True)
    if len(runs.theta) > 2:
        # The spread is itself an estimate from few runs (Hartung and Knapp 2001): the t quantile instead of the normal.
        tail = 0.5 + confidence / 2
        few = float(t.ppf(tail, len(runs.theta) - 1) / norm.ppf(tail))
        scale = np.where(runs.between > 0, few, 1.0)
        combined = combined * np.outer(scale, scale)
    low, high = pooled.row.bounds()
    return np.clip(combined @ moment, low, high), np.asarray(combined)


def refit_noise(fit: RowFit, order: int) -> RowFit:
    """The same row with a noise model of another order, started from the present estimate."""
    signals, valid = noise_signals(fit)
    ar = fit_ar(signals, valid, order)[0]
    return fit_row(fit.row, fit.theta, ar, weights=fit.weights, free=fit.free, iterations=40)
