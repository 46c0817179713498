"""What the published detectors work on: model errors beside the part of OP that set-points drive.

In closed loop OP answers disturbances too, so that it is related to the model's error without any mismatch.
All detectors here therefore look at the part of OP that the set-points explain (open loop: at OP itself), and
take their thresholds from the same errors shifted circularly against it: that keeps their colour and undoes
any relation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.detect import levels
from trueplant.errors import TrueplantError
from trueplant.lti import TransferMatrix
from trueplant.lti.sampled import sampled_response
from trueplant.record import Segment


@dataclass(frozen=True, eq=False)
class Detection:
    """What a detector says of each element (n_y, n_u)."""

    method: str
    statistic: Array
    """(n_y, n_u), NaN where there is none."""
    threshold: Array
    """(n_y, n_u), familywise over the matrix."""
    flagged: BoolArray
    """(n_y, n_u)."""
    note: str = ""
    refusal: str | None = None
    """Why it does not apply to these data; then nothing is flagged."""
    kinds: tuple[tuple[str, ...], ...] = ()
    """[n_y][n_u] what has changed, from the detectors that tell it."""


def refused(method: str, shape: tuple[int, int], why: str) -> Detection:
    """A detector that does not apply."""
    return Detection(method, np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool), refusal=why)


def flagged(method: str, statistic: Array, threshold: Array | float, note: str = "") -> Detection:
    """A detection by a statistic that exceeds its threshold."""
    limit = np.broadcast_to(np.asarray(threshold, dtype=float), statistic.shape).copy()
    return Detection(method, statistic, limit, np.asarray(statistic > limit), note)


class NotApplicable(TrueplantError):
    """A published detector does not apply to these data."""


@dataclass(frozen=True, eq=False)
class Signals:
    """One stretch of data as the detectors see it, all in deviations from the mean; time first."""

    segment: Segment
    """Where they come from."""
    pick: slice
    """The samples of the segment that were taken."""
    h: float
    lags: int
    """How far back the plant and its loop are thought to remember."""
    outer: Array
    """(N, n) what moves from outside: the set-points that move, in open loop OP."""
    u: Array
    """(N, n_u)."""
    driven: Array
    """(N, n_u) the part of u that `outer` explains."""
    y: Array
    """(N, n_y)."""
    e: Array
    """(N, n_y) y minus the model's output."""


def signals_of(segments: Sequence[Segment], model: TransferMatrix) -> Signals:
    """The longest segment that has set-point moves (OP moves in open loop), decimated to at most MOST_LAGS lags.

    Missing PVs are interpolated. What a record that starts in motion owes to its past is left out.
    Raises NotApplicable where nothing moves from outside or too little is left.
    """
    segment = max(segments, key=len)
    outer = segment.r if segment.closed else segment.u
    moving = segment.setpoints if segment.closed else segment.u
    outer = outer[:, np.isfinite(outer).all(axis=0) & (np.ptp(moving, axis=0) > 0)]
    if outer.shape[1] == 0:
        moved = "set-point" if segment.closed else "OP"
        raise NotApplicable(f"no {moved} moves in the longest stretch of data")
    error, y = model_error(segment, model)
    memory = memory_of(model)
    stride = max(1, int(np.ceil(memory / (levels.MOST_LAGS * segment.h))))
    lags = int(np.clip(np.ceil(memory / (stride * segment.h)), 5, levels.MOST_LAGS))
    first = 0 if starts_at_rest(segment) else min(lags * stride, len(segment) // 5)
    pick = slice(first, None, stride)
    outer, u, y, error = (centred(x[pick]) for x in (outer, segment.u, y, error))
    if len(u) < 4 * lags * outer.shape[1]:
        raise NotApplicable(
            f"{len(u)} samples are too few for {lags} lags of each of {outer.shape[1]} signals: "
            "use a longer stretch of data"
        )
    driven = centred(explained(lagged(outer, lags), u)) if segment.closed else u
    return Signals(segment, pick, segment.h * stride, lags, outer, u, driven, y, error)


def memory_of(model: TransferMatrix) -> float:
    """Dead time and three lags (95 % of the answer) of the slowest element; NotApplicable without one."""
    spans = [
        max(t.dead_time for t in cell.terms) + 3 * max((1 / abs(p.real) for p in cell.poles if p.real < 0), default=0.0)
        for row in model.elements
        for cell in row
        if not cell.is_zero
    ]
    if not spans:
        raise NotApplicable("there is no model to compare with")
    return max(spans)


def model_error(segment: Segment, model: TransferMatrix) -> tuple[Array, Array]:
    """y minus the model's output from the recorded OP, and y, (N, n_y); missing PVs are interpolated."""
    inputs = np.hstack([segment.u, segment.d])
    inputs = inputs - inputs[0]
    hold = segment.holds
    y = np.column_stack([_filled(column) for column in segment.y.T])
    error = y.copy()
    for i, row in enumerate(model.elements):
        for j, system in enumerate(row):
            if not system.is_zero:
                error[:, i] -= sampled_response(system, np.ascontiguousarray(inputs[:, j]), segment.h, hold[j])
    return error, y


def starts_at_rest(segment: Segment) -> bool:
    """Does OP stand still for the first samples?"""
    return bool(np.all(segment.u[:5] == segment.u[0]))


def _filled(y: Array) -> Array:
    good = np.flatnonzero(np.isfinite(y))
    if good.size < 2:
        raise NotApplicable("a PV is missing throughout")
    return np.interp(np.arange(y.size), good, y[good])


def centred(x: Array) -> Array:
    return np.asarray(x - x.mean(axis=0))


def lagged(x: Array, lags: int) -> Array:
    """(N, n (lags + 1)) x and its past, zero before the start; column c (lags + 1) + k is signal c, k samples ago."""
    n, width = x.shape
    out = np.zeros((n, width, lags + 1))
    for k in range(lags + 1):
        out[k:, :, k] = x[: n - k]
    return out.reshape(n, width * (lags + 1))


def basis(columns: Array) -> Array:
    """Orthonormal basis (N, rank) of the columns, directions lost in rounding dropped."""
    scale = np.linalg.norm(columns, axis=0)
    scaled = columns[:, scale > 0] / scale[scale > 0]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    use = values > 1e-10 * max(float(values.max(initial=0.0)), 1e-300)
    return np.asarray(scaled @ (vectors[:, use] / np.sqrt(values[use])))


def explained(columns: Array, x: Array) -> Array:
    """The part of x that lies in the span of the columns."""
    q = basis(columns)
    return np.asarray(q @ (q.T @ x))


def shifted(e: Array, lags: int, count: int = levels.SHIFTS, seed: int = 0) -> Array:
    """(N, 1 + count, n) e as it is, then shifted circularly by random amounts beyond the lags, both ways."""
    n = e.shape[0]
    least = min(lags + 1, n // 3)
    by = np.random.default_rng(seed).integers(least, n - least, size=count)
    index = (np.arange(n)[:, None] - np.concatenate([[0], by])[None, :]) % n
    return np.asarray(e[index])


def beyond_shifts(statistics: Array, level: float) -> tuple[Array, float]:
    """From statistics (1 + shifts, n_y, n_u), the first of the data: those of the data, and the threshold.

    The threshold is exceeded by the largest of the matrix in a share `level` of the shifts.
    """
    largest = statistics[1:].reshape(statistics.shape[0] - 1, -1).max(axis=1)
    return statistics[0], float(np.quantile(largest, 1 - level))
