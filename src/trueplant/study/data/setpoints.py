"""Set-points that are computed from the PVs: by a master controller, or by tracking. They come from inside the loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.record import Segment
from trueplant.study import levels


def computed_setpoints(segments: Sequence[Segment]) -> BoolArray:
    """(n_y,) True where all moves of a set-point are a linear function of its own past and of the PVs.

    The moves of a set-point from one level to the next are regressed on its past levels, with and without present and
    past PVs of all outputs: at the moves, so that a computer that writes the set-point now and then is seen too. A
    copy of PV leaves rounding, an operator's steps are left as they are. What is periodic is foretold by its own past
    just as well as by the PVs that it moves, and does not count. Where too few moves tell, the answer is False.
    """
    closed = [s for s in segments if s.closed]
    n_y = segments[0].r.shape[1] if segments else 0
    return np.array([any(_follows(closed, i, few) for few in (True, False)) for i in range(n_y)], dtype=bool)


def _follows(segments: Sequence[Segment], i: int, few: bool) -> bool:
    """Is set-point i a function of the PVs, sought among few regressors (for few moves) or many?"""
    if segments and all(_copies(s.r[:, i], s.y[:, i], s.u) for s in segments):
        return True
    parts = [_rows(s, i, few) for s in segments if np.isfinite(s.r[:, i]).all()]
    parts = [p for p in parts if p is not None]
    if not parts:
        return False
    move, own, past, pvs = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    moves, columns = len(move), own.shape[1] + pvs.shape[1]
    if moves < levels.MOVES_PER_REGRESSOR * (columns + 2):
        return False
    energy, both = float(np.mean(move**2)), np.hstack([own, pvs])
    # the share below is no smaller than this one, which costs a tenth of it and answers nearly always
    triangle = np.asarray(np.linalg.qr(np.column_stack([both, move]), mode="r"))
    if triangle[-1, -1] ** 2 >= levels.UNEXPLAINED * energy * (moves - columns):
        return False
    foretold = float(np.mean(unexplained(move, past) ** 2))
    if foretold <= levels.PREDICTED * energy:
        return False
    left = unexplained(move, both)
    largest = float(np.max(np.abs(left)))
    share = float(np.sum(left**2)) / (moves - columns) / foretold
    return share < levels.UNEXPLAINED and largest < levels.SURPRISE * float(np.sqrt(energy))


def _copies(r: Array, y: Array, u: Array) -> bool:
    """Is the set-point nothing but PV, though OPs move, which they would not without a control error?"""
    known = np.isfinite(y)
    moves = known.any() and np.ptp(r[known]) > 0 and np.any(np.ptp(u, axis=0) > 0)
    return bool(moves and np.array_equal(r[known], y[known]))


def _rows(segment: Segment, i: int, few: bool) -> tuple[Array, Array, Array, Array] | None:
    """At each move of set-point i: its size, its last levels, a longer past of it, and the PVs."""
    r, y = segment.setpoints[:, i], segment.y
    lags, past_levels, before = (1, 1, 0) if few else (levels.SETPOINT_LAGS, levels.SETPOINT_LEVELS, 2)
    at = np.flatnonzero(np.diff(r) != 0) + 1
    width = 2 + past_levels + y.shape[1] * (lags + 2 + 2 * before)
    first = max(past_levels, before, 1)
    if len(at) <= first:
        return None
    held = np.concatenate([r[at[:1] - 1], r[at]])  # level before and after each move
    k = np.arange(first, len(at))
    k = k[at[k - before] > lags][-levels.SETPOINT_MOVES :]
    if k.size == 0:
        return None
    t, one = at[k], np.ones((k.size, 1))
    own = np.hstack([one, *[held[k - j, None] for j in range(past_levels)]])
    longer = np.hstack([own, *[r[np.maximum(t - 1 - j, 0), None] for j in range(width)]])
    pvs = []
    since = at[k - 1]
    for j, column in enumerate(y.T):
        if not np.isfinite(column).any():
            column = np.zeros(len(y))
        total = np.add.reduceat(column, at)[k - 1]
        newest = 0 if _in_time(column, r if j == i else None, at) else 1
        pvs += [column[t - max(lag, newest)] for lag in range(lags + 1)]
        pvs += [total / (t - since)]
        pvs += [column[at[k - b] - lag] for b in range(1, before + 1) for lag in (0, 1)]
    seen = np.stack(pvs, axis=1)
    whole = np.isfinite(seen).all(axis=1)
    return (r[t] - r[t - 1])[whole], own[whole], longer[whole], seen[whole]


def _in_time(column: Array, r: Array | None, at: NDArray[np.intp]) -> bool:
    """Can PV at the instant of a move have been read before it? Not where it goes along, as that of a fast loop does.

    Where the set-point moves all the time, only its own PV (r given) can go along.
    """
    change = np.diff(column, prepend=column[0])
    moved = np.zeros(len(column), dtype=bool)
    moved[at] = True
    if moved.mean() <= 0.5:
        if not (np.isfinite(change[moved]).any() and np.isfinite(change[~moved]).any()):
            return False
        return bool(np.nanmean(change[moved] ** 2) <= levels.COINCIDENT * np.nanmean(change[~moved] ** 2))
    if r is None:
        return True
    both = moved & np.isfinite(change)
    step, asked = change[both], np.diff(r, prepend=r[0])[both]
    return float(step @ asked) < levels.ALONG * float(np.linalg.norm(step) * np.linalg.norm(asked))


def unexplained(now: Array, columns: Array, rcond: float = 1e-12) -> Array:
    """What least squares on the columns (n, m) leave of `now` (n,)."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left: Array = now - scaled @ np.linalg.lstsq(scaled, now, rcond=rcond)[0]
    return left
