"""Sampled response of rational terms with dead time to held or piecewise-linear inputs, exact to rounding.

The dead time is split into whole samples and a remainder. Within one sample the delayed input is then
piecewise constant (or linear) with a single break at the remainder, so that the state advances by
matrix exponentials over the two pieces: three input taps, no approximation of the delay.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array
from trueplant.compiled import compiled
from trueplant.errors import FormulaError
from trueplant.lti import levels
from trueplant.lti.transfer import TransferFunction, TransferMatrix

System = tuple[Array, Array, Array, Array]
"""State matrix, taps, output matrix and direct terms of a sampled system."""
Hold = tuple[bool, bool]
"""Does the input run in straight lines between samples? Is it held, and written after the output was read?"""


def flags_of(hold: str) -> Hold:
    """A hold by its name, for compiled functions."""
    return hold == "linear", hold == "written"


@compiled
def _multiply(a: Array, b: Array, out: Array) -> None:
    """out = a b, of small matrices (n, n), without a call and a new array for each."""
    out[:] = 0.0
    for i in range(a.shape[0]):
        for k in range(a.shape[0]):
            for j in range(a.shape[0]):
                out[i, j] += a[i, k] * b[k, j]


@compiled
def expm(m: Array) -> Array:
    """Matrix exponential of a small matrix by Taylor series of order 15 with scaling and squaring."""
    n = m.shape[0]
    norm = 0.0
    for i in range(n):
        norm = max(norm, np.sum(np.abs(m[i])))
    squarings = 0
    while norm > 0.5:
        norm *= 0.5
        squarings += 1
    scaled = m / 2.0**squarings
    total, next_total = np.eye(n), np.empty((n, n))
    for k in range(15, 0, -1):
        _multiply(scaled, total, next_total)
        total, next_total = next_total, total
        total /= k
        for i in range(n):
            total[i, i] += 1.0
    for _ in range(squarings):
        _multiply(total, total, next_total)
        total, next_total = next_total, total
    return total


@compiled
def realise(num: Array, den: Array) -> tuple[Array, Array, Array, Array]:
    """Controllable form (A, B, C, D) of the rows ``num`` (m, n + 1) over the monic ``den`` (n + 1,).

    Time is scaled by the geometric mean of the poles, which keeps the companion matrix balanced.
    """
    n = den.size - 1
    rate = 1.0
    if n > 0:
        if den[n] != 0.0:
            rate = abs(den[n]) ** (1.0 / n)
        else:
            largest = 0.0
            for k in range(1, n + 1):
                largest = max(largest, abs(den[k]) ** (1.0 / k))
            if largest > 0.0:
                rate = largest
    a = np.zeros((n, n))
    b = np.zeros(n)
    c = np.zeros((num.shape[0], n))
    d = num[:, 0].copy()
    for k in range(n):
        alpha = den[k + 1] / rate ** (k + 1)
        a[0, k] = -alpha * rate
        for i in range(num.shape[0]):
            c[i, k] = num[i, k + 1] / rate ** (k + 1) - d[i] * alpha
        if k + 1 < n:
            a[k + 1, k] = rate
    if n > 0:
        b[0] = rate
    return a, b, c, d


@compiled
def _pieces(a: Array, b: Array, tau: float) -> tuple[Array, Array, Array]:
    """exp(A tau), and the state's answer over tau to an input of 1 and to one that rises from 0 to 1."""
    n = a.shape[0]
    if tau == 0.0:
        return np.eye(n), np.zeros(n), np.zeros(n)
    big = np.zeros((n + 2, n + 2))
    big[:n, :n] = a * tau
    big[:n, n] = b * tau
    big[n, n + 1] = 1.0
    e = expm(big)
    return e[:n, :n].copy(), e[:n, n].copy(), e[:n, n + 1].copy()


@compiled
def discretise(a: Array, b: Array, h: float, phi: float, linear: bool) -> tuple[Array, Array]:
    """State matrix over one sample and the taps (3, n) on u[k-q+1], u[k-q], u[k-q-1]."""
    first, const1, ramp1 = _pieces(a, b, phi * h)
    last, const2, ramp2 = _pieces(a, b, (1.0 - phi) * h)
    taps = np.zeros((3, a.shape[0]))
    if linear:
        from_start = last @ (const1 - ramp1)
        taps[0] = (1.0 - phi) * ramp2
        taps[1] = (1.0 - phi) * from_start + last @ ramp1 + (const2 - ramp2) + phi * ramp2
        taps[2] = phi * from_start
    else:
        taps[1] = const2
        taps[2] = last @ const1
    return last @ first, taps


