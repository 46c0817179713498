"""Long historian exports (tag, time, value, quality): one column for each tag on common time stamps."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.grid import Grid
from trueplant.record.layout import Layout
from trueplant.record.numbers import counted, no_measurements, to_numbers
from trueplant.record.table import Table, did_you_mean
from trueplant.record.times import Times, find_time, parse_times
from trueplant.record.types import Finding, Kind

if TYPE_CHECKING:
    import polars as pl

_SYNONYMS = {
    "tag": ("tag", "tagname", "point", "pointname", "name", "signal", "variable", "item", "itemid", "messstelle"),
    "value": ("value", "val", "wert", "reading", "measurement", "pointvalue"),
    "unit": ("unit", "units", "eu", "engunits", "uom", "einheit"),
    "quality": ("quality", "status", "qualitycode", "opcquality", "confidence", "qualitaet"),
}
_GOOD = ("good", "ok", "valid", "g", "true", "normal", "gut")


@dataclasses.dataclass(frozen=True, eq=False)
class LongParts:
    """Where the tags of a long export stand, and which there are."""

    tag: str
    value: str
    tags: tuple[str, ...]
    units: dict[str, str]
    """By tag, where a column has them."""


def _bare(name: str) -> str:
    return name.casefold().replace("ä", "ae").replace(" ", "").replace("_", "")


def _find(table: Table, named: str, role: str) -> str | None:
    bare = {_bare(n): n for n in reversed(table.names)}
    wanted = (_bare(named), *_SYNONYMS[role])
    return next((bare[w] for w in wanted if w in bare), None)


def long_parts(table: Table, tag_column: str = "tag", value_column: str = "value") -> LongParts | None:
    """The parts of a long export, the columns found by these names or usual ones; None for a table that is wide."""
    import polars as pl

    tag, value = _find(table, tag_column, "tag"), _find(table, value_column, "value")
    unit = _find(table, "unit", "unit")
    if tag is None or value is None or table.frame[tag].dtype.is_numeric():
        return None
    tags = table.frame[tag].cast(pl.String).str.strip_chars()
    units: dict[str, str] = {}
    if unit is not None:
        pairs = pl.DataFrame([tags.alias("tag"), table.frame[unit].cast(pl.String).alias("unit")]).drop_nulls()
        units = dict(pairs.unique("tag", keep="first").rows())
    return LongParts(tag, value, tuple(tags.drop_nulls().unique(maintain_order=True)), units)


def is_long(table: Table, layout: Layout) -> bool:
    """True if the table lists tags and none of the layout's columns stands in its header."""
    return (
        not {*layout.continuous, *layout.held} & set(table.names)
        and _find(table, layout.tag, "tag") is not None
        and _find(table, layout.value, "value") is not None
    )


def bad_quality(table: Table, name: str) -> BoolArray:
    """Where the quality says that a value is not to be trusted: OPC codes (192 to 255 are good), status codes
    (0 is good, as in PI and OPC UA), per cent (100 is good), or words."""
    import polars as pl

    codes, words = table.numbers(name)
    text = table.frame[name].cast(pl.String).str.strip_chars().str.to_lowercase()
    told = text.str.contains(rf"^(good|({'|'.join(_GOOD)})\b)") | (text == "")
    good_words = np.asarray(told.fill_null(True).to_numpy(), dtype=bool)
    known = codes[np.isfinite(codes)]
    if not known.size or np.mean(words) > levels.MOSTLY:
        return ~good_words
    if np.any(known >= levels.GOOD_OPC) and np.all(known <= levels.LARGEST_OPC):
        good_codes = codes >= levels.GOOD_OPC
    elif known.size and np.mean(known == 100) > levels.MOSTLY:
        good_codes = codes == 100
    elif known.size and np.mean(known == 1) > levels.MOSTLY and not np.any(known > 1):
        good_codes = codes == 1
    else:
        good_codes = codes == 0
    return np.where(words, ~good_words, ~(good_codes | np.isnan(codes)))


