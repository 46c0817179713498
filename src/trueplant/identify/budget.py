"""What each source of uncertainty has added to the variances of an estimate.

Nothing is estimated here: every step that changes a covariance says by how much, and the parts sum to what it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.result.budget import Source


@dataclass(frozen=True, eq=False)
class Budget:
    """The variances of an output's parameters by what made them, in the order of inclusion."""

    parts: Mapping[Source, Array]
    """(size,) each."""

    @classmethod
    def of(cls, covariance: Array) -> Budget:
        """That of a fit whose covariance (size, size) knows of noise alone."""
        return cls({Source.NOISE: np.diag(covariance)})

    def including(self, source: Source, more: Array) -> Budget:
        """With what a source has added to the covariance (size, size)."""
        return self.joined(Budget({source: np.diag(more)}))

    def without(self, *sources: Source) -> Budget:
        """The rest, where these are looked at anew."""
        return Budget({source: more for source, more in self.parts.items() if source not in sources})

    def joined(self, other: Budget) -> Budget:
        """What is in either, this one first."""
        joined = dict(self.parts)
        for source, more in other.parts.items():
            joined[source] = joined[source] + more if source in joined else more
        return Budget(joined)

    def at(self, index: Array) -> Budget:
        """Of some of the parameters, by their places."""
        return Budget({source: more[index] for source, more in self.parts.items()})
