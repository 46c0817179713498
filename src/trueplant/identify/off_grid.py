"""Samples that were taken at odd instants: what putting them on a grid does to them, and the records without it.

On the grid OP acts as its mean over each step, and PV is read along straight lines between its samples. Both make the
plant look a little gentler than it is, which a quiet record shows as dynamics that are not there. How much is a matter
of the plant alone: it is the difference between its response to the moves at their own instants, put on the grid as PV
was, and that to the moves on the grid. Taken off PV for the plant as first estimated, all that is left of it is of the
size of that difference times the error of this estimate (a defect correction).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.lti.irregular import response_at
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferMatrix
from trueplant.record.segments import read_between
from trueplant.record.types import Segment


def as_if_sampled_on_the_grid(segments: Sequence[Segment], plant: TransferMatrix) -> tuple[Segment, ...]:
    """Whole segments without what their grid does to the response of `plant` (n_y, n_u + n_d)."""
    return tuple(s if s.stamps is None else replace(s, y=s.y - _defect(s, plant), stamps=None) for s in segments)


def _defect(segment: Segment, plant: TransferMatrix) -> Array:
    """(N, n_y) the response as it was put on the grid, less that of the grid itself."""
    stamps = segment.stamps
    assert stamps is not None
    at_stamps, on_grid = np.hstack([stamps.u, stamps.d]), np.hstack([segment.u, segment.d])
    defect = np.zeros(segment.y.shape)
    for i, j in np.ndindex(*plant.shape):
        if not plant[i, j].is_zero:
            first, hold = at_stamps[0, j], segment.holds[j]
            read = response_at(plant[i, j], at_stamps[:, j] - first, stamps.t, hold)
            defect[:, i] += read_between(segment, i, read)
            defect[:, i] -= sampled_response(plant[i, j], on_grid[:, j] - first, segment.h, hold)
    return defect
