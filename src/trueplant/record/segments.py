"""From a screened record to stretches on a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.record import levels
from trueplant.record.resolution import Settled
from trueplant.record.runs import hold_same, hold_short, spread, true_runs
from trueplant.record.types import Record, Segment, Stamps


@dataclass(frozen=True, eq=False)
class Clock:
    """How a record is sampled."""

    h: float
    uniform: bool
    """False if the samples have to be interpolated onto a grid."""
    jitter: float
    """Root mean square of the deviations of the steps from whole multiples of h, in h."""
    gap: float
    """Steps longer than this begin a new segment."""


def clock_of(t: Array) -> Clock:
    """The sample time of a record, and whether its stamps are on a grid (or only rounded, or jittering a little)."""
    steps = np.diff(t)
    middle = float(np.median(steps))
    few, many = levels.EVEN_STEPS
    h = float(np.mean(steps[(steps >= few * middle) & (steps <= many * middle)]))
    count = np.round(steps / h)
    inner = (count >= 1) & (count <= levels.SHORT_GAP)
    if inner.any():
        h = float(np.sum(steps[inner]) / np.sum(count[inner]))
        count = np.round(steps / h)
    near = steps <= (levels.SHORT_GAP + 0.5) * h
    jitter = float(np.sqrt(np.mean((steps[near] / h - np.maximum(count[near], 1)) ** 2))) if near.any() else 0.0
    uniform = jitter < levels.JITTER or _rounded(t, steps, h, near)
    if uniform:
        return Clock(float(h), True, jitter, (levels.SHORT_GAP + 0.5) * h)
    longest = (levels.SHORT_GAP + 0.5) * max(middle, float(np.quantile(steps, levels.LONG_STEP)))
    return Clock(middle, False, jitter, min(longest, levels.MOST_INTERPOLATED * middle))


def _rounded(t: Array, steps: Array, h: float, near: BoolArray) -> bool:
    """True if the stamps of an even sampling were merely rounded, say to full seconds."""
    kinds = np.unique(np.round(steps[near] / h, 6)) * h
    if kinds.size < 2 or kinds.size > levels.ROUNDED_KINDS:
        return False
    q = float(np.min(np.diff(kinds)))
    whole = np.all(np.abs(kinds / q - np.round(kinds / q)) < levels.ROUNDED_WHOLE)
    drift = np.where(near, steps - h * np.maximum(np.round(steps / h), 1), 0.0)
    even = np.ptp(np.cumsum(drift)) <= levels.ROUNDED_DRIFT * q
    return bool(whole and even and q < levels.ROUNDED_UNIT * h)


def between_parts(excluded: BoolArray) -> BoolArray:
    """(N,) of what was excluded the stretches that are at least as long as each of the parts that they separate.

    The parts are records of their own then: how OP came from one to the other tells nothing of either.
    """
    begin, length = true_runs(excluded)
    kept = np.append(begin, excluded.size) - np.concatenate([[0], begin + length])
    parts = length >= np.maximum(kept[:-1], kept[1:])
    return spread(begin[parts], length[parts], excluded.size)


def segments_of(
    given: Settled, usable: BoolArray, free: BoolArray, clock: Clock, experiment: int, *, left_out: BoolArray
) -> tuple[Segment, ...]:
    """Cut at gaps, where OP is missing for long and at what is left out; put each piece on a grid, drop short ones.

    u and d are held, y is NaN where it is not usable, each segment begins and ends with a usable PV.
    """
    record, settled = given.record, hold_same(given.setpoints)
    same = given.setpoints is record.r
    r = settled if same else np.where(np.isnan(record.r), settled, record.r)
    r, u, d = (hold_short(x, levels.SHORT_GAP)[0] for x in (r, record.u, record.d))
    settled = r if same else hold_short(settled, levels.SHORT_GAP)[0]
    lost = np.isfinite(record.y) & ~usable
    y = np.where(lost, np.nan, record.y) if lost.any() else record.y
    whole = _Signals(record.t, r, settled, u, y, d, free)
    known = np.isfinite(u).all(axis=1) & np.isfinite(d).all(axis=1) & ~left_out
    cut = np.concatenate([[False], np.diff(record.t) > clock.gap])
    out: list[Segment] = []
    for begin, length in zip(*true_runs(known), strict=True):
        inside = np.flatnonzero(cut[begin + 1 : begin + length]) + begin + 1
        edges = [int(begin), *map(int, inside), int(begin + length)]
        for a, b in pairwise(edges):
            some = np.flatnonzero(np.isfinite(whole.y[a:b]).any(axis=1))
            if some.size < levels.SHORTEST:
                continue
            piece = slice(a + int(some[0]), a + int(some[-1]) + 1)
            segment = _on_grid(whole.part(piece), clock, record, experiment)
            if len(segment) >= levels.SHORTEST:
                out.append(segment)
    return tuple(out)


@dataclass(frozen=True, eq=False)
class _Signals:
    """What of a record can be used, on its own samples t (N,): short gaps held, PV NaN where it is not usable."""

    t: Array
    r: Array
    settled: Array
    u: Array
    y: Array
    d: Array
    free: BoolArray

    def part(self, piece: slice) -> _Signals:
        return _Signals(*(getattr(self, f.name)[piece] for f in fields(self)))


def _on_grid(own: _Signals, clock: Clock, record: Record, experiment: int) -> Segment:
    """One stretch of a record without gaps."""
    t, h = own.t, clock.h
    if clock.uniform:
        # cumulated rounding of single steps follows a clock that drifts against its own mean step
        step = np.maximum(np.round(np.diff(t) / h), 1)
        if np.all(step == 1):
            return _segment(own, t[0] + h * np.arange(t.size), clock, record, experiment)
        place = np.concatenate([[0], np.cumsum(step)]).astype(np.int64)
        grid = t[0] + h * np.arange(place[-1] + 1)
        latest = np.searchsorted(place, np.arange(place[-1] + 1), side="right") - 1
        placed = np.full((grid.size, own.y.shape[1]), np.nan)
        placed[place] = own.y
    else:
        grid = t[0] + h * np.arange(int(np.floor((t[-1] - t[0]) / h + 1e-9)) + 1)
        latest = np.searchsorted(t, grid + 1e-9 * h, side="right") - 1
        placed = np.column_stack([_between(grid, t, column, levels.NEAR * h) for column in own.y.T])
    r, settled, u, d = own.r[latest], own.settled[latest], own.u[latest], own.d[latest]
    if not clock.uniform:
        # what acts from one instant of the grid to the next is the mean of what was held meanwhile
        r, settled, u = (_mean_held(grid, h, t, x, latest) for x in (own.r, own.settled, own.u))
        for k, x in enumerate(own.d.T):
            held = record.d_hold[k : k + 1] == ("zoh",)
            d[:, k] = _mean_held(grid, h, t, x[:, None], latest)[:, 0] if held else np.interp(grid, t, x)
    segment = _segment(_Signals(t, r, settled, u, placed, d, own.free[latest]), grid, clock, record, experiment)
    if clock.uniform:
        return segment
    # a held disturbance is half a sample later than straight lines through its samples
    d_timing = tuple(0.0 if hold else h / 2 for hold in record.d_hold)
    return replace(segment, stamps=Stamps(t, own.u, own.d, np.isfinite(own.y)), d_timing=d_timing)


def with_held_disturbance(segment: Segment, k: int) -> Segment:
    """With a measured disturbance as a held signal, its instants known."""
    d, held = segment.d.copy(), list(segment.holds[segment.u.shape[1] :])
    held[k] = "zoh"
    if segment.stamps is not None:
        t = segment.stamps.t
        latest = np.searchsorted(t, segment.t + 1e-9 * segment.h, side="right") - 1
        d[:, k] = _mean_held(segment.t, segment.h, t, segment.stamps.d[:, [k]], latest)[:, 0]
    return with_known_instants(replace(segment, d=d, d_hold=tuple(held)), k)


def with_known_instants(segment: Segment, k: int) -> Segment:
    """With a measured disturbance of which is known how it runs between odd instants."""
    return replace(segment, d_timing=tuple(0.0 if j == k else one for j, one in enumerate(segment.d_timing)))


def read_between(segment: Segment, i: int, y: Array) -> Array:
    """(N,) of the grid what its stamps' samples y (M,) become there, as PV i did; NaN where that is not used."""
    assert segment.stamps is not None
    known = np.where(segment.stamps.known[:, i], y, np.nan)
    return _between(segment.t, segment.stamps.t, known, levels.NEAR * segment.h)


