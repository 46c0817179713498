"""Noise that remembers: what a fit leaves open where its noise model forgets sooner than the noise does.

An autoregression is flat below its slowest pole. 1/f noise is not: at the frequencies that tell a gain from few moves
it may be ten times what the fit takes it for. Each memory d stands for a family of noises

    (1 - 1/q)^d A(q) v = e, e white

(Granger and Joyeux 1980; Hosking 1981): an autoregression at 0, 1/f noise at a half, a random walk at 1. The restricted
likelihood (Patterson and Thompson 1971), of what no parameter can take with it, says how likely each is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import logsumexp

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.estimate import largest_order
from trueplant.identify.fit import RowFit, linearised
from trueplant.identify.linear_algebra import inverse, log_determinant, scaled_eigen
from trueplant.identify.noise import choose_order, fit_ar, whiten, whitened_valid


@dataclass(frozen=True, eq=False)
class _Piece:
    """Output errors of one piece, and what moves them; where PV was not measured, between the samples beside it."""

    rows: Array
    """(1 + size + n_z, n) errors, and what parameters, operating points and initial states do to the output."""
    known: Array
    """(n_z,) what is known of operating points and initial states besides, in units of 1/variance."""
    valid: BoolArray
    """(n,)"""

    def with_memory(self, d: float) -> _Piece:
        """After (1 - 1/q)^d; what was before the piece is in its operating point and initial state."""
        if d == 0:
            return self
        n, length = self.valid.size, self._length
        k = np.arange(1, n)
        taps = np.concatenate([[1.0], np.cumprod((k - 1 - d) / k)])
        return replace(self, rows=irfft(self._spectra * rfft(taps, length), length)[:, :n])

    @property
    def _length(self) -> int:
        """Of Fourier transforms in which the end does not reach the beginning."""
        return int(next_fast_len(2 * self.valid.size, real=True))

    @cached_property
    def _spectra(self) -> ComplexArray:
        return np.asarray(rfft(self.rows, self._length))


class Growth(NamedTuple):
    """How much larger the errors of parameters are than their covariance says, apart for independent sums of them.

    These sums are independent by the covariance and by the mean squares alike. Of two lags of one size the difference
    may hardly be known and the sum well: by factors on each of the two the sum would be lost.
    """

    factors: Array
    """(m,) on the variances of the sums, at least 1."""
    sums: Array
    """(m, size) of parameters, one for each that is free."""
    along: Array
    """(size, m): the parameters that make up each of the sums."""


@dataclass(frozen=True, eq=False)
class _Told:
    """What a record tells under one noise."""

    height: float
    """-2 log likelihood of the best parameters near the fit, without operating points and initial states."""
    deviance: float
    """-2 log restricted likelihood. Both with what the Bayesian criterion takes for the coefficients."""
    squares: Array
    """(size, size) mean squares and products of the parameters about the estimate."""


def remembering(fit: RowFit) -> Growth:
    """The mean squares of the parameters about the fit, over the memories that the noise may have."""
    part = of_a_part(fit)
    told = _told_of([part])[0]
    deviances = np.array([one.deviance for one in told])
    shares = _before() * np.exp((deviances.min() - deviances) / 2)
    squares = np.tensordot(shares / shares.sum(), np.array([one.squares for one in told]), axes=1)
    return _grown(part.covariance, squares, part.free)


def _grown(covariance: Array, squares: Array, free: BoolArray) -> Growth:
    """From covariance and mean squares (size, size), both diagonal in the same sums."""
    chosen = np.flatnonzero(free & (np.diag(covariance) > 0))
    size, values, vectors = scaled_eigen(covariance[np.ix_(chosen, chosen)])
    root = np.sqrt(values)
    apart = vectors.T / root[:, None] / size
    growth, turned = np.linalg.eigh(apart @ squares[np.ix_(chosen, chosen)] @ apart.T)
    sums, back = np.zeros((2, chosen.size, covariance.shape[0]))
    sums[:, chosen], back[:, chosen] = turned.T @ apart, turned.T @ (root[:, None] * vectors.T * size)
    return Growth(np.maximum(growth, 1.0), sums, back.T)


def memory_heights(fits: Sequence[RowFit]) -> Array:
    """(n_fits,) -2 log likelihood of several fits of one row, over the memories that the noise may have."""
    heights = np.array([[one.height for one in told] for told in _told_of(fits)])
    return np.asarray(-2 * logsumexp(-heights / 2, b=_before(), axis=1))


def _told_of(fits: Sequence[RowFit]) -> list[list[_Told]]:
    """For each fit of one row, under each memory: all by the same prediction errors."""
    each = [tuple(_pieces(fit)) for fit in fits]
    moved = [[[piece.with_memory(d) for piece in pieces] for d in levels.MEMORIES] for pieces in each]
    models = [[_left_to(fit, some) for some in own] for fit, own in zip(fits, moved, strict=True)]
    longest = max(ar.size for own in models for ar in own)
    return [
        [_told(fit, some, ar, longest) for some, ar in zip(own, ars, strict=True)]
        for fit, own, ars in zip(fits, moved, models, strict=True)
    ]


def _before() -> Array:
    """(n_memories,) probabilities before the record is looked at."""
    some = levels.MEMORIES > 0
    return np.where(some, levels.REMEMBERS / some.sum(), 1 - levels.REMEMBERS)


def _pieces(fit: RowFit) -> Iterator[_Piece]:
    for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
        y, valid = fit.row.measured(piece.number)
        known = fit.variance / np.maximum(piece.largest, np.finfo(float).tiny) ** 2
        unknown = piece.weight * piece.unknown
        own = piece.weight * np.where(valid, y - fit.row.response(fit.theta, piece.number), 0.0)
        white = whiten(fit.ar, np.vstack([own, unknown]).T)[piece.use].T
        # Those of the fit may be anything where its noise model cancels one with another.
        likely = inverse(white[1:] @ white[1:].T + np.diag(known)) @ (white[1:] @ white[0])
        rows = np.vstack([own - likely @ unknown, piece.weight * piece.moved, unknown])
        at, there = np.arange(valid.size), np.flatnonzero(valid)
        whole = rows if valid.all() else np.array([np.interp(at, there, row[there]) for row in rows])
        yield _Piece(whole, known, valid)


def _left_to(fit: RowFit, pieces: Sequence[_Piece]) -> Array:
    """(order,) the autoregression of what is left of the errors.

    Operating points and initial states are taken out anew: those of the fit need not hold before its first error.
    """
    errors = []
    for piece in pieces:
        own, unknown = piece.rows[0], piece.rows[1 + fit.theta.size :]
        known = unknown @ unknown.T + np.diag(piece.known)
        errors.append(own - unknown.T @ (inverse(known) @ (unknown @ own)))
    valid = [piece.valid for piece in pieces]
    order = choose_order(errors, valid, largest_order(fit.row, max(levels.USUAL_ORDER, fit.ar.size)))
    return fit_ar(errors, valid, order)[0]


def _moving(fit: RowFit) -> BoolArray:
    """(size,) which parameters go to where another noise would have them.

    Not dead times, as the likelihood has a kink at each sample, where it may be least without being level, and nothing
    that is at a bound.
    """
    low, high = fit.row.bounds()
    return np.asarray(fit.free & ~fit.row.is_dead_time & (fit.theta > low) & (fit.theta < high))


def _told(fit: RowFit, pieces: Sequence[_Piece], ar: Array, longest: int) -> _Told:
    """By those prediction errors that a noise model of the `longest` order has."""
    size, free = fit.theta.size, fit.free
    diagonal, pull = fit.row.prior.normal_equations(fit.theta)
    information, slope = np.diag(fit.variance * diagonal), -fit.variance * pull
    squares, count, determinant = fit.variance * fit.row.prior.penalty(fit.theta), 0, 0.0
    whole = np.append(ar, np.zeros(longest - ar.size))
    for piece in pieces:
        white = whiten(whole, piece.rows.T)[whitened_valid(longest, piece.valid)].T
        own, unknown = white[: 1 + size], white[1 + size :]
        known = unknown @ unknown.T + np.diag(piece.known)
        products = own @ (own - own @ unknown.T @ inverse(known) @ unknown).T
        squares += float(products[0, 0])
        slope += products[1:, 0]
        information += products[1:, 1:]
        count += own.shape[1]
        determinant += log_determinant(known)
    told, moving = information[np.ix_(free, free)], _moving(fit)
    covariance, shift = np.zeros((size, size)), np.zeros(size)
    covariance[np.ix_(free, free)] = inverse(told)
    shift[moving] = inverse(information[np.ix_(moving, moving)]) @ slope[moving]
    there = max(count - sum(piece.known.size for piece in pieces), 1)
    left = max(there - int(free.sum()), 1)
    squares = max(squares - float(slope @ shift), np.finfo(float).tiny)
    taken = determinant + ar.size * np.log(max(count, 1))
    height, deviance = there * np.log(squares / there), left * np.log(squares / left) + log_determinant(told)
    return _Told(height + taken, deviance + taken, covariance * squares / left + np.outer(shift, shift))
