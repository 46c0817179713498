"""One Gauss-Newton step of many windows from a common point: estimates that are linear in the noise.

Estimates of short windows scatter in a lopsided way, and so do their standard errors, which tests between windows
would take for changes. Steps from the common estimate have one Jacobian and are as normal as the noise's sums: the
fluctuation of scores (Nyblom 1989; Zeileis and Hornik 2007), in the units of the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import evaluate
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.row import Row


@dataclass(frozen=True, eq=False)
class OneStep:
    """What each window says about the parameters when all start from the same point."""

    common: Array
    """(size,) the estimate of all windows together."""
    common_covariance: Array
    theta: Array
    """(K, size)"""
    covariance: Array
    """(K, size, size)"""


def one_step(rows: Sequence[Row], noise: Sequence[Array], theta: Array) -> OneStep:
    """Each row holds one window's pieces; `noise` has its AR coefficients, `theta` (size,) is where the search starts.

    All windows share the structure of the row; each keeps its own noise, operating point and initial state.
    """
    low, high = rows[0].bounds()
    size = theta.size
    for _ in range(levels.ONE_STEP_ROUNDS):
        information, slope = np.zeros((len(rows), size, size)), np.zeros((len(rows), size))
        for k, (row, ar) in enumerate(zip(rows, noise, strict=True)):
            information[k], slope[k] = _window(row, ar, theta)
        total = information.sum(axis=0)
        step = -_solve(total, slope.sum(axis=0))
        trial = np.clip(theta + np.clip(step, -np.abs(theta) / 3 - 1e-9, np.abs(theta) / 3 + 1e-9), low, high)
        sigma = np.sqrt(np.maximum(np.diag(inverse(total, levels.WINDOW_FLOOR)), 1e-300))
        if np.all(np.abs(trial - theta) <= levels.ONE_STEP_SETTLED * sigma):
            break
        theta = trial
    steps = np.array([-_solve(i, s) for i, s in zip(information, slope, strict=True)])
    covariance = np.array([inverse(i, levels.WINDOW_FLOOR) for i in information])
    return OneStep(theta, inverse(total, levels.WINDOW_FLOOR), theta + steps, covariance)


def _window(row: Row, ar: Array, theta: Array) -> tuple[Array, Array]:
    """Information and slope of theta in units of this window's own variance, its noise model left free."""
    size = theta.size
    seen = row.without_unseen(theta)
    point = evaluate(seen, theta, ar, np.ones(len(row.pieces)))
    step = _solve(point.information, point.slope)
    left = max(point.count - size - ar.size - seen.unknown_count, 1)
    variance = max(point.cost - float(step @ point.slope), 1e-300) / left
    a, b, c = point.information[:size, :size], point.information[:size, size:], point.information[size:, size:]
    if not ar.size:
        return a / variance, point.slope[:size] / variance
    across = np.linalg.solve(c, np.column_stack([b.T, point.slope[size:]]))
    return (a - b @ across[:, :-1]) / variance, (point.slope[:size] - b @ across[:, -1]) / variance


def _solve(information: Array, slope: Array) -> Array:
    return np.asarray(inverse(information, levels.WINDOW_FLOOR) @ slope)
