"""The plant as the estimates leave it, with what is uncertain about it: made once, taken along by all that follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import OutputEstimate, WhyUnanswered, unanswered
from trueplant.identify.levels import TOO_UNCERTAIN
from trueplant.lti import KnownRow, TransferMatrix, UncertainPlant


def updated_plant(model: TransferMatrix, estimates: Mapping[int, OutputEstimate]) -> UncertainPlant:
    """The plant (n_y, n_u + n_d) with its estimated elements, and the covariance of their parameters.

    An element of which anything is answered is the estimate as it stands, the numbers that the results show; one of
    which nothing is answered stays as the model has it. Parameters that the data do not answer are held where
    they are, as few as leave the others known, and the covariance of these is the one under this condition: what is
    known of several in combination, such as the sum of two gains, is not lost with what is not known of each.
    """
    rows = {}
    for i, estimate in estimates.items():
        kept = _answered_elements(estimate)
        if not kept:
            continue
        specs, slices = estimate.row.specs, estimate.row.slices
        unknown = _held(estimate)
        covariance = conditional(estimate.covariance, unknown)
        index = np.concatenate([np.arange(estimate.theta.size)[slices[m]] for m in kept])
        rows[i] = KnownRow(
            tuple(specs[m].column for m in kept),
            tuple(specs[m].structure for m in kept),
            estimate.theta[index],
            covariance[np.ix_(index, index)],
            tuple(int(place) for place, k in enumerate(index) if k in unknown),
        )
    return UncertainPlant(_with_rows(model, rows), rows)


def _held(estimate: OutputEstimate) -> list[int]:
    """Places in theta of what is not known even where others that are not known are held, those known least first."""
    reasons = unanswered(estimate)
    held = [k for k, reason in reasons.items() if reason.why is not WhyUnanswered.TOO_UNCERTAIN]
    rest = np.setdiff1d(list(reasons), held).astype(np.intp)
    slices = list(zip(estimate.row.specs, estimate.row.slices, strict=True))
    sizes = np.concatenate(
        [
            spec.structure.sizes(estimate.theta[part], estimate.row.lag(m, estimate.theta[part]))
            for m, (spec, part) in enumerate(slices)
        ]
    )
    errors = np.sqrt(np.diag(estimate.covariance)) / np.maximum(sizes, 1e-300)
    for k in rest[np.argsort(-errors[rest])]:
        variance = conditional(estimate.covariance, held)[k, k]
        if not 0 <= variance <= (TOO_UNCERTAIN * sizes[k]) ** 2:  # below 0 it is nothing but rounding
            held.append(int(k))
    return sorted(held)


def conditional(covariance: Array, held: Sequence[int]) -> Array:
    """A covariance (n, n) given the values of some of its variables, whose own rows and columns become 0."""
    out, fixed = np.zeros_like(covariance), np.array(held, dtype=np.intp)
    rest = np.setdiff1d(np.arange(len(covariance)), fixed)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    normal = covariance / np.outer(scale, scale)
    cross = normal[np.ix_(rest, fixed)]
    own = normal[np.ix_(rest, rest)] - cross @ np.linalg.pinv(normal[np.ix_(fixed, fixed)], hermitian=True) @ cross.T
    out[np.ix_(rest, rest)] = own * np.outer(scale[rest], scale[rest])
    return out


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
