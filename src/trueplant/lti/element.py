"""Compiled: an element's polynomials, and its sampled response with the derivative by every parameter.

Parameters come as `Structure.names` orders them. `counts` says how many there are: delayed terms, lags, pairs, leads,
integrators, and dead times, as many as delayed terms or none.
"""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.compiled import compiled
from trueplant.lti import levels
from trueplant.lti.sampled import Hold, rows_of

Counts = tuple[int, int, int, int, int, int]


@compiled
def _factors(p: Array, counts: Counts) -> Array:
    """Coefficients (n_f, 3) of a + b s + c s^2: lags and pairs, each where its parameters stand, leads, integrators."""
    delayed, lags, pairs, leads, integrators, _ = counts
    factors = np.zeros((lags + pairs + leads + integrators, 3))
    factors[: lags + pairs + leads, 0] = 1.0
    factors[:lags, 1] = np.maximum(p[delayed : delayed + lags], levels.LEAST_LAG)
    for f in range(pairs):
        w, z = p[delayed + lags + 2 * f], p[delayed + lags + 2 * f + 1]
        factors[lags + f, 1], factors[lags + f, 2] = 2 * z / w, 1 / w**2
    zeros = delayed + lags + 2 * pairs
    factors[lags + pairs : lags + pairs + leads, 1] = p[zeros : zeros + leads]
    factors[lags + pairs + leads :, 1] = 1.0
    return factors


@compiled
def _multiply(polynomial: Array, a: float, b: float, c: float) -> None:
    """The polynomial, in ascending powers, becomes its product with a + b s + c s^2."""
    for k in range(polynomial.size - 1, -1, -1):
        polynomial[k] *= a
        if k > 0:
            polynomial[k] += b * polynomial[k - 1]
        if k > 1:
            polynomial[k] += c * polynomial[k - 2]


@compiled
def _product(factors: Array, without: int, size: int) -> Array:
    """Coefficients (size,) in ascending powers of the product of all factors but one; -1 for none."""
    out = np.zeros(size)
    out[0] = 1.0
    for f in range(factors.shape[0]):
        if f != without:
            _multiply(out, factors[f, 0], factors[f, 1], factors[f, 2])
    return out


@compiled
def polynomials(p: Array, counts: Counts) -> tuple[Array, Array]:
    """Numerator (leads + 1,) and denominator (n + 1,) without gains and dead times, descending powers."""
    _, lags, pairs, leads, integrators, _ = counts
    factors = _factors(p, counts)
    zeros = slice(lags + pairs, lags + pairs + leads)
    num = _product(factors[zeros], -1, leads + 1)
    factors[zeros, 0], factors[zeros, 1] = 1.0, 0.0
    den = _product(factors, -1, lags + 2 * pairs + integrators + 1)
    return num[::-1].copy(), den[::-1].copy()


@compiled
def gradient_polynomials(p: Array, counts: Counts) -> tuple[Array, Array]:
    """Numerators (m, 2 n + 1) and common monic denominator (2 n + 1,) of an element at unit gain, without dead time.

    First the element, then its derivative by each lag, frequency, damping and lead, last by the dead time where it has
    one; descending powers.
    """
    _, lags, pairs, leads, integrators, dead_times = counts
    size = 2 * (lags + 2 * pairs + integrators) + 1
    factors = _factors(p, counts)
    # G = N / D as N D / D^2: numerator and denominator of every derivative then lack one factor of N D
    rows = np.empty((1 + lags + 2 * pairs + leads + min(dead_times, 1), size))
    rows[0] = _product(factors, -1, size)
    for f in range(lags):
        rows[1 + f] = _product(factors, f, size)
        _multiply(rows[1 + f], 0.0, -1.0, 0.0)
    for f in range(lags, lags + pairs):
        at, w_z, w_2 = 1 + 2 * f - lags, factors[f, 1], factors[f, 2]
        w = 1 / np.sqrt(w_2)
        rows[at] = rows[at + 1] = _product(factors, f, size)
        _multiply(rows[at], 0.0, w_z / w, 2 * w_2 / w)
        _multiply(rows[at + 1], 0.0, -2 / w, 0.0)
    for f in range(lags + pairs, lags + pairs + leads):
        rows[1 + pairs + f] = _product(factors, f, size)
        _multiply(rows[1 + pairs + f], 0.0, 1.0, 0.0)
    if dead_times:
        rows[-1] = rows[0]
        _multiply(rows[-1], 0.0, -1.0, 0.0)
    den = polynomials(p, counts)[1]
    squared = np.convolve(den, den)
    return rows[:, ::-1] / squared[0], squared / squared[0]


@compiled
def response(p: Array, counts: Counts, u: Array, h: float, hold: Hold, every: int) -> Array:
    """Sampled response (n,) to u (N,), from rest, at each `every`-th sample."""
    delayed = counts[0]
    num, den = polynomials(p, counts)
    padded = np.zeros((1, den.size))
    padded[0, den.size - num.size :] = num / den[0]
    total = np.zeros((u.size + every - 1) // every)
    for k in range(delayed):
        dead_time = p[p.size - delayed + k] if counts[5] else 0.0
        total += rows_of(p[k] * padded, den / den[0], dead_time, u, h, hold, every)[0]
    return total


@compiled
def delayed_term(p: Array, counts: Counts, rows: Array, k: int) -> tuple[Array, float]:
    """Numerators (1 + m, 2 n + 1) of the k-th delayed term and its dead time, with the rows of `gradient_polynomials`.

    First the term, then its derivative by its gain and by all that the rows are derivatives by.
    """
    num = np.empty((1 + rows.shape[0], rows.shape[1]))
    num[0], num[1], num[2:] = p[k] * rows[0], rows[0], p[k] * rows[1:]
    return num, (p[p.size - counts[0] + k] if counts[5] else 0.0)


@compiled
def response_and_gradient(p: Array, counts: Counts, u: Array, h: float, hold: Hold, every: int) -> Array:
    """(1 + n_p, n): the `response`, and its derivative by every parameter."""
    rows, den = gradient_polynomials(p, counts)
    num, dead_time = delayed_term(p, counts, rows, 0)
    first: Array = rows_of(num, den, dead_time, u, h, hold, every)
    delayed = counts[0]
    if delayed == 1:
        return first
    out = np.zeros((1 + p.size, first.shape[1]))
    last = out.shape[0] - counts[5]
    for k in range(delayed):
        num, dead_time = delayed_term(p, counts, rows, k)
        of_term = rows_of(num, den, dead_time, u, h, hold, every) if k > 0 else first
        out[0] += of_term[0]
        out[1 + k] = of_term[1]
        out[1 + delayed : last] += of_term[2 : 2 + last - 1 - delayed]
        if counts[5]:
            out[last + k] = of_term[-1]
    return out
