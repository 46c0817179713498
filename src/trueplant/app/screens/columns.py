"""The columns of a project's record: a small trend of each, the modes that stand in it, and what its name says."""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import polars as pl

from trueplant.app import levels as app_levels
from trueplant.app.screens.decimate import Signal, edges_of
from trueplant.project import Project
from trueplant.project.look import of_tag
from trueplant.project.tags import Role, meaning_of
from trueplant.record import levels
from trueplant.record.long import long_parts
from trueplant.record.modes import is_automatic, same_mode
from trueplant.record.numbers import no_measurements
from trueplant.record.readers import read_table
from trueplant.record.table import Table

POINTS = 90
"""Stretches of a small trend."""
KEPT = 4
MOST_COLUMNS = 400
"""Whose trends are drawn; the others can be chosen by their names."""

Certainty = Literal["sure", "likely", "chosen", "none"]
"""How surely a column is what it is taken for: by its name, likely by its name, by the user's choice; none is named."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column or tag."""

    name: str
    unit: str
    trend: tuple[tuple[float, float] | None, ...]
    """Lowest and highest of each stretch, between 0 and 1; None for a gap. Empty where it holds no numbers."""
    low: float | None
    high: float | None
    modes: Mapping[str, int] | None
    """The values and how often each is there; None where there are too many for modes."""

    def to_dict(self) -> dict[str, Any]:
        """Of a page."""
        return {"name": self.name, "unit": self.unit, "trend": self.trend, "low": self.low, "high": self.high}


def columns_of(table: Table, tag: str, value: str) -> list[Column]:
    """Those of a wide table, the tags of a long one."""
    parts = long_parts(table, tag, value)
    if parts is None:
        return [_column(table, name, table.units.get(name, "")) for name in table.frame.columns[:MOST_COLUMNS]]
    tags = parts.tags[:MOST_COLUMNS]
    return [_column(of_tag(table, parts, name), name, parts.units.get(name, "")) for name in tags]


def _column(table: Table, name: str, unit: str) -> Column:
    modes = _modes(table.frame[name])
    dtype = table.frame[name].dtype
    if dtype.is_temporal() or dtype.is_nested():
        return Column(name, unit, (), None, None, None)
    x, words = table.numbers(name)
    if words.mean() > levels.MOSTLY or not np.isfinite(x).any():
        return Column(name, unit, (), None, None, modes)
    x = np.where(no_measurements(x), np.nan, x)
    known = x[np.isfinite(x)]
    # spikes would make a flat line of everything else
    low, high = np.quantile(known[:: max(1, known.size // 100_000)], [0.002, 0.998])
    t = np.arange(x.size, dtype=float)
    bottom, top = Signal.of(x).extremes(edges_of(t, 0.0, t[-1], POINTS))
    width = high - low or 1.0
    scaled = np.clip(np.stack([bottom, top], axis=1) - low, 0.0, width) / width if high > low else None
    trend = [
        None if np.isnan(a) else (0.5, 0.5) if scaled is None else (float(scaled[k, 0]), float(scaled[k, 1]))
        for k, a in enumerate(bottom.tolist())
    ]
    rounded = tuple(None if pair is None else (round(pair[0], 3), round(pair[1], 3)) for pair in trend)
    return Column(name, unit, rounded, float(known.min()), float(known.max()), modes)


def _modes(series: pl.Series) -> Mapping[str, int] | None:
    if series.dtype.is_temporal() or series.dtype.is_nested():
        return None
    if series.head(app_levels.HEAD).n_unique() > levels.MOST_MODES:  # of ten million numbers that is told in no time
        return None
    cells = series.cast(pl.String).str.strip_chars().drop_nulls()
    counts = Counter(dict(cells.value_counts(sort=True, name="n").head(levels.MOST_MODES + 1).rows()))
    return dict(counts) if 0 < len(counts) <= levels.MOST_MODES else None


class Columns:
    """Of the records that were seen last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[Hashable, list[Column]] = OrderedDict()

    def of(self, project: Project) -> list[Column]:
        """The columns of the first record of a project. Raises what the readers raise."""
        plan, data = project.experiments[0], project.data
        path = plan.path
        status = path.stat() if path.is_file() else None
        seen = status and (status.st_mtime_ns, status.st_size)
        key = (path, seen, data.separator, data.encoding, data.sheet, data.tag, data.value)
        with self._lock:
            if key not in self._kept:
                table = read_table(path, separator=data.separator, encoding=data.encoding, sheet=data.sheet)
                self._kept[key] = columns_of(table, data.tag, data.value)
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            return self._kept[key]


def certainty(column: str | None, role: Role, status: bool = False) -> Certainty:
    """How surely a column is a loop's PV, SP, OP or mode, or the quality of that."""
    if not column:
        return "none"
    meaning = meaning_of(column)
    if meaning.role != role or meaning.status != status:
        return "chosen"
    return "likely" if meaning.weak else "sure"


def automatic(mode: str, declared: Sequence[object]) -> bool | None:
    """Does this mode count as automatic; None where nobody knows."""
    return any(same_mode(mode, one) for one in declared) if declared else is_automatic(mode)
