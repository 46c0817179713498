"""Time columns: finding them, numbers with a unit, time stamps in many notations, clock changes, order."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.calendar import offset_name, unit_seconds, zone_of
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.guard import foreign
from trueplant.record.layout import Layout
from trueplant.record.stamps import FORMATS as MOMENTS
from trueplant.record.stamps import as_moments
from trueplant.record.table import Table
from trueplant.record.types import Finding, Kind

if TYPE_CHECKING:
    import polars as pl

ORDERS = ("dmy", "mdy", "ymd")
"""Of day, month and year in dates."""
FORMATS = (*ORDERS, *MOMENTS)
"""What a project can say of its time column."""
TIME_NAMES = ("t", "time", "timestamp", "datetime", "date", "zeit", "zeitstempel", "datum", "clock")
_DATE = r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{2,4}|\d{1,2}[- ][A-Za-z]{3}[- ]\d{2,4}"
_CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?[AP]M)?"
_ZONE = r"(:\d{2}(?:\.\d+)?(?: ?[AP]M)?) ?(Z|UTC|GMT|[+-]\d{2}:?\d{2}|[+-]\d{2})$"


_YEAR_1 = -62135596800 * 10**6
_YEAR_10000 = 253402300800 * 10**6
"""In microseconds since 1970."""


@dataclass(frozen=True, eq=False)
class Times:
    """Seconds of each row (NaN where the cell is empty), and when that count starts."""

    seconds: Array
    start: datetime | None = None
    """The moment at seconds = 0; None for numeric time."""
    zone: str | None = None
    """In which moments are to be shown; None where no zone is known."""
    notes: tuple[Finding, ...] = ()


_Stamps = tuple["pl.Series", str | None, tuple[Finding, ...]]
"""Moments; the zone in which they were written, from which they are in UTC now, None where none is known; and what
there is to say of them."""


def _bare(name: str) -> str:
    """A column name without its bracketed unit and decoration."""
    return re.sub(r"[\[(].*?[\])]", "", name).strip(" _").casefold().replace(" ", "").replace("_", "")


def find_time(table: Table, used: frozenset[str] = frozenset()) -> str:
    """The time column: one with a usual name, else the first of increasing numbers or time stamps."""
    import polars as pl

    bare = {_bare(n): n for n in reversed(table.names) if n not in used}
    for usual in TIME_NAMES:
        if usual in bare:
            return bare[usual]
    for name in table.frame.columns:
        if name in used:
            continue
        series = table.frame[name].head(levels.START_ROWS)
        if series.dtype.is_temporal():
            return name
        values, _ = table.numbers(name)
        if np.all(np.isfinite(values)) and values.size > 1 and np.all(np.diff(values) > 0):
            return name
        if series.dtype == pl.String and bool(series.drop_nulls().str.contains(rf"^\s*({_DATE})").all()):
            return name
    raise DataError(
        f"{table.source} has no column that looks like time; name it as `time` (init: --time). "
        f"It has: {', '.join(table.names[:30])}"
    )


def parse_times(table: Table, name: str, layout: Layout, groups: NDArray[np.int64] | None = None) -> Times:
    """Read a time column. `groups` tells rows of different tags apart, whose clocks run separately.

    Raises DataError (line and value) for stamps that cannot be read and for an unknown time zone.
    """
    series = table.column(name, "time")
    if series.dtype.is_nested() or str(series.dtype) in ("Binary", "Object", "Boolean"):
        raise DataError(f"{table.source}: column {name!r} holds {series.dtype}: no time; name another as `time`")
    read = _from_temporal(table, name) if series.dtype.is_temporal() else _from_cells(table, name, layout)
    if isinstance(read, Times):
        return read
    stamps, zone, notes = read
    if layout.time_zone is not None:
        declared = zone_of(layout.time_zone)
        if zone is None and isinstance(declared, timezone):
            stamps = stamps - declared.utcoffset(None)
        elif zone is None:
            stamps = _to_utc(table, stamps, layout.time_zone, groups)
        zone, notes = layout.time_zone, tuple(note for note in notes if note.kind is not Kind.ZONE)
    return _since_start(table, name, stamps, zone, notes)


def _from_cells(table: Table, name: str, layout: Layout) -> Times | _Stamps:
    """Times of a column of numbers or text."""
    values, words = table.numbers(name)
    if not words.any():
        return _from_numbers(table, name, values, layout)
    if bool((np.isfinite(values) & ~words).mean() > levels.MOSTLY):
        _refuse(table, name, int(np.argmax(words)))
    return _from_text(table, name, layout.time_format)


def _from_numbers(table: Table, name: str, values: Array, layout: Layout) -> Times | _Stamps:
    """A count of time units, or moments that numbers stand for."""
    import polars as pl

    if np.isnan(values).all():
        raise DataError(f"{table.source}: the time column {name!r} is empty; name another one as `time`")
    wild = (values > levels.LARGEST_VALUE) | (values < -levels.LARGEST_VALUE)
    if wild.any():
        row = int(np.argmax(wild))
        raise DataError(f"{table.source}, {table.where(row)}: {values[row]:g} is no time; correct it")
    unit = unit_seconds(layout.time_unit)
    wanted = layout.time_format
    where = f"{table.source}, column {name!r}"
    moments = as_moments(values, wanted, unit if layout.time_unit_declared else None, where)
    if moments is None:
        return Times(values * unit)
    known = np.isfinite(moments.seconds)
    micro = np.round(np.where(known, moments.seconds, 0.0) * 1e6).astype(np.int64)
    stamps = pl.select(pl.when(pl.Series(known)).then(pl.Series(micro)).otherwise(None)).to_series()
    stamps = stamps.cast(pl.Datetime("us"))
    message = f"{name}: numbers such as {values[known][0]:.15g} were read as moments ({moments.name})."
    return stamps, "UTC" if moments.utc else None, (Finding(Kind.TIME, "time", message),)


def _from_temporal(table: Table, name: str) -> _Stamps:
    """Stamps of a column of dates and times."""
    import polars as pl

    series = table.frame[name]
    if series.dtype == pl.Time or series.dtype == pl.Duration:
        raise DataError(f"{table.source}: {name!r} holds times without a date; give full time stamps or numbers")
    with foreign(f"{table.source}: column {name!r} holds dates that cannot be", "correct them"):
        stamps = series.cast(pl.Datetime("us", getattr(series.dtype, "time_zone", None)))
        zone: str | None = stamps.dtype.time_zone  # type: ignore[attr-defined]
        if zone is None:
            return stamps, None, ()
        return stamps.dt.convert_time_zone("UTC").dt.replace_time_zone(None), zone, ()


def _since_start(table: Table, name: str, stamps: pl.Series, zone: str | None, notes: tuple[Finding, ...]) -> Times:
    micro = stamps.dt.epoch("us")
    strange = ((micro < _YEAR_1) | (micro >= _YEAR_10000)).fill_null(False)
    if bool(strange.any()):
        raise DataError(
            f"{table.source}, {table.where(int(strange.arg_max() or 0))}, column {name!r}: a date outside of the years "
            "1 to 9999; correct it"
        )
    first = micro.min()
    if first is None:
        raise DataError(f"{table.source}: the time column {name!r} is empty; name another one as `time`")
    seconds = ((micro - first).cast(float) * 1e-6).fill_null(float("nan")).to_numpy()
    assert isinstance(first, int)
    start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=first)
    return Times(np.array(seconds), start if zone else start.replace(tzinfo=None), zone, notes)


def _refuse(table: Table, name: str, row: int) -> None:
    raise DataError(
        f"{table.source}, {table.where(row)}, column {name!r}: {str(table.frame[name][row])[:40]!r} is not a time; "
        "correct it, or name another column as `time`"
    )


def _from_text(table: Table, name: str, order: str | None) -> _Stamps:
    """Stamps of a column of text; in UTC where they bear offsets from it."""
    import polars as pl

    text = _with_date(table, name)
    text = pl.select(pl.when(text == "").then(None).otherwise(text)).to_series()
    shown = str(next(iter(text.drop_nulls()), ""))
    text = text.str.replace(r"^(\d{4}-?\d{2}-?\d{2})T", "$1 ").str.replace(r"^(\d{4})(\d{2})(\d{2})( |$)", "$1-$2-$3$4")
    text = text.str.replace(r"(:\d{2}),(\d+)", "$1.$2").str.replace_all(r" {2,}", " ")
    zone = text.str.extract(_ZONE, 2)
    offsets = None
    if zone.null_count() < len(zone):
        if bool((zone.is_null() & text.is_not_null()).any()):
            row = int((zone.is_null() & text.is_not_null()).arg_max() or 0)
            raise DataError(
                f"{table.source}, {table.where(row)}, column {name!r}: {text[row]!r} bears no offset from UTC "
                "while other rows do; export all stamps in one way"
            )
        signed = zone.str.replace(r"^(Z|UTC|GMT)$", "+00:00").str.replace(r"^([+-]\d{2})$", "$1:00")
        minutes = signed.str.slice(1, 2).cast(pl.Int64) * 60 + signed.str.slice(-2, 2).cast(pl.Int64)
        minutes = minutes * pl.select(pl.when(signed.str.starts_with("-")).then(-1).otherwise(1)).to_series()
        offsets = (minutes * 60_000_000).cast(pl.Duration("us"))
        text = text.str.replace(_ZONE, "$1")
    text = text.str.replace(rf"^({_DATE})$", "$1 00:00:00").str.replace(r"( \d{1,2}:\d{2})( ?[AP]M)?$", "$1:00$2")
    stamps, notes = _date_order(text, shown, f"{table.source}, column {name!r}", order)
    unread = stamps.is_null() & text.is_not_null()
    if bool(unread.any()):
        _refuse(table, name, int(unread.arg_max() or 0))
    if stamps.null_count() == len(stamps):
        raise DataError(f"{table.source}: the time column {name!r} is empty; name another one as `time`")
    if offsets is None:
        return stamps, None, notes
    zone_name, said = _borne(offsets)
    return stamps - offsets, zone_name, (*notes, *said)


def _borne(offsets: pl.Series) -> tuple[str, tuple[Finding, ...]]:
    """The zone of stamps that bear these offsets: UTC, which is said, where there are several."""
    names = [offset_name(int(one.total_seconds())) for one in sorted(offsets.drop_nulls().unique().to_list())]
    if len(names) == 1:
        return names[0], ()
    message = (
        f"Stamps bear several offsets from UTC ({', '.join(names)}): times are shown in UTC. For those of the clock on "
        "the wall, name its zone as data.time_zone."
    )
    return "UTC", (Finding(Kind.ZONE, "time", message),)


def _with_date(table: Table, name: str) -> pl.Series:
    """The stamps as upper-case text; a date and a clock in two columns are joined."""
    text, others = _upper(table, name), partners(table, name)
    if _all_match(table, name, _CLOCK):
        if not others:
            raise DataError(f"{table.source}: {name!r} holds times without a date; give full time stamps or numbers")
        return _upper(table, others[0]) + " " + text
    return text + " " + _upper(table, others[0]) if others else text


def partners(table: Table, name: str) -> list[str]:
    """The columns that hold the clock to a column of dates alone, or the dates to one of clocks."""
    for own, other in ((_CLOCK, _DATE), (_DATE, _CLOCK)):
        if _all_match(table, name, own):
            return [c for c in table.frame.columns if c != name and _all_match(table, c, other)]
    return []


def _upper(table: Table, name: str) -> pl.Series:
    return table.frame[name].str.strip_chars().str.to_uppercase()


def _all_match(table: Table, name: str, pattern: str) -> bool:
    """Is a column text that matches throughout?"""
    import polars as pl

    known = name in table.frame.columns and table.frame[name].dtype == pl.String
    return known and bool(_upper(table, name).str.contains(rf"^({pattern})$").all())


def _date_order(text: pl.Series, shown: str, source: str, order: str | None) -> tuple[pl.Series, tuple[Finding, ...]]:
    """Parse by the notation that fits; where day and month could be swapped, take the smoother one and say so.

    shown: the first stamp as the file has it.
    Raises DataError where the year could be the first or the last of three pairs of digits.
    """
    dotted = bool(text.str.contains(r"^\d{1,2}\.\d{1,2}\.").any())
    text = text.str.replace(r"^(\d{1,4})[/.](\d{1,2}|[A-Z]{3})[/.](\d{1,4}) ", "$1-$2-$3 ")
    text = text.str.replace(r"^(\d{1,2})[ -]([A-Z]{3})[ -]", "$1-$2-")
    american = bool(text.str.contains(r"[AP]M$").any())
    clock = "%I:%M:%S%.f %p" if american else "%H:%M:%S%.f"
    if american:
        text = text.str.replace(r" ?([AP]M)$", " $1")
    dates = [d.replace("%Y", y) for d in ("%d-%m-%Y", "%m-%d-%Y", "%d-%b-%Y") for y in ("%Y", "%y")]
    year_first = bool(text.str.contains(r"^\d{4}-").any())
    short = bool(text.str.contains(r"^\d{1,2}-[0-9A-Z]+-\d{2} ").any())
    formats = ["%Y-%m-%d"] if year_first else [d for d in dates if d.endswith("%y") == short]
    if short and not dotted:
        formats.append("%y-%m-%d")
    if order in ORDERS:
        formats = [f for f in formats if _order_of(f) == order] or formats
    read = {f: text.str.to_datetime(f"{f} {clock}", strict=False, time_unit="us", exact=True) for f in formats}
    fitting = {f: s for f, s in read.items() if s.null_count() == text.null_count()}
    if len(fitting) < 2:
        best = min(read.values(), key=lambda s: s.null_count())
        return (next(iter(fitting.values())) if fitting else best), ()

    def roughness(stamps: pl.Series) -> float:
        steps = np.diff(stamps.drop_nulls().dt.epoch("us").to_numpy().astype(float))
        return float(np.sum(np.abs(steps)))

    ranked = sorted(fitting, key=lambda f: roughness(fitting[f]))
    same = np.isclose(roughness(fitting[ranked[0]]), roughness(fitting[ranked[1]]), rtol=1e-9)
    alike = [f for f in ranked if np.isclose(roughness(fitting[f]), roughness(fitting[ranked[0]]), rtol=1e-9)]
    if same and "%y-%m-%d" in alike:
        readings = " or ".join(f"{fitting[f].drop_nulls()[0]:%Y-%m-%d} ({_order_of(f)})" for f in alike)
        raise DataError(f"{source}: {shown} can be {readings}: set data.time_format to the order that is meant")
    # with nothing else to go by, dots are written day first, and a 12-hour clock goes with month first
    chosen = ranked[0] if not same else next(f for f in fitting if f.startswith("%m" if american else "%d"))
    message = f"{source}: dates such as {shown} were read as {'month' if chosen[1] == 'm' else 'day'} first."
    return fitting[chosen], (Finding(Kind.DATE_ORDER, source, message),) if same else ()


def _order_of(notation: str) -> str:
    return "".join(c for c in notation.lower().replace("b", "m") if c in "dmy")


def _to_utc(table: Table, stamps: pl.Series, zone: str, groups: NDArray[np.int64] | None) -> pl.Series:
    """Local clock to UTC. The repeated hour in autumn is split where the clock steps back."""
    import polars as pl

    def utc(which: str) -> pl.Series:
        local = stamps.dt.replace_time_zone(zone, ambiguous=which, non_existent="null")  # type: ignore[arg-type]
        return local.dt.convert_time_zone("UTC").dt.replace_time_zone(None)

    first, second = utc("earliest"), utc("latest")
    skipped = first.is_null() & stamps.is_not_null()
    if bool(skipped.any()):
        row = int(skipped.arg_max() or 0)
        raise DataError(
            f"{table.source}, {table.where(row)}: {stamps[row]} does not exist in {zone} (the clock skips that hour); "
            "give the zone that the logger really uses, for instance UTC"
        )
    folded = np.asarray((first != second).fill_null(False).to_numpy(), dtype=bool)
    if not folded.any():
        return first
    order = np.arange(folded.size) if groups is None else np.argsort(groups, kind="stable")
    local = stamps.dt.epoch("us").fill_null(0).to_numpy()[order]
    fold = folded[order]
    change = (
        np.zeros(order.size, dtype=bool) if groups is None else np.diff(groups[order], prepend=groups[order[0]]) != 0
    )
    begins = fold & (~np.roll(fold, 1) | change)
    begins[0] = fold[0]
    stretch = np.cumsum(begins)
    back = np.cumsum((np.diff(local, prepend=local[0]) < 0) & fold & ~begins)
    at_begin = np.zeros(int(stretch.max()) + 1, dtype=np.int64)
    at_begin[stretch[begins]] = back[begins]
    later = np.zeros(order.size, dtype=bool)
    later[order] = fold & (back > at_begin[stretch])
    return second.zip_with(pl.Series(later), first)
