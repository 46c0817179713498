"""The plant as the estimates leave it, with what is uncertain about it: made once, taken along by all that follows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import OutputEstimate, Row, fit_row, unanswered
from trueplant.lti import KnownRow, TransferMatrix, UncertainPlant


def updated_plant(model: TransferMatrix, estimates: Mapping[int, OutputEstimate]) -> UncertainPlant:
    """The plant (n_y, n_u + n_d) with its estimated elements, and the covariance of their parameters.

    Parameters that the data do not answer have no variance, and elements of which nothing is answered stand still: what
    is not known at all would only hide what is.
    """
    rows = {}
    for i, estimate in estimates.items():
        theta, silent = believed(estimate)
        unknown = list(unanswered(estimate))
        covariance = np.array(estimate.covariance)
        covariance[unknown, :] = covariance[:, unknown] = 0.0
        kept = [m for m in range(len(estimate.row.specs)) if m not in silent]
        if kept:
            index = np.concatenate([np.arange(theta.size)[estimate.row.slices[m]] for m in kept])
            rows[i] = KnownRow(
                tuple(estimate.row.specs[m].column for m in kept),
                tuple(estimate.row.specs[m].structure for m in kept),
                theta[index],
                covariance[np.ix_(index, index)],
                tuple(int(place) for place, k in enumerate(index) if k in unknown),
            )
    return UncertainPlant(_with_rows(model, rows), rows)


def _with_rows(model: TransferMatrix, rows: Mapping[int, KnownRow]) -> TransferMatrix:
    elements = [list(row) for row in model.elements]
    for i, row in rows.items():
        for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
            elements[i][j] = structure.transfer(row.theta[part])
    return TransferMatrix(tuple(tuple(row) for row in elements), model.time_unit)


def believed(found: OutputEstimate) -> tuple[Array, set[int]]:
    """Parameters of a row, and the elements of which nothing is answered."""
    reasons = unanswered(found)
    fit, theta = found.fit, found.theta
    silent: set[int] = set()
    back: dict[int, float] = {}
    for m, (spec, part) in enumerate(zip(found.row.specs, found.row.slices, strict=True)):
        open_ones = [k for k in range(part.start, part.stop) if k in reasons]
        if len(open_ones) == part.stop - part.start:
            silent.add(m)
            # A silent element that the model lacks is left out: its gain is 0.
            gains = range(part.start, part.start + spec.structure.delayed)
            back |= {k: 0.0 for k in gains} if spec.initial is None else dict(zip(open_ones, spec.initial, strict=True))
        elif spec.initial is not None:
            back |= {k: spec.initial[k - part.start] for k in open_ones}
    if not back:
        return theta, silent
    start, free = theta.copy(), fit.free.copy()
    start[list(back)], free[list(back)] = list(back.values()), False
    again = fit_row(fit.row, start, fit.ar, weights=fit.weights, free=free, reweight=False)
    if silent or _output_error(again.row, again.theta) < _output_error(fit.row, theta):
        return again.theta, silent
    return theta, silent


def _output_error(row: Row, theta: Array) -> float:
    """Sum of squares of the simulation error, offsets and free responses fitted."""
    none = np.zeros(0)
    size = row.size
    held = fit_row(row, theta, none, free=np.zeros(size, dtype=bool), reweight=False, iterations=0)
    return held.cost
