"""The restricted likelihood: what the fit takes of the noise, given back.

Each parameter, operating point and initial state that is fitted takes a share of the noise with it, most of the slow
noise. A noise model that is fitted to what is left forgets faster than the noise does, and slow moves then pass for
the plant's: with several inputs that controllers move as slowly, regressions among random walks look sure.
The restricted likelihood (Patterson and Thompson 1971) is the one of what no parameter can take.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify.linear_algebra import inverse, log_determinant
from trueplant.identify.noise import whiten


@dataclass(frozen=True, eq=False)
class Restriction:
    """What parameters, operating points and initial states do to the output of each piece, not whitened."""

    size: int
    """Parameters."""
    pieces: tuple[tuple[Array, slice | BoolArray, Array], ...]
    """Of each the rows (size + n_z, n), the prediction errors that there are, and what the prior says of the n_z.

    That is part of what is known of them: what a noise model takes away nearly whole is told by nothing else.
    """
    prior: Array
    """(size,) the same of the parameters."""
    free: BoolArray
    """(size,)"""
    begun: Array
    """(order,) the noise model that others are compared with."""

    def whitened(self, ar: Array) -> Whitened:
        """What they tell under a noise model."""
        size = self.size
        shares, inverses, rows, half_log_determinant = [], [], [], 0.0
        information = np.zeros((size, size))
        for plain, use, may_be in self.pieces:
            white = whiten(ar, plain.T)[use].T
            unknown = white[size:] @ white[size:].T + np.diag(may_be)
            inverses.append(inverse(unknown))
            shares.append(white[:size] @ white[size:].T @ inverses[-1])
            white[:size] -= shares[-1] @ white[size:]
            information += white[:size] @ white[:size].T
            half_log_determinant += log_determinant(unknown) / 2
            rows.append(white)
        free = np.ix_(self.free, self.free)
        whole, covariance = (information + np.diag(self.prior))[free], np.zeros((size, size))
        covariance[free] = inverse(whole)
        half_log_determinant += log_determinant(whole) / 2
        return Whitened(half_log_determinant, information, covariance, rows, shares, inverses)

    def penalty(self, ar: Array) -> tuple[float, Array]:
        """What -2 log likelihood rises by from the noise model `begun` to this one, and half the gradient (order,)."""
        white, order, size = self.whitened(ar), ar.size, self.size
        slope = np.zeros(order)
        parts = zip(self.pieces, white.rows, white.shares, white.inverses, strict=True)
        for (plain, use, _), rows, shares, inverted in parts:
            told = np.vstack([white.covariance @ rows[:size], inverted @ rows[size:]])
            told[size:] -= shares.T @ told[:size]
            for lag in range(1, order + 1):
                slope[lag - 1] += np.sum(told * plain[:, order - lag : plain.shape[1] - lag][:, use])
        return 2 * (white.half_log_determinant - self._begun), slope

    @cached_property
    def _begun(self) -> float:
        return self.whitened(self.begun).half_log_determinant


@dataclass(frozen=True, eq=False)
class Whitened:
    """The rows of all pieces under a noise model."""

    half_log_determinant: float
    """Of the information on all parameters, operating points and initial states."""
    information: Array
    """(size, size) on the parameters, without what operating points and initial states do, by the record alone."""
    covariance: Array
    """(size, size) with the prior, relative to the variance of the noise."""
    rows: list[Array]
    """Of each piece (size + n_z, n_used); those of the parameters without what the others do."""
    shares: list[Array]
    """(size, n_z) by which that was taken out."""
    inverses: list[Array]
    """(n_z, n_z) of the information on operating points and initial states."""
