"""Detectors that correlate the model's error with OP: plain, and with all other inputs partialled out."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.detect.signals import Detection, Signals, basis, beyond_shifts, flagged, lagged, shifted


def partial_correlation(signals: Signals, level: float = 0.05) -> Detection:
    """Badwe, Gudi, Patwardhan, Shah and Patwardhan (2009), J. Process Control 19, 1305.

    Of the part of each OP that set-points drive, and of the model's error, what the past of all other inputs
    explains is taken off; the statistic of element (i, j) is the largest correlation of what is left over all lags.
    The threshold holds for the whole matrix. Small statistics say little: they depend on the variances of
    set-points and disturbances as much as on the mismatch.
    """
    return flagged("partial-correlation", *largest_correlation(signals.e, signals.driven, signals.lags, level, True))


def cross_correlation(signals: Signals, level: float = 0.05) -> Detection:
    """The same without taking the other inputs off.

    After Stanfelj, Marlin and MacGregor (1993), Ind. Eng. Chem. Res. 32, 301, who correlate with the set-point of one
    loop. Several loops move together: a mismatch of one element shows in others of its row too.
    """
    found = largest_correlation(signals.e, signals.driven, signals.lags, level, False)
    return flagged("cross-correlation", *found, "a mismatch shows in its whole row")


def largest_correlation(e: Array, driven: Array, lags: int, level: float, partial: bool) -> tuple[Array, float]:
    """Largest |correlation| of e (N, n_y) with the past of driven (N, n_u), (n_y, n_u), and its threshold."""
    errors = shifted(e, lags)
    n, draws, n_y = errors.shape
    flat = errors.reshape(n, draws * n_y)
    n_u = driven.shape[1]
    statistics = np.empty((draws, n_y, n_u))
    for j in range(n_u):
        x, left = driven[:, j], flat
        others = np.delete(driven, j, axis=1)
        if partial and others.shape[1]:
            q = basis(lagged(others, lags))
            x = x - q @ (q.T @ x)
            left = flat - q @ (q.T @ flat)
        past = lagged(x[:, None], lags)
        past = past / np.maximum(np.linalg.norm(past, axis=0), 1e-300)
        size = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
        statistics[:, :, j] = np.max(np.abs(past.T @ left), axis=0).reshape(draws, n_y) / size.reshape(draws, n_y)
    return beyond_shifts(statistics, level)
