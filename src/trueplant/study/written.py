"""Did OP follow from the recorded samples alone, or from what PV did between them?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.loop import PID, Controller
from trueplant.record import Record, Segment
from trueplant.study.replayed import CLOSE, recorded_pv

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]

PAST = 4
"""Samples that a law reaches back: two for integral and filtered derivative, two for a set-point filter."""
READ = 50_000
"""Samples that are enough to tell."""
FEWEST = 10
"""Samples for each coefficient, below which nothing can be told."""
PARTS = 10
"""Parts of the record that are judged on their own: a change of tuning concerns one of them."""


def written_from_samples(study: Study, k: int, i: int) -> bool:
    """Could a linear law have written input i of experiment k from the recorded samples, whatever its tuning?

    OP is regressed on its own past and on set-points and PVs now and before, where it is at no limit. A law that scans
    as the record does leaves no more than rounding in most parts of the record. True also where nothing can be told:
    too few samples, or an OP that rests in most of them, because it is written less often than it is recorded.
    """
    controller, screened = study.project.controller(k), study.screened[k]
    segments = [s for s in screened.segments if len(s) > PAST]
    if controller is None or not segments:
        return True
    rows = np.concatenate([_rows(controller, s, screened.record, i) for s in segments])[:READ]
    if len(rows) < FEWEST * rows.shape[1] or np.mean(rows[:, 0] != rows[:, 1]) < 0.5:
        return True
    rows = rows - rows.mean(axis=0)
    rows /= np.maximum(rows.std(axis=0), np.finfo(float).tiny)
    parts = np.array_split(rows, min(PARTS, len(rows) // (FEWEST * rows.shape[1])))
    return bool(np.median([_left(part) for part in parts]) <= CLOSE)


def _left(rows: Array) -> float:
    """Standard deviation of what the first column has beside the others."""
    rows = rows - rows.mean(axis=0)
    coefficients = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
    return float(np.std(rows[:, 0] - rows[:, 1:] @ coefficients))


def _rows(controller: Controller, segment: Segment, record: Record, i: int) -> Array:
    """(n, m) OP now, OP before, and the set-points and PVs that the laws of input i act on, now and before."""
    pv = recorded_pv(record.t, record.y, segment)
    signals = [segment.u[:, i]]
    for (row, j), law in controller.entries.items():
        if row == i:
            acts = law.pv_transform if isinstance(law, PID) and law.pv_transform else np.asarray
            signals += [acts(segment.r[:, j]), acts(pv[:, j])]
    windows = np.lib.stride_tricks.sliding_window_view(np.column_stack(signals), PAST + 1, axis=0)[..., ::-1]
    low, high = controller.limits[i]
    free = np.all((windows[:, 0] > low) & (windows[:, 0] < high), axis=1)
    rows = windows.reshape(len(windows), -1)
    return np.asarray(rows[free & np.isfinite(rows).all(axis=1)])
