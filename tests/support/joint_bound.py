"""The Cramer-Rao bound of all rows of a plant together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueplant.identify import Row, Spec, pieces_of
from trueplant.lti.structure import Structure
from trueplant.record.types import Segment

Array = NDArray[np.float64]


def joint_bound(segment: Segment, truth: Sequence[Array], a1: float, sigma: Array) -> Array:
    """Variances of the parameters of all first-order elements, row by row, in this record.

    Disturbances v_i[k] = -a1 v_i[k-1] + e_i[k], e of covariance `sigma` (n_y, n_y); a1 of each output is unknown.
    """
    n, weight = len(truth), np.linalg.inv(sigma)
    columns: dict[str, list[Array]] = {"theta": [], "others": []}
    owners: dict[str, list[int]] = {"theta": [], "others": []}
    for i, row_truth in enumerate(truth):
        row = Row(tuple(Spec(j, Structure.parse("fopdt")) for j in range(n)), pieces_of([segment], i))
        response, gradient = row.response_and_gradient(row_truth, 0)
        unknown, v = row.nuisance(row_truth, 0), row.measured(0)[0] - response
        v = v - unknown @ np.linalg.lstsq(unknown, v, rcond=None)[0]
        own = {"theta": _whitened(gradient, a1), "others": [*_whitened(unknown, a1), v[:-1]]}
        for part, found in own.items():
            columns[part] += found
            owners[part] += len(found) * [i]
    psi, owner = np.array(columns["theta"] + columns["others"]), owners["theta"] + owners["others"]
    scale = np.linalg.norm(psi, axis=1)
    psi = psi / scale[:, None]
    information = (psi @ psi.T) * weight[np.ix_(owner, owner)]
    variances: Array = np.diag(np.linalg.pinv(information, hermitian=True)) / scale**2
    return variances[: len(columns["theta"])]


def _whitened(x: Array, a1: float) -> list[Array]:
    return [*(x[1:] + a1 * x[:-1]).T]
