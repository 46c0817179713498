"""Parts of a result that are shown whole: one level at a time, under the names that result.json has."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueplant.report.labels import label
from trueplant.result.codec import entries_of


@dataclass(frozen=True)
class Table:
    """Headings, and rows of as many values."""

    headings: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]


def is_record(value: object) -> bool:
    """Something with named entries: an object of a class, or a mapping."""
    return isinstance(value, Mapping) or (dataclasses.is_dataclass(value) and not isinstance(value, type))


def entries(value: object) -> Mapping[str, object]:
    """The entries of a record by their names, each as it is."""
    return value if isinstance(value, Mapping) else entries_of(value)


def as_table(records: Sequence[object]) -> Table:
    """A row for each record, and a column for each entry that any of them has."""
    found = [entries(one) for one in records]
    names = list(dict.fromkeys(name for row in found for name in row))
    return Table(tuple(map(label, names)), tuple(tuple(row.get(name) for name in names) for row in found))


def is_records(value: object) -> bool:
    """Several records: a table."""
    return isinstance(value, tuple) and bool(value) and all(map(is_record, value))


def is_spans(value: object) -> bool:
    """((from, to), ...)."""
    return isinstance(value, tuple) and bool(value) and all(map(_is_span, value))


def _is_span(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_finite, value))


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def is_missing(value: object) -> bool:
    """None, or a number that is not finite: result.json has null for both."""
    return value is None or (isinstance(value, float) and not math.isfinite(value))
