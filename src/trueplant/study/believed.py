"""The plant as it is believed to be after the estimates: what is answered is new, the rest stays as it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.identify import OutputEstimate, Row, fit_row, unanswered
from trueplant.lti import TransferFunction, TransferMatrix

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]


def plant_matrix(study: Study, estimates: Mapping[int, OutputEstimate]) -> TransferMatrix:
    """The plant as it is now believed to be.

    Elements of which nothing is answered stay as they were. Where a part of an element is not answered, the
    others were estimated along with it and do not fit its old value: the whole estimate is taken, or the open
    parameters are put back to the model's and the rest is fitted again, whichever simulates the record better.
    """
    rows: list[Sequence[TransferFunction]] = []
    for i in range(study.model.shape[0]):
        row = [study.model[i, j] for j in range(study.model.shape[1])]
        if i in estimates:
            theta, silent = believed(estimates[i])
            for m, (spec, part) in enumerate(zip(estimates[i].row.specs, estimates[i].row.slices, strict=True)):
                if m not in silent:
                    row[spec.column] = spec.structure.transfer(theta[part])
        rows.append(row)
    return TransferMatrix(tuple(tuple(row) for row in rows), study.model.time_unit)


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
            back |= {k: 0.0 for k in gains} if spec.start is None else dict(zip(open_ones, spec.start, strict=True))
        elif spec.start is not None:
            back |= {k: spec.start[k - part.start] for k in open_ones}
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
