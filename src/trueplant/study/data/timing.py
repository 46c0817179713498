"""The instants of a record: how often PV is really updated, and how surely they are known."""

from __future__ import annotations

import numpy as np

from trueplant.study import levels
from trueplant.study.study import Study


def update_interval(study: Study) -> float:
    """Longest time between real updates of a PV."""
    usable = [s for s in study.screened if s.refusal is None]
    return max((float(np.max(s.update_interval)) for s in usable if s.update_interval.size), default=0.0)


def timing_error(study: Study) -> float:
    """Standard error of the instants at which OP acts and PV is read, as far as the data show that it is there."""
    h, interval = study.segments[0].h, update_interval(study)
    samples = interval / h
    stale = interval / 2 if samples > 1 and abs(samples - round(samples)) > levels.OFF_GRID else 0.0
    return max(stale, h / 2 if study.between else 0.0)
