"""What is linear and not known of a record: free responses of the modes of a row and its loads, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trueplant.arrays import Array, ComplexArray, IntArray
from trueplant.compiled import compiled
from trueplant.identify import levels

RUN = 64
"""Samples over which an exponential is taken from a table: one product for each instead of a call."""


@dataclass(frozen=True, eq=False)
class Unknown:
    """The linear unknowns of a piece: an offset, free responses, jumps, loads."""

    rows: Array
    """(n_z, n)"""
    largest: Array
    """(n_z,) amplitude that each may have. Elements may work against each other: what one of them does can be many
    times what PV shows."""
    derivatives: Array
    """(n_d, n) of free responses and loads by the parameters that shape them."""
    of: IntArray
    """(n_d,) the unknown that each is a derivative of."""
    by: IntArray
    """(n_d,) the parameter that it is one by."""
    size: int
    """Parameters of the row."""

    @property
    def columns(self) -> Array:
        """(n, n_z)"""
        return self.rows.T

    def gradient(self, weights: Array) -> Array:
        """Derivative (n, size) of `columns @ weights` by theta."""
        out = np.zeros((self.size, self.rows.shape[1]))
        self.add_gradient(weights, out)
        return out.T

    def add_gradient(self, weights: Array, to: Array) -> None:
        """Add what `gradient` says, transposed, to an array (size, n)."""
        _add_weighted(self.derivatives, weights[self.of], self.by, to)

    def including(self, answers: list[Array], places: list[slice], largest: list[float]) -> Unknown:
        """With more of them: of each its response and the derivatives (1 + n_b, n) of that by theta[place]."""
        if not answers:
            return self
        first = len(self.rows)
        return Unknown(
            np.vstack([self.rows, *(answer[:1] for answer in answers)]),
            np.append(self.largest, largest),
            np.vstack([self.derivatives, *(answer[1:] for answer in answers)]),
            np.concatenate([self.of, *(np.full(len(a) - 1, first + k) for k, a in enumerate(answers))]),
            np.concatenate([self.by, *(np.arange(place.start, place.stop) for place in places)]),
            self.size,
        )


class Modes(NamedTuple):
    """The modes of a row: its lags, two for each complex pair, and a drift for each element that integrates."""

    lags: IntArray
    """Places of the time constants in theta."""
    pairs: IntArray
    """Places of the natural frequencies; the damping ratio follows each."""
    gains: IntArray
    """Places of the gains."""
    element: IntArray
    """(n_p,) the element that each parameter belongs to."""
    integrating: IntArray
    """Elements that integrate."""

    @property
    def free_responses(self) -> int:
        """How many there are."""
        return self.lags.size + 2 * self.pairs.size + self.integrating.size


class Past(NamedTuple):
    """What is not known of a piece's past, and how far it can have moved PV."""

    starts: IntArray
    """Samples from which on the inputs are known: the first one unless the piece begins at rest, ends of gaps."""
    jumps: IntArray
    """Samples from which on a disturbance holds the output at another level."""
    size: int
    """Samples of the piece, of which each `every`-th is seen."""
    every: int
    h: float
    spread: float
    """Standard deviation of PV."""
    input_spread: Array
    """(n_elements,) of the input of each element."""

    @property
    def span(self) -> float:
        return self.h * max(self.size - 1, 1)


def unknown_of(theta: Array, modes: Modes, past: Past) -> Unknown:
    """Offset, free responses of all modes from every start, jumps."""
    rows, largest, derivatives, of, by = _unknown(theta, modes, past, past.span)
    return Unknown(rows, largest, derivatives, of, by, theta.size)


