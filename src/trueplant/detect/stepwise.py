"""Stepwise regression of the model's error on the past of OP."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from trueplant.arrays import Array
from trueplant.detect import levels
from trueplant.detect.signals import Detection, Signals, explained, flagged, lagged
from trueplant.identify.noise import choose_order, fit_ar, whiten


def stepwise(signals: Signals, level: float = 0.05) -> Detection:
    """After Kano, Shigi, Hasebe and Ooyama (2010), IFAC Proc. 43(5), 535: forward selection of single lags.

    The error of each output is regressed on past values of the set-point driven part of all OPs, one lag after the
    other as long as the best of those left is significant (Bonferroni over all lags, inputs and outputs). Error and
    regressors are first whitened by an autoregression of the error, because the tests take it to be white. The
    statistic is the largest |t| at which a lag of an input entered, or would have to enter at the end.
    """
    n_y, n_u = signals.e.shape[1], signals.driven.shape[1]
    past = lagged(signals.driven, signals.lags)
    rest = signals.e - explained(past, signals.e)
    candidates = past.shape[1]
    threshold = float(student.isf(level / (2 * n_y * candidates), signals.e.shape[0] - levels.MOST_STEPS - 1))
    statistic = np.zeros((n_y, n_u))
    for i in range(n_y):
        valid = [np.ones(rest.shape[0], dtype=bool)]
        ar = fit_ar([rest[:, i]], valid, choose_order([rest[:, i]], valid, levels.STEPWISE_LARGEST_ORDER))[0]
        statistic[i] = _forward(whiten(ar, past), whiten(ar, signals.e[:, i]), threshold, n_u)
    note = "inputs that move together stand in for each other"
    return flagged("stepwise", statistic, threshold, note)


def _forward(columns: Array, e: Array, threshold: float, n_u: int) -> Array:
    """(n_u,) the largest |t| of each input's lags in a forward selection. Columns are those of input 0 first."""
    columns = columns - columns.mean(axis=0)
    e = e - e.mean()
    whole = np.sum(columns**2, axis=0)
    best = np.zeros(n_u)
    for step in range(levels.MOST_STEPS):
        power = np.sum(columns**2, axis=0)
        usable = power > levels.COLLINEAR * whole
        gain = np.where(usable, (columns.T @ e) ** 2 / np.where(usable, power, 1.0), 0.0)
        left = float(e @ e)
        t = np.sqrt(gain * (e.size - step - 2) / np.maximum(left - gain, 1e-300))
        entering = int(np.argmax(t))
        if t[entering] <= threshold:
            return np.asarray(np.maximum(best, t.reshape(n_u, -1).max(axis=1)))
        owner = entering // (columns.shape[1] // n_u)
        best[owner] = max(best[owner], t[entering])
        q = columns[:, entering] / np.sqrt(power[entering])
        e = e - q * (q @ e)
        columns = columns - np.outer(q, q @ columns)
    return best
