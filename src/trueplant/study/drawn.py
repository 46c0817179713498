"""Plants that the data allow: drawn from the covariance of the estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.identify import OutputEstimate, unanswered
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.study.pipeline import believed

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_MOST_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class Uncertain:
    """The plant as estimated, and what its parameters may still be.

    Parameters of one output vary together as their covariance says, those of different outputs on their own.
    Parameters that the data do not answer, and elements that were not estimated, stay as they are in the plant.
    """

    plant: TransferMatrix
    """(n_y, n_u + n_d)."""
    estimates: Mapping[int, OutputEstimate]
    theta: Mapping[int, Array]
    """The parameters (size,) of each output's row, as they stand in the plant."""
    silent: Mapping[int, set[int]]
    """Elements of each row of which nothing is answered, counted within the row."""
    covariance: Mapping[int, Array]
    """(size, size) of each row; 0 for parameters that are not answered."""

    @classmethod
    def of(cls, plant: TransferMatrix, estimates: Mapping[int, OutputEstimate]) -> Uncertain:
        """From the matrix that `plant_matrix` made of the estimates."""
        taken = {i: believed(estimate) for i, estimate in estimates.items()}
        covariance = {}
        for i, estimate in estimates.items():
            still = list(unanswered(estimate))
            covariance[i] = np.array(estimate.covariance)
            covariance[i][still, :] = covariance[i][:, still] = 0.0
        return cls(
            plant, estimates, {i: t for i, (t, _) in taken.items()}, {i: s for i, (_, s) in taken.items()}, covariance
        )

    @property
    def spread(self) -> tuple[Array, Array]:
        """All parameters that vary, stacked (n_p,), and their covariance (n_p, n_p)."""
        from scipy.linalg import block_diag

        moving = {i: np.diag(c) > 0 for i, c in self.covariance.items()}
        values = [self.theta[i][free] for i, free in moving.items()]
        blocks = [self.covariance[i][np.ix_(free, free)] for i, free in moving.items()]
        return np.concatenate([np.zeros(0), *values]), block_diag(*blocks) if blocks else np.zeros((0, 0))

    def at(self, values: Array) -> TransferMatrix:
        """The plant with other values (n_p,) of the parameters of `spread`."""
        rows, start = {}, 0
        for i, theta in self.theta.items():
            free = np.diag(self.covariance[i]) > 0
            rows[i] = theta.copy()
            rows[i][free] = values[start : start + int(free.sum())]
            start += int(free.sum())
        return self._with(rows)

    def drawn(self, count: int, seed: int) -> tuple[TransferMatrix, ...]:
        """`count` plants, normally distributed; those with a parameter out of its bounds are drawn anew."""
        rng = np.random.default_rng(seed)
        rows = {i: self._draws(i, count, rng) for i in self.theta}
        return tuple(self._with({i: draws[k] for i, draws in rows.items()}) for k in range(count))

    def _draws(self, i: int, count: int, rng: np.random.Generator) -> Array:
        theta = self.theta[i]
        values, vectors = np.linalg.eigh(self.covariance[i])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        low, high = self.estimates[i].row.bounds()
        low, high = np.minimum(low, theta), np.maximum(high, theta)
        found = theta + rng.standard_normal((count, theta.size)) @ root.T
        for _ in range(_MOST_ROUNDS):
            outside = np.flatnonzero(np.any((found < low) | (found > high), axis=1))
            if outside.size == 0:
                break
            found[outside] = theta + rng.standard_normal((outside.size, theta.size)) @ root.T
        return np.asarray(np.clip(found, low, high))

    def _with(self, rows: Mapping[int, Array]) -> TransferMatrix:
        elements: list[list[TransferFunction]] = [list(row) for row in self.plant.elements]
        for i, theta in rows.items():
            row = self.estimates[i].row
            for m, (spec, part) in enumerate(zip(row.specs, row.slices, strict=True)):
                if m not in self.silent[i]:
                    elements[i][spec.column] = spec.structure.transfer(theta[part])
        return TransferMatrix(tuple(map(tuple, elements)), self.plant.time_unit)
