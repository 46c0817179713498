"""Did OP follow from the recorded samples alone, or from what PV did between them?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array
from trueplant.loop import PID, Controller
from trueplant.record import Record, Segment
from trueplant.record.sensor import quantum
from trueplant.study import levels
from trueplant.study.data.replay import recorded_pv
from trueplant.study.study import Records


def written_from_samples(records: Records, k: int, i: int, close: float = levels.CONFIRMED) -> bool:
    """Could a linear law have written input i of experiment k from the recorded samples, whatever its tuning?

    OP is regressed on its own past and on set-points and PVs now and before, where it is at no limit: those of the
    declared laws, or all where none is declared. A law that scans as the record does leaves no more than rounding in
    most parts of the record. True also where nothing can be told: too few samples, or an OP that rests in most of them,
    because it is written less often than it is recorded. `close` is the share of OP's movement that may be left.
    """
    controller, screened = records.declared[k], records.screened[k]
    segments = [s for s in screened.segments if len(s) > levels.LAW_PAST]
    if not segments:
        return True
    columns = [_columns(controller, s, screened.record, i) for s in segments]
    rows = np.concatenate([_windows(c, controller, i) for c in columns])[: levels.LAW_SAMPLES]
    if len(rows) < levels.FEWEST_PER_COEFFICIENT * rows.shape[1] or np.mean(rows[:, 0] != rows[:, 1]) < 0.5:
        return True
    steps = [
        0.0 if given else quantum(np.concatenate([c[m][0] for c in columns])) for m, (_, given) in enumerate(columns[0])
    ]
    quanta = np.repeat(steps, levels.LAW_PAST + 1)
    scale = np.maximum(rows.std(axis=0), np.finfo(float).tiny)
    count = min(levels.LAW_PARTS, len(rows) // (levels.FEWEST_PER_COEFFICIENT * rows.shape[1]))
    parts = np.array_split((rows - rows.mean(axis=0)) / scale, count)
    return bool(np.median([_left(part, quanta / scale, close) for part in parts]) <= 1)


def _left(rows: Array, quanta: Array, close: float) -> float:
    """Standard deviation of what the first column has beside the others, over what is allowed for it.

    Allowed is a small share of OP's movement, or what the rounding of the recorded columns makes of the law.
    """
    rows = rows - rows.mean(axis=0)
    coefficients = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
    rounding = np.linalg.norm(np.r_[1.0, coefficients] * quanta) / np.sqrt(12)
    return float(np.std(rows[:, 0] - rows[:, 1:] @ coefficients) / max(close, levels.LAW_ROUNDED * rounding))


def _columns(controller: Controller | None, segment: Segment, record: Record, i: int) -> list[tuple[Array, bool]]:
    """OP and what it may act on, (N,) each; True for what is given from outside and not measured."""
    pv = recorded_pv(record.t, record.y, segment)
    columns = [(segment.u[:, i], False)]
    if controller is None:
        columns += [(x, True) for x in (*segment.r.T, *segment.d.T) if np.isfinite(x).any()]
        return columns + [(x, False) for x in pv.T if np.isfinite(x).any()]
    for (row, j), law in controller.entries.items():
        if row == i:
            acts = law.pv_transform if isinstance(law, PID) and law.pv_transform else np.asarray
            columns += [(acts(segment.r[:, j]), True), (acts(pv[:, j]), False)]
    return columns


def _windows(columns: Sequence[tuple[Array, bool]], controller: Controller | None, i: int) -> Array:
    """(n, m) of all columns the samples now and before, where OP is at no limit."""
    signals = np.column_stack([x for x, _ in columns])
    windows = np.lib.stride_tricks.sliding_window_view(signals, levels.LAW_PAST + 1, axis=0)[..., ::-1]
    low, high = (-np.inf, np.inf) if controller is None else controller.limits[i]
    free = np.all((windows[:, 0] > low) & (windows[:, 0] < high), axis=1)
    rows = windows.reshape(len(windows), -1)
    return np.asarray(rows[free & np.isfinite(rows).all(axis=1)])
