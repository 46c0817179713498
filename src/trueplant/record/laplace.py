"""Laplace transforms of sampled signals over their record, exact for the way each runs between its samples."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import DataError
from trueplant.record import levels

_CHUNK = 1 << 21
"""Complex numbers held at once."""


def transform(t: ArrayLike, x: ArrayLike, s: ArrayLike, hold: str, tail: str = "none") -> ComplexArray:
    """``integral of x(t) exp(-s (t - t[0])) dt`` over the record, (n_s, ...) for x of shape (N, ...).

    hold: how x runs between samples. "zoh": x[k] until t[k+1] (OP of a digital controller), "linear", or
    "spline": the not-a-knot cubic spline through the samples (a continuous PV). Each is integrated exactly, at any
    complex s and any increasing t. tail="hold" adds x[-1] exp(-s T)/s, the signal resting at its last value for
    ever (Re s > 0, or the limit towards the imaginary axis). Missing samples (NaN) give NaN.
    """
    time, values = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    points = np.asarray(s, dtype=complex)
    flat = np.atleast_1d(points).ravel()
    if time.ndim != 1 or time.size < 2 or values.shape[:1] != time.shape or not np.all(np.diff(time) > 0):
        raise DataError(
            "a transform needs two or more samples at increasing times, one value or row of values for each"
        )
    time = time - time[0]
    coefficients = _pieces(time, values.reshape(time.size, -1), hold)
    steps = np.diff(time)
    h = float(time[-1] / steps.size)
    uniform = bool(np.all(np.abs(time - h * np.arange(time.size)) < 1e-9 * h))
    out = _uniform(h, coefficients, flat) if uniform else _general(time, steps, coefficients, flat)
    if tail == "hold":
        with np.errstate(divide="ignore", invalid="ignore"):
            out = out + (np.exp(-flat * time[-1]) / flat)[:, None] * values.reshape(time.size, -1)[-1]
    elif tail != "none":
        raise DataError(f'unknown tail {tail!r}; use "none" or "hold"')
    return out.reshape(*points.shape, *values.shape[1:]) if points.ndim else out.reshape(1, *values.shape[1:])


def _pieces(t: Array, x: Array, hold: str) -> list[Array]:
    """Polynomial coefficients of each step, ascending powers of the time since its start: arrays (N - 1, m)."""
    if hold == "zoh":
        return [x[:-1]]
    if hold == "linear":
        return [x[:-1], np.diff(x, axis=0) / np.diff(t)[:, None]]
    if hold == "spline":
        from scipy.interpolate import CubicSpline

        # one missing sample spoils its own column only
        whole = np.isfinite(x).all(axis=0)
        pieces = CubicSpline(t, np.where(whole, x, 0.0), bc_type="not-a-knot").c[::-1]
        return list(np.where(whole, pieces, np.nan))
    raise DataError(f'unknown hold {hold!r}; use "zoh", "linear" or "spline"')


def _moments(z: ComplexArray, count: int) -> list[ComplexArray]:
    """``integral of x^j exp(-z x) dx`` from 0 to 1 for j = 0 .. count-1: recursion, or its series at small z."""
    small = np.abs(z) < levels.SERIES_BELOW
    safe = np.where(small, 1.0, z)
    decay = np.exp(-safe)
    out: list[ComplexArray] = []
    for j in range(count):
        series = np.zeros_like(z)
        for m in range(17, -1, -1):
            series = series * -z / (m + 1) + 1.0 / (m + j + 1)
        recursion = ((j * out[-1] if j else 1.0) - decay) / safe
        out.append(np.where(small, series, recursion))
    return out


def _uniform(h: float, coefficients: list[Array], s: ComplexArray) -> ComplexArray:
    """The sum over steps as two nested ones of about sqrt(N) terms, so that few exponentials are needed."""
    n, m = coefficients[0].shape
    inner = max(1, math.isqrt(n))
    outer = -(-n // inner)
    out = np.zeros((s.size, m), dtype=complex)
    padded = [np.concatenate([c, np.zeros((outer * inner - n, m))]).reshape(outer, inner, m) for c in coefficients]
    chunk = max(1, _CHUNK // (outer * m + inner))
    for a in range(0, s.size, chunk):
        z = s[a : a + chunk]
        fine = np.exp(-np.outer(z, h * np.arange(inner)))
        coarse = np.exp(-np.outer(z, h * inner * np.arange(outer)))
        for j, moment in enumerate(_moments(z * h, len(coefficients))):
            sums = np.tensordot(fine, padded[j], axes=(1, 1))
            out[a : a + chunk] += (moment * h ** (j + 1))[:, None] * np.einsum("so,som->sm", coarse, sums)
    return out


def _general(t: Array, steps: Array, coefficients: list[Array], s: ComplexArray) -> ComplexArray:
    out = np.zeros((s.size, coefficients[0].shape[1]), dtype=complex)
    chunk = max(1, _CHUNK // steps.size)
    for a in range(0, s.size, chunk):
        z = s[a : a + chunk, None]
        decay = np.exp(-z * t[:-1])
        for j, moment in enumerate(_moments(z * steps, len(coefficients))):
            out[a : a + chunk] += (moment * steps ** (j + 1) * decay) @ coefficients[j]
    return out