@compiled
def _states(ad: Array, taps: Array, late: Array, size: int, every: int) -> Array:
    """(n, size) states, from rest, at each `every`-th sample."""
    n, length = ad.shape[0], late.size - 2
    if 0 < n <= 4:
        few: Array = _two_states(ad, taps, late, size, every) if n <= 2 else _four_states(ad, taps, late, size, every)
        return few
    states = np.empty((n, size))
    x, new = np.zeros(n), np.zeros(n)
    for seen in range(size):
        for i in range(n):
            states[i, seen] = x[i]
        for k in range(seen * every, min((seen + 1) * every, length)):
            for i in range(n):
                new[i] = taps[0, i] * late[k + 2] + taps[1, i] * late[k + 1] + taps[2, i] * late[k]
                for j in range(n):
                    new[i] += ad[i, j] * x[j]
            x, new = new, x
    return states


@compiled
def _two_states(ad: Array, taps: Array, late: Array, size: int, every: int) -> Array:
    """The same of one or two states, which stay in registers: elements with one lag are most of all work."""
    last, length = ad.shape[0] - 1, late.size - 2
    states = np.empty((ad.shape[0], size))
    a, b, c, d = ad[0, 0], last * ad[0, last], last * ad[last, 0], ad[last, last]
    x = z = 0.0
    for seen in range(size):
        states[last, seen] = z
        states[0, seen] = x
        for k in range(seen * every, min((seen + 1) * every, length)):
            v = taps[0, 0] * late[k + 2] + taps[1, 0] * late[k + 1] + taps[2, 0] * late[k]
            w = taps[0, last] * late[k + 2] + taps[1, last] * late[k + 1] + taps[2, last] * late[k]
            x, z = v + a * x + b * z, w + c * x + d * z
    return states


@compiled
def _four_states(ad: Array, taps: Array, late: Array, size: int, every: int) -> Array:
    """The same of three or four: elements with two lags, and their derivatives."""
    n, length = ad.shape[0], late.size - 2
    states = np.empty((n, size))
    a, b = np.zeros((4, 4)), np.zeros((3, 4))
    a[:n, :n], b[:, :n] = ad, taps
    w = x = y = z = 0.0
    for seen in range(size):
        states[0, seen], states[1, seen], states[2, seen] = w, x, y
        if n == 4:
            states[3, seen] = z
        for k in range(seen * every, min((seen + 1) * every, length)):
            new, now, old = late[k + 2], late[k + 1], late[k]
            w, x, y, z = (
                b[0, 0] * new + b[1, 0] * now + b[2, 0] * old + a[0, 0] * w + a[0, 1] * x + a[0, 2] * y + a[0, 3] * z,
                b[0, 1] * new + b[1, 1] * now + b[2, 1] * old + a[1, 0] * w + a[1, 1] * x + a[1, 2] * y + a[1, 3] * z,
                b[0, 2] * new + b[1, 2] * now + b[2, 2] * old + a[2, 0] * w + a[2, 1] * x + a[2, 2] * y + a[2, 3] * z,
                b[0, 3] * new + b[1, 3] * now + b[2, 3] * old + a[3, 0] * w + a[3, 1] * x + a[3, 2] * y + a[3, 3] * z,
            )
    return states


@compiled
def _run(system: System, q: int, phi: float, before: float, u: Array, every: int) -> Array:
    """`before` is the share that the input of one sample earlier has in what passes on without a lag."""
    ad, taps, c, d = system
    n, m, length = ad.shape[0], c.shape[0], u.size
    late = np.zeros(length + 2)  # u[k - q - 1], u[k - q] and u[k - q + 1] stand at k, k + 1 and k + 2
    for k in range(max(q + 1, 0), min(length + 2, length + q + 1)):
        late[k] = u[k - q - 1]
    size = (length + every - 1) // every
    states = _states(ad, taps, late, size, every)
    y = np.zeros((m, size))
    for i in range(m):
        for j in range(n):
            for seen in range(size):
                y[i, seen] += c[i, j] * states[j, seen]
        if d[i] != 0.0:
            for seen in range(size):
                k = seen * every
                y[i, seen] += d[i] * ((1.0 - before) * late[k + 1] + before * late[k])
    return y


