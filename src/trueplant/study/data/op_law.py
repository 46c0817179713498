"""Did OP follow from the recorded samples alone, or from what PV did between them?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.loop import PID, Controller
from trueplant.record import Segment
from trueplant.record.resolution import resolution
from trueplant.record.sensor import quantum
from trueplant.study import levels
from trueplant.study.study import Records

_Column = tuple[Array, bool]
"""Samples (N,), and whether they are given from outside and not measured."""


def written_from_samples(records: Records, k: int, i: int, close: float = levels.CONFIRMED) -> bool:
    """Could a linear law have written input i of experiment k from the recorded samples, whatever its tuning?

    OP is regressed on its own past and on set-points and PVs now and before, where it is at no limit and not in manual:
    those of the declared laws, or all where none is declared. Measured disturbances are among them either way, as
    nobody says that a controller acts on one. A law that scans as the record does leaves no more than rounding in most
    parts of the record. True also where nothing can be told: too few samples, or an OP that rests in
    most of them, because it is written less often than it is recorded. `close` is the share of OP's movement that may
    be left.
    """
    controller, screened = records.declared[k], records.screened[k]
    segments = [s for s in screened.segments if len(s) > levels.LAW_PAST]
    if not segments:
        return True
    columns: list[list[_Column]] = []
    found: list[Array] = []
    left = levels.LAW_SAMPLES
    for segment in segments:
        own, windows = _windows(_columns(controller, segment, i), segment.free[:, i], left)
        columns.append(own)
        found.append(windows)
        left -= len(windows)
        if left <= 0:
            break
    rows = np.concatenate(found)
    if len(rows) < levels.FEWEST_PER_COEFFICIENT * rows.shape[1] or np.mean(rows[:, 0] != rows[:, 1]) < 0.5:
        return True
    joined = [np.concatenate([c[m][0] for c in columns]) for m in range(len(columns[0]))]
    steps = [0.0 if given else _step(x[np.isfinite(x)]) for x, (_, given) in zip(joined, columns[0], strict=True)]
    quanta = np.repeat(steps, levels.LAW_PAST + 1)
    scale = np.maximum(rows.std(axis=0), np.finfo(float).tiny)
    count = min(levels.LAW_PARTS, len(rows) // (levels.FEWEST_PER_COEFFICIENT * rows.shape[1]))
    parts = np.array_split((rows - rows.mean(axis=0)) / scale, count)
    return bool(np.median([_left(part, quanta / scale, close) for part in parts]) <= 1)


def _step(x: Array) -> float:
    """How finely x (N,) was measured and written down."""
    return max(quantum(x), resolution(x))


def _left(rows: Array, quanta: Array, close: float) -> float:
    """Standard deviation of what the first column has beside the others, over what is allowed for it.

    Allowed is a small share of OP's movement, or what the rounding of the recorded columns makes of the law.
    """
    rows = rows - rows.mean(axis=0)
    coefficients = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
    rounding = np.linalg.norm(np.r_[1.0, coefficients] * quanta) / np.sqrt(12)
    return float(np.std(rows[:, 0] - rows[:, 1:] @ coefficients) / max(close, levels.LAW_ROUNDED * rounding))


def _columns(controller: Controller | None, segment: Segment, i: int) -> list[_Column]:
    """OP and what it may act on."""
    columns = [(segment.u[:, i], False)]
    columns += [(x, True) for x in segment.d.T if np.isfinite(x).any()]
    if controller is None:
        columns += [(x, True) for x in segment.r.T if np.isfinite(x).any()]
        return columns + [(x, False) for x in segment.y.T if np.isfinite(x).any()]
    for (row, j), law in controller.entries.items():
        if row == i:
            acts = law.pv_transform if isinstance(law, PID) and law.pv_transform else np.asarray
            columns += [(acts(segment.r[:, j]), True), (acts(segment.y[:, j]), False)]
    return columns


def _windows(columns: Sequence[_Column], free: BoolArray, most: int) -> tuple[list[_Column], Array]:
    """The columns as far as they are looked at, and (n, m) of all of them the samples now and before.

    These are the first n <= `most` where OP is free and none is missing.
    """
    known = free & np.logical_and.reduce([np.isfinite(x) for x, _ in columns])
    at = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(known, levels.LAW_PAST + 1).all(axis=1))[:most]
    end = int(at[-1]) + levels.LAW_PAST + 1 if at.size == most else len(free)
    seen = [(x[:end], given) for x, given in columns]
    signals = np.column_stack([x for x, _ in seen])
    windows = np.lib.stride_tricks.sliding_window_view(signals, levels.LAW_PAST + 1, axis=0)[at, :, ::-1]
    return seen, windows.reshape(len(at), signals.shape[1] * (levels.LAW_PAST + 1))
