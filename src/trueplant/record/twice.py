"""Samples that several records hold: counted once where they agree, an error where they contradict each other.

Two exports of the same days would tell everything twice, and intervals would come out too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.calendar import unit_seconds
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.resolution import resolution
from trueplant.record.types import Finding, Kind, Record

Spans = Sequence[tuple[float, float]]


def counted_once(records: Sequence[Record], excluded: Sequence[Spans]) -> list[Record]:
    """The records, each without the samples that one before it holds too; `excluded` are left out of each anyway.

    Raises DataError for records of the same content, for one that holds nothing of its own, and for records that differ
    where they overlap in time.
    """
    found: list[Record] = []
    for k, record in enumerate(records):
        for before, spans in zip(found, excluded, strict=False):
            record = _without(_Part(before, _used(before, spans)), _Part(record, _used(record, excluded[k])))
        found.append(record)
    return found


@dataclass(frozen=True, eq=False)
class _Part:
    """A record and what of it is used."""

    record: Record
    used: BoolArray
    """(N,)"""

    @property
    def signals(self) -> Array:
        """(n, m) what was recorded of OPs and PVs."""
        return np.hstack([self.record.u, self.record.y])[self.used]

    @property
    def t(self) -> Array:
        return self.record.t[self.used]


def _used(record: Record, spans: Spans) -> BoolArray:
    used = np.ones(record.t.size, dtype=bool)
    for start, end in spans:
        used &= (record.t < start) | (record.t > end)
    return used


def _without(one: _Part, other: _Part) -> Record:
    """The other record without the samples that the first holds too."""
    record, names = other.record, f"{one.record.name} and {other.record.name}"
    if min(one.t.size, other.t.size) < levels.FEWEST_ROWS:
        return record
    if _equal(one.signals, other.signals):
        raise DataError(f"{names} hold the same samples, which would be counted twice: leave one of them out")
    offset = _offset(one.record, record)
    if offset is None:
        return record
    t = other.t + offset
    at = np.clip(np.searchsorted(one.t, t), 1, one.t.size - 1)
    at -= t - one.t[at - 1] < one.t[at] - t
    apart = np.abs(one.t[at] - t)
    step = min(one.record.sample_time, record.sample_time)
    same = apart <= levels.SAME_INSTANT * step
    near = same | (t > one.t[0]) & (t < one.t[-1]) & (apart < step)
    agree = _agree(one.signals[at[same]], other.signals[same])
    if one.record.start is None:
        # numbers that begin anywhere, most often at 0: only what was recorded can say that it is the same
        if not same.any() or not agree.all() or not _moves(other.signals[same]):
            return record
    elif not near.any():
        return record
    elif not agree.all() or not same.any():
        where = record.t[other.used][near]
        raise DataError(
            f"{names} overlap in time ({record.calendar.span(where[0], where[-1])} of {record.name}), and their "
            "samples differ there: leave one of them out, or exclude that stretch of it (data.exclude)"
        )
    keep = np.ones(record.t.size, dtype=bool)
    keep[other.used] = ~near
    if not (keep & other.used).any():
        raise DataError(f"{record.name} holds nothing that {one.record.name} does not hold too: leave it out")
    return _cut(record, keep, one.record.name)


def _offset(one: Record, other: Record) -> float | None:
    """What to add to the time of the second to have that of the first; None where that is not known."""
    if one.start is None and other.start is None:
        return 0.0
    if one.start is None or other.start is None or (one.start.tzinfo is None) != (other.start.tzinfo is None):
        return None
    return (other.start - one.start).total_seconds() / unit_seconds(one.time_unit)


def _equal(a: Array, b: Array) -> bool:
    return a.shape == b.shape and _moves(a) and np.array_equal(a, b, equal_nan=True)


def _moves(signals: Array) -> bool:
    """Is there enough in them that two records cannot share by chance?"""
    known = signals[np.isfinite(signals).all(axis=1)]
    return len(known) >= levels.FEWEST_ROWS and bool(np.any(np.ptp(known, axis=0) > 0))


def _agree(a: Array, b: Array) -> BoolArray:
    """(n,) do samples (n, m) agree, to the digits that both were written with?"""
    out = np.ones(len(a), dtype=bool)
    for x, z in zip(a.T, b.T, strict=True):
        known = np.isfinite(x) & np.isfinite(z)
        if known.any():
            digits = max(resolution(x[known]), resolution(z[known]))
            out[known] &= np.abs(x[known] - z[known]) <= digits * (1 + levels.SAME_INSTANT)
    return out


def _cut(record: Record, keep: BoolArray, before: str) -> Record:
    count = int(np.sum(~keep))
    message = f"{count} samples that {before} holds too were counted there, and left out here."
    note = Finding(Kind.OVERLAP, "time", message, samples=count, value=float(np.mean(~keep)))
    names = ("t", "r", "u", "y", "d", "automatic", "slave_sp", "slave_pv")
    kept = {name: value[keep] for name in names if (value := getattr(record, name)) is not None}
    return replace(record, notes=(*record.notes, note), **kept)
