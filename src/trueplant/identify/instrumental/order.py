"""Polynomial elements B(s)/A(s) e^(-theta s): which coefficients they have, and how the output depends on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.identify.instrumental.samples import Samples
from trueplant.lti.structure import Structure
from trueplant.lti.transfer import Term, TransferFunction


@dataclass(frozen=True)
class Order:
    """B(s)/A(s) e^(-theta s) from one input: A = s^n + a1 s^(n-1) + ... + an, B = b0 s^m + ... + bm.

    dead_time: a number keeps it there, (low, high) has it searched between those, None searches it over a range
    chosen from the record. integrators: as many of the poles are at s = 0. Any dead time is exact.

    Raises LoopError for orders that make no sense.
    """

    column: int
    """Index into the inputs followed by the measured disturbances."""
    poles: int = 1
    zeros: int = 0
    dead_time: float | tuple[float, float] | None = 0.0
    integrators: int = 0

    def __post_init__(self) -> None:
        if not (self.poles >= 1 and 0 <= self.zeros <= self.poles and 0 <= self.integrators <= self.poles):
            raise LoopError(
                f"{self.poles} poles, {self.zeros} zeros, {self.integrators} integrators: at least one pole is needed, "
                "and no more zeros or integrators than poles"
            )
        if not self.keeps_dead_time and self.zeros == self.poles:
            raise LoopError("a dead time can be searched only where there are fewer zeros than poles: fix it")
        low, high = self.dead_time_range(np.inf)
        if not 0 <= low <= high:
            raise LoopError(f"dead time {self.dead_time}: it must be 0 or more, a range must be (low, high)")

    @classmethod
    def of(cls, column: int, structure: Structure, dead_time: float | tuple[float, float] | None = None) -> Order:
        """The polynomial orders of a named structure with one delayed term."""
        if structure.delayed > 1:
            raise LoopError(f"structure {structure}: several delayed terms are not a single B/A e^(-theta s)")
        poles = structure.lags + 2 * structure.pairs + structure.integrators
        fixed = dead_time if structure.has_dead_time else 0.0
        return cls(column, poles, structure.leads, fixed, structure.integrators)

    def coefficients(self, system: TransferFunction) -> Array | None:
        """The parameters of a transfer function of this order; None where it is of another."""
        if len(system.terms) != 1:
            return None
        (term,) = system.terms
        den, num = np.array(term.den), np.array(term.num)
        if len(den) != self.poles + 1 or len(num) > self.zeros + 1 or np.any(den[self.lags + 1 :] != 0):
            return None
        tail = [] if self.keeps_dead_time else [term.dead_time]
        return np.concatenate([den[1 : self.lags + 1], np.zeros(self.zeros + 1 - len(num)), num, tail])

    @property
    def keeps_dead_time(self) -> bool:
        return isinstance(self.dead_time, (int, float))

    def dead_time_range(self, longest: float) -> tuple[float, float]:
        """Lowest and highest dead time; `longest` where none is declared."""
        if self.dead_time is None:
            return 0.0, longest
        if isinstance(self.dead_time, tuple):
            return self.dead_time
        return self.dead_time, self.dead_time

    @property
    def lags(self) -> int:
        """Coefficients of A that are estimated."""
        return self.poles - self.integrators

    @property
    def names(self) -> tuple[str, ...]:
        """a1 ..., b0 ..., and dead_time where it is estimated."""
        a = [f"a{k + 1}" for k in range(self.lags)]
        b = [f"b{k}" for k in range(self.zeros + 1)]
        return (*a, *b, *([] if self.keeps_dead_time else ["dead_time"]))

    def den(self, p: Array) -> Array:
        """(n + 1,) monic, descending powers."""
        den: Array = np.concatenate([[1.0], p[: self.lags], np.zeros(self.integrators)])
        return den

    def num(self, p: Array) -> Array:
        """(m + 1,) descending powers."""
        return np.asarray(p[self.lags : self.lags + self.zeros + 1])

    def delay(self, p: Array) -> float:
        """The dead time, declared or the last of p."""
        return float(self.dead_time) if isinstance(self.dead_time, (int, float)) else float(p[-1])

    def transfer(self, p: Array) -> TransferFunction:
        return TransferFunction((Term(tuple(self.num(p)), tuple(self.den(p)), self.delay(p)),))

    def stable(self, p: Array) -> Array:
        """p with poles in the right half-plane reflected into the left one."""
        den = np.concatenate([[1.0], p[: self.lags]])
        roots = np.roots(den)
        if not np.any(roots.real >= 0):
            return p
        shifted = -np.abs(roots.real) - 1e-6 * np.abs(roots) - 1e-12
        reflected: Array = p.copy()
        reflected[: self.lags] = np.real(np.poly(np.where(roots.real >= 0, shifted + 1j * roots.imag, roots)))[1:]
        return reflected

    def simulate(self, p: Array, samples: Samples) -> Array:
        """Noise-free output (N,) from rest."""
        num, den = self.num(p), self.den(p)
        padded = np.concatenate([np.zeros(den.size - num.size), num])[None, :]
        response: Array = self._respond(padded, den, self.delay(p), samples)[0]
        return response

    def gradient(self, p: Array, samples: Samples) -> tuple[Array, Array]:
        """Noise-free output (N,) and its derivative (N, n_p) by the parameters, both exact for the held input."""
        num, den = self.num(p), self.den(p)
        n = self.poles
        size = 2 * n + 1
        rows = [np.convolve(num, den)]
        rows += [-np.concatenate([num, np.zeros(n - k)]) for k in range(1, self.lags + 1)]
        rows += [np.concatenate([den, np.zeros(self.zeros - k)]) for k in range(self.zeros + 1)]
        if not self.keeps_dead_time:
            rows.append(-np.concatenate([rows[0], [0.0]]))
        padded = np.array([np.concatenate([np.zeros(size - row.size), row]) for row in rows])
        out = self._respond(padded, np.convolve(den, den), self.delay(p), samples)
        return out[0], out[1:].T

    def output_filter(self, p: Array, samples: Samples, error: Array) -> Array:
        """(N, n_p): s^(n-k)/A of an output error that runs linearly between samples, in the columns of a1, a2, ..."""
        den = self.den(p)
        num = np.zeros((self.lags, self.poles + 1))
        num[np.arange(self.lags), np.arange(1, self.lags + 1)] = 1.0
        out = np.zeros((error.size, len(self.names)))
        if self.lags:
            out[:, : self.lags] = samples.respond(num, den, 0.0, error, "linear").T
        return out

    def _respond(self, num: Array, den: Array, dead_time: float, samples: Samples) -> Array:
        return samples.respond(num, den, dead_time, samples.inputs[self.column], samples.hold[self.column])


def slices(orders: Sequence[Order]) -> tuple[slice, ...]:
    """Where the parameters of each element stand in the stacked vector."""
    ends = np.cumsum([len(order.names) for order in orders])
    return tuple(slice(int(end) - len(order.names), int(end)) for order, end in zip(orders, ends, strict=True))


def nuisance(orders: Sequence[Order], theta: Array, samples: Samples) -> Array:
    """Columns (N, n_z) of what is not known of the past: the operating point and, unless the record starts at rest, the
    free response of every element, s^i/A for i below the order; 0 where the output was not measured."""
    columns: list[Array] = [np.ones((samples.t.size, 1))]
    for start, order, part in _unknown_starts(orders, samples):
        if order.lags:
            den = np.concatenate([[1.0], theta[part][: order.lags]])
            num = np.hstack([np.zeros((order.lags, 1)), np.eye(order.lags)])
            columns.append(samples.released(num, den, start).T)
        if order.integrators:
            # at the start the operating point of the input is not known, after a gap the level
            began = np.arange(samples.t.size) >= start
            level = np.ones(samples.t.size) if start else samples.t
            columns.append(np.asarray(np.where(began, level, 0.0)[:, None], dtype=float))
    return np.where(samples.valid[:, None], np.hstack(columns), 0.0)


def nuisance_gradient(orders: Sequence[Order], theta: Array, samples: Samples, weights: Array) -> Array:
    """Derivative (N, n) of `nuisance @ weights` by theta: only A moves the columns."""
    out = np.zeros((samples.t.size, theta.size))
    at = 1
    for start, order, part in _unknown_starts(orders, samples):
        n = order.lags
        if n:
            den = np.concatenate([[1.0], theta[part][:n]])
            num = np.zeros((n, 2 * n + 1))
            for k in range(n):  # by a(k+1): -s^(n-1-k) sum_i w_i s^i / A^2
                last = 2 * n + 1 - (n - 1 - k)
                num[k, last - n : last] = -weights[at : at + n]
            out[:, part.start : part.start + n] += samples.released(num, np.convolve(den, den), start).T
        at += n + int(order.integrators > 0)
    return np.where(samples.valid[:, None], out, 0.0)


def _unknown_starts(orders: Sequence[Order], samples: Samples) -> list[tuple[int, Order, slice]]:
    """Every start with an unknown past, with every element and its place in theta."""
    starts = ([] if samples.at_rest else [0]) + list(samples.restarts)
    parts = slices(orders)
    return [(start, order, part) for start in starts for order, part in zip(orders, parts, strict=True)]