def to_wide(table: Table, layout: Layout) -> tuple[Table, Times]:
    """A table with the column "time" in seconds and one for each tag of the layout, and the times as they were read.

    Tags that share their stamps are set side by side. Otherwise the stamps of the most often recorded tag are
    kept; held tags (OP, SP, mode) take their last value, and each value of a continuous tag (PV) goes to
    the nearest stamp within half an interval, NaN elsewhere. With `layout.sample_time` all tags are put on an even grid
    instead. Raises DataError for tags that are not there.
    """
    import polars as pl

    roles = {"tag": layout.tag, "value": layout.value, "quality": layout.quality}
    for role, name in roles.items():
        if name != role and _bare(name) not in map(_bare, table.names):
            table.column(name, f"the {role}")
    columns = {role: _find(table, name, role) for role, name in roles.items()}
    tag, value, quality = columns["tag"], columns["value"], columns["quality"]
    assert tag is not None
    assert value is not None
    wanted = list(dict.fromkeys([*layout.continuous, *layout.held]))
    code = _codes(table, tag, wanted)
    time = layout.time if layout.time is not None else find_time(table, frozenset({tag, value}))
    times = parse_times(table, time, layout, code)
    notes = list(table.notes + times.notes)
    values = table.frame[value]
    if quality is not None:
        bad = bad_quality(table, quality)
        notes += _bad_ones(table, quality, bad, code, wanted)
        values = pl.select(pl.when(pl.Series(bad)).then(None).otherwise(values)).to_series()
    stamps, rows = _sorted_stamps(table, times.seconds, code, wanted)
    if layout.sample_time is not None:
        events = dict(zip(wanted, zip(stamps, rows, strict=True), strict=True))
        return _on_grid(dataclasses.replace(table, notes=tuple(notes)), times, layout, values, events)
    base = max(range(len(wanted)), key=lambda k: (stamps[k].size, k < len(layout.continuous)))
    grid = stamps[base]
    apart = [k for k in range(len(wanted)) if not np.array_equal(stamps[k], grid)]
    frame = {"time": pl.Series(grid)}
    for k, name in enumerate(wanted):
        source_row = rows[k] if k not in apart else _place(stamps[k], rows[k], grid, name in layout.held)
        picked = values.gather(np.maximum(source_row, 0))
        frame[name] = picked.zip_with(pl.Series(source_row >= 0), picked.clear(grid.size))
    if apart:
        moved = [float(np.max(_distance(stamps[k], grid))) for k in apart if wanted[k] not in layout.held]
        shift = max(moved, default=0.0)
        message = (
            f"The tags bear stamps of their own. Those of {wanted[base]} were kept; set-points, OP and mode hold their "
            f"last value, each PV went to the nearest stamp (moved by {shift:.3g} s at most)."
        )
        notes.append(Finding(Kind.ALIGNED, table.source, message, value=shift))
    whole = pl.DataFrame([s.alias(n) for n, s in frame.items()])
    wide = dataclasses.replace(table, names=tuple(frame), frame=whole, lines=None, notes=tuple(notes))
    return wide, times


def _on_grid(
    table: Table,
    times: Times,
    layout: Layout,
    values: pl.Series,
    events: Mapping[str, tuple[Array, NDArray[np.int64]]],
) -> tuple[Table, Times]:
    """The same on an even grid: PV and disturbances run straight between their events, all else holds its last one.

    `events` are the stamps and rows of each tag.
    """
    import polars as pl

    grid = Grid.of(layout, {name: stamps for name, (stamps, _) in events.items()}, table.source)
    numbers, _ = to_numbers(values, table.decimal)
    limited = {channel.column for channel in layout.inputs}
    origin = float(grid.moments[0])
    frame = {"time": pl.Series("time", grid.moments - origin)}
    filled: dict[str, float] = {}
    notes = list(table.notes)
    for name, (stamps, rows) in events.items():
        if name in layout.continuous:
            own = numbers[rows]
            codes = no_measurements(own)
            if codes.any():
                message = f"{name}: {counted(int(codes.sum()), 'value')} that is no measurement; counted as missing."
                notes.append(Finding(Kind.CODE, name, message, samples=int(codes.sum()), excludes=True))
            frame[name] = pl.Series(name, grid.linear(stamps, np.where(codes, np.nan, own)))
            filled[name] = float(np.mean(grid.reconstructed(stamps)))
            continue
        last = grid.held(stamps, name in limited)
        picked = values.gather(rows[np.maximum(last, 0)])
        frame[name] = picked.zip_with(pl.Series(last >= 0), picked.clear(last.size)).alias(name)
    told = ", ".join(f"{100 * share:.3g} % of {name}" for name, share in filled.items())
    message = (
        f"The tags were put on a grid of {grid.step:g} s: PV and disturbances run straight between their events, OP, "
        f"set-points and mode hold. Without an event of their own are {told}."
    )
    notes.append(Finding(Kind.ALIGNED, table.source, message, value=max(filled.values())))
    whole = pl.DataFrame(list(frame.values()))
    wide = dataclasses.replace(table, names=tuple(frame), frame=whole, lines=None, notes=tuple(notes))
    start = None if times.start is None else times.start + timedelta(seconds=origin)
    return wide, dataclasses.replace(times, seconds=grid.moments - origin, start=start)