@compiled
def _unknown(theta: Array, modes: Modes, past: Past, span: float) -> tuple[Array, Array, Array, IntArray, IntArray]:
    lags, pairs, starts, jumps = modes.lags.size, modes.pairs.size, past.starts.size, past.jumps.size
    count, moved = lags + 2 * pairs + modes.integrating.size, lags + 4 * pairs
    n = -(-past.size // past.every)
    rows, derivatives = np.zeros((1 + starts * count + jumps, n)), np.zeros((starts * moved, n))
    of, by = np.empty(starts * moved, dtype=np.int64), np.empty(starts * moved, dtype=np.int64)
    largest = np.full(rows.shape[0], past.spread)
    rows[0] = 1.0
    for k in range(starts):
        row, derivative = 1 + k * count, k * moved
        seen = -(-past.starts[k] // past.every)
        t = (past.every * np.arange(seen, n) - past.starts[k]) * past.h
        for place in modes.lags:
            of[derivative], by[derivative] = row, place
            _lag(theta[place], t, rows[row, seen:], derivatives[derivative, seen:])
            row, derivative = row + 1, derivative + 1
        for place in modes.pairs:
            for m in range(4):
                of[derivative + m], by[derivative + m] = row + m // 2, place + m % 2
            responses, slopes = rows[row : row + 2, seen:], derivatives[derivative : derivative + 4, seen:]
            _pair(theta[place], theta[place + 1], t, responses, slopes)
            row, derivative = row + 2, derivative + 4
        for _ in modes.integrating:
            # At the start OP's operating point is not known; after a gap the level.
            rows[row, seen:] = np.ones(t.size) if past.starts[k] > 0 else t / span
            row += 1
        largest[1 + k * count : row] = np.maximum(_largest(theta, modes, past, span), past.spread)
    for k in range(jumps):
        rows[1 + starts * count + k, -(-past.jumps[k] // past.every) :] = 1.0
    return rows, largest, derivatives, of, by


@compiled
def _largest(theta: Array, modes: Modes, past: Past, span: float) -> Array:
    """(count,) how large a free response the inputs can have left."""
    driven = np.zeros(past.input_spread.size)
    for place in modes.gains:
        element = modes.element[place]
        driven[element] += np.abs(theta[place]) * past.input_spread[element]
    out = np.full(modes.lags.size + 2 * modes.pairs.size + modes.integrating.size, levels.LARGEST_FREE_RESPONSE)
    for k, place in enumerate(modes.lags):
        element = modes.element[place]
        out[k] *= driven[element]
        if (modes.integrating == element).any():
            out[k] *= theta[place]
    for k, place in enumerate(modes.pairs):
        out[modes.lags.size + 2 * k : modes.lags.size + 2 * k + 2] *= driven[modes.element[place]]
    for k, element in enumerate(modes.integrating):
        out[modes.lags.size + 2 * modes.pairs.size + k] = driven[element] * span
    return out


@compiled
def _lag(tau: float, t: Array, response: Array, slope: Array) -> None:
    """Into zeros: free response of a lag at times t (n,) since its start, and its derivative by the time constant."""
    left = _exponential(complex(-1 / tau, 0.0), t).real
    response[: left.size] = left
    slope[: left.size] = left * t[: left.size] / tau**2


@compiled
def _pair(omega0: float, zeta: float, t: Array, responses: Array, slopes: Array) -> None:
    """Into zeros: two free responses (2, n) of a complex pair, derivatives of each by frequency and damping (4, n)."""
    z = min(zeta, 1.0)
    r = np.sqrt(1 - z**2)
    pole = complex(-z, r)
    by_zeta = complex(-1.0, -z / r) if r > 0 else complex(0.0, 0.0)
    swing = _exponential(pole * omega0, t)
    n = swing.size
    responses[0, :n], responses[1, :n] = swing.real, swing.imag
    slope = pole * t[:n] * swing
    slopes[0, :n], slopes[2, :n] = slope.real, slope.imag
    slope = by_zeta * omega0 * t[:n] * swing
    slopes[1, :n], slopes[3, :n] = slope.real, slope.imag


@compiled
def _exponential(rate: complex, t: Array) -> ComplexArray:
    """exp(rate t) at equidistant times t (n,), as many of them as something is left of it."""
    size = 0
    while size < t.size and -rate.real * t[size] <= levels.FREE_RESPONSE_GONE:
        size += RUN
    out = np.empty(min(size, t.size), dtype=np.complex128)
    run = np.exp(rate * (t[:RUN] - t[0])) if t.size else out
    for first in range(0, out.size, RUN):
        value = np.exp(rate * t[first])
        for k in range(min(RUN, out.size - first)):
            out[first + k] = value * run[k]
    return out


@compiled
def _add_weighted(rows: Array, weights: Array, places: IntArray, to: Array) -> None:
    """to[places[k]] += weights[k] * rows[k]."""
    for k in range(places.size):
        for i in range(rows.shape[1]):
            to[places[k], i] += weights[k] * rows[k, i]
