"""PVs of which a historian stored little: how far what it left out may move the estimate.

Between two stored samples its straight line is early, since PV may have rested until just before the second of them,
and the first value held until then is late. The estimates rest on the lines. Whatever PV did in between lies anywhere
between both, and so do the parameters, to first order: how much those of the other extreme differ counts as an error
that is as likely to be one share of it as any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import OutputEstimate
from trueplant.identify.moments import apart
from trueplant.identify.output import averaged
from trueplant.record import Segment
from trueplant.record.compression import drawn
from trueplant.result.budget import Source
from trueplant.study import levels
from trueplant.study.data.excitation import mostly_filled_in
from trueplant.study.study import Study


def drawn_outputs(study: Study) -> tuple[int, ...]:
    """The outputs that a historian mostly filled in, in any experiment."""
    named = {name for k, s in enumerate(study.screened) if s.refusal is None for name in mostly_filled_in(study, k)}
    return tuple(i for i, name in enumerate(study.project.output_names) if name in named)


def held_between(segments: Sequence[Segment], outputs: Sequence[int]) -> tuple[Segment, ...]:
    """The segments with these outputs held from one stored sample to the next, instead of on straight lines."""
    changed = []
    for segment in segments:
        y = segment.y.copy()
        for i in outputs:
            y[:, i] = _held(segment.t, y[:, i])
        changed.append(replace(segment, y=y))
    return tuple(changed)


def _held(t: Array, y: Array) -> Array:
    """y (N,) whose samples on straight lines have the value of the last one before that was stored."""
    stored = np.where(drawn(t, y), 0, np.arange(y.size))
    return np.asarray(y[np.maximum.accumulate(stored)])


def widened_for_drawn(
    estimates: Mapping[int, OutputEstimate],
    held: Mapping[int, OutputEstimate],
    outputs: Sequence[int],
    confidence: float,
) -> dict[int, OutputEstimate]:
    """The estimates of these outputs with what held values instead of straight lines would move (`held`)."""
    out = dict(estimates)
    for i in set(outputs) & estimates.keys() & held.keys():
        own, other = estimates[i], held[i]
        shift = apart(replace(other.fit, theta=other.theta), own.row, own.theta)
        places, shares = np.array(levels.BETWEEN).T
        out[i] = averaged(own, np.outer(places, shift), shares, confidence, Source.HISTORIAN)
    return out