def _codes(table: Table, column: str, wanted: Sequence[str]) -> NDArray[np.int64]:
    """(N,) which of the wanted tags each row is of, -1 for none. Raises DataError for tags without a row."""
    import polars as pl

    tags = table.frame[column].cast(pl.String).str.strip_chars()
    present = tags.unique().drop_nulls().to_list()
    code = np.full(len(table), -1, dtype=np.int64)
    for k, name in enumerate(wanted):
        if name not in present:
            shown = ", ".join(sorted(present)[:20])
            hint = did_you_mean(name, sorted(present))
            raise DataError(f"{table.source} has no rows for tag {name!r} in column {column!r}{hint} It has: {shown}")
        code[np.asarray((tags == name).fill_null(False).to_numpy(), dtype=bool)] = k
    return code


def _bad_ones(
    table: Table, quality: str, bad: BoolArray, code: NDArray[np.int64], wanted: Sequence[str]
) -> list[Finding]:
    """A finding for each tag with values of bad quality. Raises DataError for a tag that has no others."""
    found = []
    for k, name in enumerate(wanted):
        own = bad & (code == k)
        count = int(np.sum(own))
        if count and count == np.sum(code == k):
            raise nothing_good(table, quality, name, own)
        if count:
            message = f"{name}: {counted(count, 'value')} with a bad quality code left out."
            found.append(Finding(Kind.BAD_QUALITY, name, message, samples=count, excludes=True))
    return found


def nothing_good(table: Table, quality: str, name: str, rows: BoolArray) -> DataError:
    """What to say of a signal of whose values on these rows none is good."""
    import polars as pl

    words = Counter(str(word).strip()[:40] for word in table.frame[quality].filter(pl.Series(rows)).to_list())
    seen = ", ".join(f"{word!r} ({n})" for word, n in words.most_common(levels.SHOWN_WORDS))
    return DataError(
        f"{table.source}: no value of {name!r} is of good quality: column {quality!r} says {seen}. "
        f"Good are words that begin with {', '.join(_GOOD)}, 0, 192 to 255 (OPC) or 100 (per cent): leave the "
        "column out, or name another one (data.quality, or status of the signal)"
    )


def _sorted_stamps(
    table: Table, seconds: Array, code: NDArray[np.int64], wanted: Sequence[str]
) -> tuple[list[Array], list[NDArray[np.int64]]]:
    """For each tag its stamps in increasing order, each once, and the rows that bear them."""
    stamps, rows = [], []
    for k, name in enumerate(wanted):
        at = np.flatnonzero((code == k) & np.isfinite(seconds))
        if not at.size:
            raise DataError(f"{table.source}: no row of tag {name!r} bears a time; export it again")
        at = at[np.argsort(seconds[at], kind="stable")]
        at = at[np.diff(seconds[at], prepend=-np.inf) > 0]
        stamps.append(seconds[at])
        rows.append(at)
    return stamps, rows


def _distance(stamps: Array, grid: Array) -> Array:
    """How far each stamp is moved to its place on the grid (0 where it finds none)."""
    at = np.clip(np.searchsorted(grid, stamps), 1, grid.size - 1)
    distance = np.minimum(np.abs(stamps - grid[at - 1]), np.abs(grid[at] - stamps))
    return np.where(distance <= 0.5 * np.median(np.diff(grid)), distance, 0.0)


def _place(stamps: Array, rows: NDArray[np.int64], grid: Array, hold: bool) -> NDArray[np.int64]:
    """The row that each grid stamp takes its value from, -1 for none."""
    if hold:
        last = np.searchsorted(stamps, grid, side="right") - 1
        return np.where(last >= 0, rows[np.maximum(last, 0)], -1)
    if grid.size < 2:
        return np.full(grid.size, -1)
    at = np.clip(np.searchsorted(grid, stamps), 1, grid.size - 1)
    at = np.where(stamps - grid[at - 1] <= grid[at] - stamps, at - 1, at)
    distance = np.abs(stamps - grid[at])
    near = distance <= 0.5 * np.median(np.diff(grid))
    placed = np.full(grid.size, -1, dtype=np.int64)
    # the closest one is written last where several fall on one stamp
    order = np.argsort(-distance[near], kind="stable")
    placed[at[near][order]] = rows[near][order]
    return placed
