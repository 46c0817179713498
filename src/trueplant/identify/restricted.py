"""The restricted likelihood: what the fit takes of the noise, given back.

Each parameter, operating point and initial state that is fitted takes a share of the noise with it, most of the slow
noise. A noise model that is fitted to what is left forgets faster than the noise does, and slow moves then pass for
the plant's: with several inputs that controllers move as slowly, regressions among random walks look sure.
The restricted likelihood (Patterson and Thompson 1971) is the one of what no parameter can take.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify.lagged import at_samples, with_past
from trueplant.identify.linear_algebra import inverse, log_determinant
from trueplant.identify.noise import whiten


class Moved(NamedTuple):
    """What parameters, operating points and initial states do to the output of one piece."""

    rows: Array
    """(size + n_z, n) not whitened: first the parameters."""
    use: slice | BoolArray
    """The prediction errors that there are."""
    known: Array
    """(n_z,) what is known of operating points and initial states besides, in units of 1/variance: what a noise model
    takes away nearly whole is told by nothing else."""

    def with_past(self, by: Array, order: int) -> Array:
        """(order,) sums of products of `by` (size + n_z, n_used) and the rows so many samples before each error."""
        return np.asarray(with_past(at_samples(by, self.use, order, self.rows.shape[1]), self.rows, order).sum(axis=0))


@dataclass(frozen=True, eq=False)
class Whitened:
    """The rows of one piece under a noise model."""

    moved: Moved
    rows: Array
    """(size + n_z, n_used); those of the parameters without what the others do."""
    shares: Array
    """(size, n_z) by which that was taken out."""
    unknown: Array
    """(n_z, n_z) information on operating points and initial states."""


@dataclass(frozen=True, eq=False)
class Told:
    """What the record tells under a noise model."""

    information: Array
    """(size, size) on the parameters, without what operating points and initial states do, by the record alone."""
    covariance: Array
    """(size, size) with the prior, relative to the variance of the noise."""
    half_log_determinant: float
    """Of the information on all parameters, operating points and initial states."""


@dataclass(frozen=True, eq=False)
class Restriction:
    """The restricted likelihood of a row, by what parameters and unknowns do to its output at one place."""

    size: int
    """Parameters."""
    pieces: Iterable[Moved]
    """Gone over again each time: the rows of long records need not be kept."""
    prior: Array
    """(size,) what the prior tells of the parameters, in units of 1/variance."""
    free: BoolArray
    """(size,)"""
    begun: Array
    """(order,) the noise model that others are compared with."""

    def told(self, ar: Array) -> Told:
        """What they tell under a noise model."""
        information, half = np.zeros((self.size, self.size)), 0.0
        for piece in self.whitened(ar):
            own = piece.rows[: self.size]
            information += own @ own.T
            half += log_determinant(piece.unknown) / 2
        free, covariance = np.ix_(self.free, self.free), np.zeros_like(information)
        whole = (information + np.diag(self.prior))[free]
        covariance[free] = inverse(whole)
        return Told(information, covariance, half + log_determinant(whole) / 2)

    def penalty(self, ar: Array) -> tuple[float, Array]:
        """What -2 log likelihood rises by from the noise model `begun` to this one, and half the gradient (order,)."""
        told, size, slope = self.told(ar), self.size, np.zeros(ar.size)
        for piece in self.whitened(ar):
            by = np.vstack([told.covariance @ piece.rows[:size], inverse(piece.unknown) @ piece.rows[size:]])
            by[size:] -= piece.shares.T @ by[:size]
            slope += piece.moved.with_past(by, ar.size)
        return 2 * (told.half_log_determinant - self._begun), slope

    def whitened(self, ar: Array) -> Iterator[Whitened]:
        """Of each piece."""
        size = self.size
        for moved in self.pieces:
            white = whiten(ar, moved.rows.T)[moved.use].T
            unknown = white[size:] @ white[size:].T + np.diag(moved.known)
            shares = white[:size] @ white[size:].T @ inverse(unknown)
            white[:size] -= shares @ white[size:]
            yield Whitened(moved, white, shares, unknown)

    @cached_property
    def _begun(self) -> float:
        return self.told(self.begun).half_log_determinant