@compiled
def split_dead_time(dead_time: float, h: float) -> tuple[int, float]:
    """Whole samples q and remainder phi in [0, 1), so that dead_time = (q + phi) h."""
    samples = dead_time / h
    q = int(np.floor(samples + levels.WHOLE_SAMPLE))
    phi = samples - q
    return q, (phi if phi > levels.WHOLE_SAMPLE else 0.0)


@compiled
def rows_of(num: Array, den: Array, dead_time: float, u: Array, h: float, hold: Hold, every: int) -> Array:
    """Compiled `rows_response`; NaN where the dead time is no number, as it has no place among the samples."""
    linear, written_after = hold
    if np.isnan(dead_time):
        return np.full((num.shape[0], (u.size + every - 1) // every), np.nan)
    a, b, c, d = realise(num, den)
    # what is later than the record is as good as never, and would not fit into a whole number
    q, phi = split_dead_time(min(dead_time, (u.size + 1) * h), h)
    ad, taps = discretise(a, b, h, phi, linear)
    before = phi if linear else (1.0 if phi > 0.0 or written_after else 0.0)
    y: Array = _run((ad, taps, c, d), min(q, u.size + 1), phi, before, u, every)
    return y


def rows_response(
    num: Array, den: Array, dead_time: float, u: Array, h: float, hold: str = "zoh", every: int = 1
) -> Array:
    """Responses (m, N) of m numerators (m, n + 1) over one monic denominator (n + 1,) to u (N,), from rest.

    Of the N samples only each `every`-th is returned, the first among them. Before its first sample u is zero: pass
    deviations from the operating point. Holds are those of `sampled_response`.
    """
    rows, common = np.ascontiguousarray(num, dtype=float), np.ascontiguousarray(den, dtype=float)
    signal = np.ascontiguousarray(u, dtype=float)
    y: Array = rows_of(rows, common, float(dead_time), signal, float(h), flags_of(hold), every)
    return y


def proper_terms(system: TransferFunction) -> Iterator[tuple[Array, Array, float]]:
    """Numerator (1, n + 1), denominator (n + 1,) and dead time of each term. Raises FormulaError for improper ones."""
    for term in system.terms:
        if not term.is_proper:
            raise FormulaError(f"{system} is improper: it has no response to a held input; add a lag")
        num = np.zeros((1, len(term.den)))
        num[0, len(term.den) - len(term.num) :] = term.num
        yield num, np.array(term.den), term.dead_time


def sampled_response(
    system: TransferFunction | TransferMatrix, u: ArrayLike, h: float, hold: str | tuple[str, ...] = "zoh"
) -> Array:
    """Output at the sample instants for an input sampled at h, from rest, exact for the hold of each input.

    u is (N,) for a transfer function, (N, n_u) for a matrix; the result is (N,) or (N, n_y). `hold` is
    "zoh" (constant from one sample to the next), "linear", or "written", one for all inputs or one each. A jump of a
    held input that reaches the output without lag or dead time is seen in the same sample; one of an input that is
    written after the output was read, as OP is after PV, in the next.

    Raises FormulaError for improper systems.
    """
    values = np.asarray(u, dtype=float)
    if isinstance(system, TransferFunction):
        if not isinstance(hold, str):
            (hold,) = hold
        if hold not in ("zoh", "linear", "written"):
            raise FormulaError(f'hold must be "zoh", "linear" or "written", not {hold!r}')
        y = np.zeros(values.size)
        for num, den, dead_time in proper_terms(system):
            y += rows_response(num, den, dead_time, values, h, hold)[0]
        return y
    n_y, n_u = system.shape
    if values.ndim != 2 or values.shape[1] != n_u:
        raise FormulaError(f"the input must have shape (N, {n_u}), not {values.shape}")
    holds = (hold,) * n_u if isinstance(hold, str) else hold
    out = np.zeros((values.shape[0], n_y))
    for i in range(n_y):
        for j in range(n_u):
            if not system[i, j].is_zero:
                out[:, i] += sampled_response(system[i, j], values[:, j], h, holds[j])
    return out
