"""Rows in the order of time, without empty or repeated stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.calendar import Calendar
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.numbers import counted
from trueplant.record.table import Table
from trueplant.record.times import Times
from trueplant.record.types import Finding, Kind

_COARSE = ((86400.0, "days", "the clock"), (3600.0, "hours", "minutes"), (60.0, "minutes", "seconds"))
"""Stamps that are whole so many seconds: what they hold, and what they lack."""
_NUMBERS = "the times may lack digits: if rows were recorded more often, export them with all of theirs."


def put_in_order(table: Table, times: Times) -> tuple[NDArray[np.int64], tuple[Finding, ...]]:
    """Rows in increasing time, without empty or repeated stamps.

    Raises DataError where time runs backwards for more than single rows.
    """
    t = times.seconds
    if np.all(np.diff(t) > 0):
        return np.arange(t.size), ()
    rows = np.flatnonzero(np.isfinite(t))
    notes: list[Finding] = []
    if rows.size < t.size:
        lost = np.flatnonzero(~np.isfinite(t))
        if lost.size > max(1, levels.LOST_TIMES * t.size):
            raise DataError(
                f"{table.source}, {table.where(int(lost[0]))}: {counted(lost.size, 'row')} without a time; "
                "complete or delete them"
            )
        message = f"{counted(lost.size, 'row')} without a time left out (first: {table.where(int(lost[0]))})."
        notes.append(Finding(Kind.MISSING, "time", message, samples=int(lost.size), excludes=True))
    steps = np.diff(t[rows])
    if steps.size and np.mean(steps < 0) > levels.MOSTLY and np.all(steps <= 0):
        rows = rows[::-1]
        notes.append(
            Finding(Kind.BACKWARDS, "time", "The file runs from the latest to the earliest time; it was reversed.")
        )
    late = np.flatnonzero(t[rows] < np.maximum.accumulate(t[rows]))
    if late.size > max(1, levels.LOST_TIMES * rows.size):
        k = int(late[0])
        calendar = Calendar("s", times.start, times.zone)
        shown = f"{calendar.text(t[rows[k - 1]])} to {calendar.text(t[rows[k]])}"
        hint = ""
        back = t[rows[k - 1]] - t[rows[k]]
        least, most = levels.CLOCK_CHANGE
        if times.start is not None and times.start.tzinfo is None and least <= back < most:
            hint = " if this is the autumn change of the clock, give `time_zone`;"
        raise DataError(
            f"{table.source}, {table.where(int(rows[k]))}: time runs backwards ({shown});{hint} "
            "sort the file, or split it into one file for each run"
        )
    if late.size:
        rows = rows[np.argsort(t[rows], kind="stable")]
        message = f"{counted(late.size, 'row')} out of order, sorted in (first: {table.where(int(late[0]))})."
        notes.append(Finding(Kind.BACKWARDS, "time", message, samples=int(late.size)))
    keep = np.diff(t[rows], prepend=-np.inf) > 0
    if not keep.all():
        first = int(rows[np.argmin(keep)])
        count = int(np.sum(~keep))
        message = f"{counted(count, 'row')} with the time of the row before left out (first: {table.where(first)})."
        coarse = count > levels.REPEATED_TIMES * rows.size
        if coarse:
            finer = _NUMBERS if times.start is None else _finer(t[rows])
            message = f"{message} These are {100 * count / rows.size:.0f} % of all, and {finer}"
        share = count / rows.size if coarse else None
        notes.append(Finding(Kind.DUPLICATE, "time", message, samples=count, excludes=True, value=share))
        rows = rows[keep]
    return rows, tuple(notes)


def _finer(seconds: Array) -> str:
    """What to do where many stamps (N,), counted from one of them, are repeated."""
    held, lacks = next(
        ((held, lacks) for size, held, lacks in _COARSE if not np.any(seconds % size)),
        ("seconds", "fractions of a second"),
    )
    return f"the stamps hold whole {held}: if rows were recorded more often, export the stamps with {lacks}."