def _segment(own: _Signals, grid: Array, clock: Clock, record: Record, experiment: int) -> Segment:
    """Signals that are on a grid already."""
    return Segment(
        experiment=experiment,
        h=clock.h,
        t=grid,
        r=own.r,
        u=own.u,
        y=own.y,
        d=own.d,
        free=own.free,
        hold=record.hold,
        closed=record.closed,
        d_hold=tuple(hold or "linear" for hold in record.d_hold),
        settled=None if np.array_equal(own.r, own.settled, equal_nan=True) else own.settled,
    )


def _mean_held(grid: Array, h: float, t: Array, x: Array, latest: IntArray) -> Array:
    """(N, n) mean over [grid, grid + h) of signals that hold each sample's value until the next.

    Where nothing moves meanwhile it is the value itself, `latest` being the sample that each instant begins with: sums
    over a whole record would leave their rounding there. Where a value is missing meanwhile it is the latest one too.
    """
    step, first = np.diff(t, append=t[-1] + h), np.nan_to_num(x[0])
    area = np.vstack([np.zeros(x.shape[1]), np.cumsum((x - first) * step[:, None], axis=0)])
    edges = np.append(t, t[-1] + h)
    ends = np.minimum(np.append(grid, grid[-1] + h), edges[-1])
    until = np.column_stack([np.interp(ends, edges, column) for column in area.T])
    width = np.maximum(np.diff(ends), 1e-12 * h)
    mean = first + np.diff(until, axis=0) / width[:, None]
    last = np.searchsorted(t, ends[1:], side="left") - 1
    moves = np.vstack([np.zeros(x.shape[1], dtype=int), np.cumsum(np.diff(x, axis=0) != 0, axis=0)])
    return np.where((moves[last] != moves[latest]) & np.isfinite(mean), mean, x[latest])


def _between(grid: Array, t: Array, y: Array, farthest: float) -> Array:
    """Linear interpolation between usable samples that are near each other, NaN elsewhere."""
    good: IntArray = np.flatnonzero(np.isfinite(y))
    if good.size < 2:
        return np.full(grid.size, np.nan)
    x, v = t[good], y[good]
    value = np.interp(grid, x, v, left=np.nan, right=np.nan)
    right = np.clip(np.searchsorted(x, grid), 1, x.size - 1)
    on_sample = np.minimum(np.abs(grid - x[right]), np.abs(grid - x[right - 1])) <= 1e-6 * farthest
    return np.where((x[right] - x[right - 1] <= farthest) | on_sample, value, np.nan)
