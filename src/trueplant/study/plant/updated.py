"""The plant as the estimates leave it, with what is uncertain about it: made once, taken along by all that follows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trueplant.identify import OutputEstimate, unanswered
from trueplant.lti import KnownRow, TransferMatrix, UncertainPlant


def updated_plant(model: TransferMatrix, estimates: Mapping[int, OutputEstimate]) -> UncertainPlant:
    """The plant (n_y, n_u + n_d) with its estimated elements, and the covariance of their parameters.

    An element of which anything is answered is the estimate as it stands, the numbers that the results show; one of
    which nothing is answered stays as the model has it. Parameters that the data do not answer have no variance:
    what is not known at all would only hide what is.
    """
    rows = {}
    for i, estimate in estimates.items():
        kept = _answered_elements(estimate)
        if not kept:
            continue
        specs, slices = estimate.row.specs, estimate.row.slices
        covariance = np.array(estimate.covariance)
        unknown = list(unanswered(estimate))
        covariance[unknown, :] = covariance[:, unknown] = 0.0
        index = np.concatenate([np.arange(estimate.theta.size)[slices[m]] for m in kept])
        rows[i] = KnownRow(
            tuple(specs[m].column for m in kept),
            tuple(specs[m].structure for m in kept),
            estimate.theta[index],
            covariance[np.ix_(index, index)],
            tuple(int(place) for place, k in enumerate(index) if k in unknown),
        )
    return UncertainPlant(_with_rows(model, rows), rows)


def _answered_elements(estimate: OutputEstimate) -> list[int]:
    """Places in the row of the elements of which at least one parameter is answered."""
    unknown = unanswered(estimate)
    return [
        m for m, part in enumerate(estimate.row.slices) if any(k not in unknown for k in range(part.start, part.stop))
    ]


def _with_rows(model: TransferMatrix, rows: Mapping[int, KnownRow]) -> TransferMatrix:
    elements = [list(row) for row in model.elements]
    for i, row in rows.items():
        for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
            elements[i][j] = structure.transfer(row.theta[part])
    return TransferMatrix(tuple(tuple(row) for row in elements), model.time_unit)
