"""What the data leave open of the whole plant: for draws, and for weights that cover it."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from trueplant.identify import OutputEstimate, unanswered
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.robust import covariance_weight
from trueplant.study.pipeline import believed
from trueplant.tune.drawn import KnownRow, UncertainPlant

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def uncertain_plant(
    plant: TransferMatrix, estimates: Mapping[int, OutputEstimate], steady: Collection[tuple[int, int]] = ()
) -> UncertainPlant:
    """The plant (n_y, n_u + n_d) that `plant_matrix` made of the estimates, with what is uncertain about it.

    Parameters that the data do not answer have no variance, and elements of which nothing is answered or that were not
    estimated stand still: what is not known at all would only hide what is.
    """
    rows = {}
    for i, estimate in estimates.items():
        theta, silent = believed(estimate)
        open_ones = list(unanswered(estimate))
        covariance = np.array(estimate.covariance)
        covariance[open_ones, :] = covariance[:, open_ones] = 0.0
        kept = [m for m in range(len(estimate.row.specs)) if m not in silent]
        if kept:
            index = np.concatenate([np.arange(theta.size)[estimate.row.slices[m]] for m in kept])
            specs = [estimate.row.specs[m] for m in kept]
            rows[i] = KnownRow(
                tuple(spec.column for spec in specs),
                tuple(spec.structure for spec in specs),
                theta[index],
                covariance[np.ix_(index, index)],
            )
    return UncertainPlant(plant, rows, steady)


class Spread:
    """The parameters of an uncertain plant that vary, as one vector, and the errors of the plant that they allow."""

    def __init__(self, known: UncertainPlant) -> None:
        from scipy.linalg import block_diag

        self._known = known
        self._free = {i: np.diag(row.covariance) > 0 for i, row in known.rows.items()}
        self.mean = np.concatenate([np.zeros(0), *(known.rows[i].theta[free] for i, free in self._free.items())])
        """(n_p,)"""
        blocks = [known.rows[i].covariance[np.ix_(free, free)] for i, free in self._free.items()]
        self.covariance: Array = block_diag(*blocks) if blocks else np.zeros((0, 0))
        """(n_p, n_p)"""
        self._dead = np.array(
            [
                name.startswith("dead")
                for i, row in known.rows.items()
                for name, free in zip((n for s in row.structures for n in s.names), self._free[i], strict=True)
                if free
            ],
            dtype=bool,
        )

    def plant(self, values: Array) -> TransferMatrix:
        """The plant with other values (n_p,) of these parameters."""
        elements, start = [list(row) for row in self._known.nominal.elements], 0
        for i, row in self._known.rows.items():
            theta, free = row.theta.copy(), self._free[i]
            theta[free] = values[start : start + int(free.sum())]
            start += int(free.sum())
            for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
                elements[i][j] = structure.transfer(theta[part])
        return TransferMatrix(tuple(map(tuple, elements)), self._known.nominal.time_unit)

    def errors(self, w: Array, confidence: float) -> Array:
        """Size (n_w, n_y, n_u + n_d) of the error of each element within the joint confidence region of all parameters.

        As `covariance_weight`, to first order; but where the error of a dead time has turned the phase, that counts as
        twice the size of its term at most.
        """
        others = self.covariance.copy()
        others[self._dead, :] = others[:, self._dead] = 0.0
        turned = self._turned(w, confidence)
        found = np.zeros((w.size, *self._known.nominal.shape))
        for i, row in self._known.rows.items():
            for j in row.columns:

                def response(values: Array, i: int = i, j: int = j) -> ComplexArray:
                    return np.asarray(self.plant(values)[i, j](1j * w)[:, None, None])

                linear, limited = (
                    covariance_weight(response, self.mean, spread, "additive", confidence)
                    for spread in (self.covariance, others)
                )
                found[:, i, j] = np.minimum(linear, limited + turned[:, i, j])
        return found

    def _turned(self, w: Array, confidence: float) -> Array:
        """(n_w, n_y, n_u + n_d) bounds of what the errors of the dead times alone do to each element."""
        from scipy.stats import chi2

        radius = float(np.sqrt(chi2.ppf(confidence, self.mean.size)))
        bound = np.zeros((w.size, *self._known.nominal.shape))
        for i, row in self._known.rows.items():
            spread = radius * np.sqrt(np.diag(row.covariance))
            for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
                late = [s for name, s in zip(structure.names, spread[part], strict=True) if name.startswith("dead")]
                for term, reach in zip(structure.transfer(row.theta[part]).terms, late, strict=False):
                    size = np.abs(TransferFunction((term,))(1j * w))
                    bound[:, i, j] += size * np.minimum(w * reach, 2.0)
        return bound
