"""What no likelihood counts of the uncertainty of an estimate, whatever noise it takes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array
from trueplant.identify.between_experiments import Runs
from trueplant.identify.between_samples import covariance_between_looks, covariance_between_samples
from trueplant.identify.covariance import initial_state_share, least_covariance
from trueplant.identify.fit import RowFit
from trueplant.identify.strides import Sampling
from trueplant.record.types import Segment
from trueplant.result.budget import Source


def parts_uncounted(
    fit: RowFit, runs: Runs | None, left_out: Array, sampling: Sampling, segments: Sequence[Segment]
) -> dict[Source, Array]:
    """(size, size) each: unknown starts in closed loop, dead times that were left out and may be there (by `left_out`
    (size,) the others lie elsewhere then), rounding, instants and what was not looked at, and the spread of runs if
    there are more."""
    closed = any(segment.closed for segment in segments)
    least = least_covariance(fit.row, fit.theta, sampling.timing_of(segments))
    found = {
        Source.START: fit.covariance * (initial_state_share(fit) if closed else 0.0),
        Source.LEFT_OUT: np.outer(left_out, left_out),
        Source.ROUNDING: least + covariance_between_samples(fit, sampling.timing) + covariance_between_looks(fit),
    }
    return found if runs is None else found | {Source.EXPERIMENTS: runs.added}
