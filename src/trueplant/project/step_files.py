"""Step coefficients and impulse responses, mostly from files with a column an element: CSV, Parquet or XLSX."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import DataError
from trueplant.lti import MeasuredStep
from trueplant.lti.measured import Kind
from trueplant.project import levels
from trueplant.record.table import Table


def element_name(output: str, source: str) -> str:
    """What the column of an element is called."""
    return f"{source} -> {output}"


def chosen_column(table: Table, column: str | None, time: str | None, name: str) -> str:
    """The column of the element called `name`: the one declared, the one with its name, or the only one."""
    others = [one for one in table.names if one != time]
    if column is not None or name in others:
        return column or name
    if len(others) == 1:
        return others[0]
    shown = ", ".join(others[: levels.SHOWN_COLUMNS])
    raise DataError(f'{table.source} has several columns and none is called "{name}": say column = ... It has: {shown}')


def step_of(table: Table, column: str, times: float | str, kind: Kind = "step", ramp: bool = False) -> MeasuredStep:
    """One column as a step response. `times` is the column of its times, or the sample time: the first coefficient is
    then that of one sample after the step.

    Raises DataError for what is no number, times that are not even, and what `checked_step` refuses.
    """
    values = _numbers(table, column)
    h, at_zero = _spacing(table, times) if isinstance(times, str) else (times, False)
    start = values[:1] if at_zero else np.zeros(1)
    try:
        return checked_step(values[1:] if at_zero else values, h, kind, ramp, float(start[0]))
    except DataError as error:
        raise DataError(f"{table.source}, column {column!r}: {error}") from None


def checked_step(
    coefficients: Array, sample_time: float, kind: Kind = "step", ramp: bool = False, direct: float = 0.0
) -> MeasuredStep:
    """Coefficients (n,) from one sample after the step on, and the `direct` one at the step itself.

    Raises DataError for too few coefficients, a response that is cut off, and a ramp that is none.
    """
    if coefficients.size < levels.FEWEST_COEFFICIENTS:
        raise DataError(
            f"{coefficients.size} coefficients are too few to tell a response ({levels.FEWEST_COEFFICIENTS} are the "
            "least): give all of them until it has settled"
        )
    values = np.concatenate([[direct], coefficients])
    measured = MeasuredStep(np.cumsum(values) if kind == "fir" else values, sample_time, ramp)
    if measured.settled == ramp and not measured.settled_is_unclear and measured.size > 0:
        raise DataError(
            "the response comes to rest, and ramp = true says that it does not: leave ramp out"
            if ramp
            else "the response still moves at its last coefficient: give all of them until it has settled, or say "
            "that it integrates (ramp = true; --ramp for trueplant convert) or that these are step coefficients (kind)"
        )
    return measured


def _spacing(table: Table, time: str) -> tuple[float, bool]:
    """The sample time, and whether the first coefficient is that at the step itself."""
    t = _numbers(table, time)
    steps = np.diff(t)
    h = float((t[-1] - t[0]) / max(steps.size, 1))
    if not (h > 0 and np.all(np.abs(steps - h) <= levels.EVEN * h)):
        k = int(np.argmax(np.abs(steps - h))) if steps.size else 0
        raise DataError(
            f"{table.source}, {table.where(k + 1)}: the times in {time!r} are not even: resample the response"
        )
    first = t[0] / h
    if min(abs(first), abs(first - 1)) > levels.EVEN:
        raise DataError(
            f"{table.source}: the times in {time!r} begin at {t[0]:g}: they count from the step, so begin at 0 or "
            f"at the first sample after it ({h:g})"
        )
    return h, first < 0.5


def _numbers(table: Table, column: str) -> Array:
    values, _ = table.numbers(column)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        k = int(bad[0])
        shown = table.column(column)[k]
        what = "is empty" if shown is None else f"holds {str(shown)[: levels.SHOWN_CHARACTERS]!r}, which is no number"
        raise DataError(f"{table.source}, {table.where(k)}: column {column!r} {what}: correct it")
    # the reader passes over empty lines, which among coefficients are missing ones
    lines = range(len(table)) if table.lines is None else [table.lines[k] for k in range(len(table))]
    for before, line in pairwise(lines):
        if line > before + 1:
            raise DataError(f"{table.source}, line {before + 1} is empty or holds no coefficients: correct it")
    return values
