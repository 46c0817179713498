"""Exact responses at instants that need not be evenly spaced."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.compiled import compiled
from trueplant.lti.sampled import Hold, expm, flags_of, proper_terms, realise
from trueplant.lti.transfer import TransferFunction


def response_at(system: TransferFunction, u: Array, t: Array, hold: str = "zoh") -> Array:
    """(N,) output at instants t (N,) for an input u (N,) sampled there, from rest, exact for its hold.

    Raises FormulaError for improper systems.
    """
    y = np.zeros(t.size)
    for num, den, dead_time in proper_terms(system):
        y += rows_response_at(num, den, dead_time, u, t, hold)[0]
    return y


def rows_response_at(num: Array, den: Array, dead_time: float, u: Array, t: Array, hold: str = "zoh") -> Array:
    """Responses (m, N) of m numerators (m, n + 1) over one monic denominator (n + 1,), likewise."""
    a, b, c, d = realise(np.ascontiguousarray(num, dtype=float), np.ascontiguousarray(den, dtype=float))
    instants, signal = np.ascontiguousarray(t, dtype=float), np.ascontiguousarray(u, dtype=float)
    response: Array = _irregular(a, b, c, d, dead_time, flags_of(hold), instants, signal)
    return response


@compiled
def _irregular(a: Array, b: Array, c: Array, d: Array, dead_time: float, hold: Hold, t: Array, u: Array) -> Array:
    """Response (m, N) at instants t that need not be uniform, advanced from one break of the delayed input to the next.

    States are x, the delayed input w and, where it runs linearly, its slope.
    """
    linear, written = hold
    n, m, length = a.shape[0], c.shape[0], t.size
    y = np.zeros((m, length))
    x = np.zeros(n)
    big = np.zeros((n + 2, n + 2))
    step = np.zeros((n + 2, n + 2))
    last = -1.0
    # dead times of whole samples arrive in the sample, whatever the rounding of t
    tolerance = 1e-9 * (t[-1] - t[0]) / t.size
    now, p = t[0], -1  # p: the last input sample that has arrived
    for k in range(length):
        while True:
            arrival = t[p + 1] + dead_time if p + 1 < length else np.inf
            until = min(arrival, t[k])
            dt = until - now
            if dt > 0.0:
                if dt != last:
                    big[:] = 0.0
                    big[:n, :n] = a * dt
                    big[:n, n] = b * dt
                    big[n, n + 1] = dt
                    step = expm(big)
                    last = dt
                w, slope = _input(p, now - dead_time, t, u, linear)
                new = np.zeros(n)
                for i in range(n):
                    value = step[i, n] * w + step[i, n + 1] * slope
                    for j in range(n):
                        value += step[i, j] * x[j]
                    new[i] = value
                x = new
                now = until
            if arrival <= t[k] + tolerance:
                p += 1
            else:
                break
        just_now = p >= 0 and t[p] + dead_time >= t[k] - tolerance
        w, _ = _input(p - 1 if written and just_now else p, t[k] - dead_time, t, u, linear)
        for i in range(m):
            value = d[i] * w
            for j in range(n):
                value += c[i, j] * x[j]
            y[i, k] = value
    return y


@compiled
def _input(p: int, at: float, t: Array, u: Array, linear: bool) -> tuple[float, float]:
    """Input and its slope at the (delayed) time `at` while sample p is the last that has arrived."""
    if p < 0:
        return 0.0, 0.0
    if not linear or p + 1 >= t.size:
        return u[p], 0.0
    slope = (u[p + 1] - u[p]) / (t[p + 1] - t[p])
    return u[p] + slope * (at - t[p]), slope
