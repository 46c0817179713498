"""Kalman filter and fixed-interval smoother of one output, for many signals at once.

Gains depend on the model and on which samples are missing, not on the data: the filter is one linear map, applied to
all columns together. Applied to the output error, to offsets and to the derivatives of the plant's response, it turns
generalised least squares into ordinary ones. The smoother is Bierman's form of the one of Bryson and Frazier
(Bierman, G. J. (1973), Fixed interval smoothing with discrete measurements, Int. J. Control 18, 65-75), in which no
covariance has to be inverted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled
from trueplant.disturbance.levels import STEADY
from trueplant.disturbance.models import System


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What a whole record says of the states of a system."""

    value: Array
    """(N, n, m) states, for each column of data."""
    covariance: Array
    """(N, n, n), the same for all columns."""
    shock: Array
    """(N, n, m) how much a jump of each state at each sample would raise the likelihood: t values (de Jong, P. and
    Penzer, J. (1998), Diagnosing shocks in time series, J. Am. Stat. Assoc. 93, 796-806)."""


def whitened(system: System, data: Array, valid: BoolArray) -> tuple[Array, float]:
    """Normalised innovations (N_valid, m) of the columns of data (N, m), and the sum of the logs of their variances.

    The innovations of a column that the system describes are white with variance 1.
    """
    e, variance = _innovations(system.A, system.Q, system.P, system.C, system.noise, np.ascontiguousarray(data), valid)
    variance = variance[valid]
    return e[valid] / np.sqrt(variance)[:, None], float(np.sum(np.log(variance)))


def smoothed(system: System, data: Array, valid: BoolArray) -> Smoothed:
    """The states behind each column of data (N, m), given all of it."""
    x, P, shock = _smoother(system.A, system.Q, system.P, system.C, system.noise, np.ascontiguousarray(data), valid)
    return Smoothed(x, P, shock)


@compiled
def _updated(P: Array, C: Array, r: float, gain: Array) -> float:
    """Covariance P after one measurement, in place; the gain P C/s goes to `gain`; returns s."""
    n = C.size
    s = r
    for i in range(n):
        gain[i] = 0.0
        for j in range(n):
            gain[i] += P[i, j] * C[j]
        s += C[i] * gain[i]
    for i in range(n):
        for j in range(n):
            P[i, j] -= gain[i] * gain[j] / s
    for i in range(n):
        gain[i] /= s
    return s


@compiled
def _moved(A: Array, M: Array, out: Array) -> None:
    """A M into `out`."""
    for i in range(A.shape[0]):
        for c in range(M.shape[1]):
            value = 0.0
            for j in range(A.shape[1]):
                value += A[i, j] * M[j, c]
            out[i, c] = value


@compiled
def _predicted(A: Array, Q: Array, P: Array, work: Array) -> None:
    """A P A' + Q, in place."""
    n = A.shape[0]
    _moved(A, P, work)
    for i in range(n):
        for j in range(n):
            value = Q[i, j]
            for k in range(n):
                value += work[i, k] * A[j, k]
            P[i, j] = value


@compiled
def _same(P: Array, before: Array) -> bool:
    n = P.shape[0]
    for i in range(n):
        for j in range(n):
            if abs(P[i, j] - before[i, j]) > STEADY * np.sqrt(P[i, i] * P[j, j]):
                return False
    return True


@compiled
def _innovations(A: Array, Q: Array, P0: Array, C: Array, r: float, data: Array, valid: BoolArray) -> Any:
    n, (length, m) = A.shape[0], data.shape
    x, moved, P, work = np.zeros((n, m)), np.zeros((n, m)), P0.copy(), np.zeros((n, n))
    gain, before = np.zeros(n), np.zeros((n, n))
    e, variance = np.zeros((length, m)), np.ones(length)
    s, steady = r, False
    for k in range(length):
        if valid[k]:
            if not steady:
                before[:] = P
                s = _updated(P, C, r, gain)
                _predicted(A, Q, P, work)
                steady = _same(P, before)
            variance[k] = s
            for c in range(m):
                value = data[k, c]
                for i in range(n):
                    value -= C[i] * x[i, c]
                e[k, c] = value
                for i in range(n):
                    x[i, c] += gain[i] * value
        else:
            steady = False
            _predicted(A, Q, P, work)
        _moved(A, x, moved)
        x, moved = moved, x
    return e, variance


@compiled
def _smoother(A: Array, Q: Array, P0: Array, C: Array, r: float, data: Array, valid: BoolArray) -> Any:
    n, (length, m) = A.shape[0], data.shape
    x, P = np.zeros((n, m)), P0.copy()
    xs, Ps, shock = np.zeros((length, n, m)), np.zeros((length, n, n)), np.zeros((length, n, m))
    e, variance, gain, work = np.zeros((length, m)), np.ones(length), np.zeros(n), np.zeros((n, n))
    for k in range(length):
        xs[k], Ps[k] = x, P
        if valid[k]:
            variance[k] = _updated(P, C, r, gain)
            for c in range(m):
                value = data[k, c]
                for i in range(n):
                    value -= C[i] * x[i, c]
                e[k, c] = value
                for i in range(n):
                    x[i, c] += gain[i] * value
        x = A @ x
        _predicted(A, Q, P, work)
    # slope and bend: first and second derivative of the log likelihood of what follows, by the state
    slope, bend = np.zeros((n, m)), np.zeros((n, n))
    for k in range(length - 1, -1, -1):
        if valid[k]:
            s = variance[k]
            keep = np.eye(n) - np.outer(Ps[k] @ C, C) / s
            slope = keep.T @ slope
            for i in range(n):
                for c in range(m):
                    slope[i, c] += C[i] * e[k, c] / s
            bend = np.outer(C, C) / s + keep.T @ bend @ keep
        for i in range(n):
            if bend[i, i] > 0.0:
                shock[k, i] = slope[i] / np.sqrt(bend[i, i])
        xs[k] += Ps[k] @ slope
        Ps[k] -= Ps[k] @ bend @ Ps[k]
        slope = A.T @ slope
        bend = A.T @ bend @ A
    return xs, Ps, shock
