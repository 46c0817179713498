"""Rows of any source as events: time in UTC, value as a number, quality as a word."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trueplant.connect import levels
from trueplant.connect.source import COLUMNS, Quality
from trueplant.errors import DataError

if TYPE_CHECKING:
    import polars as pl


def events(frame: pl.DataFrame, where: str, kind: str | None, zone: str | None) -> pl.DataFrame:
    """A table with the columns tag, time, value and, where there is one, quality, in this order, whatever their names.

    `kind` says what the quality means: "opc", "pi", "percent" or "words"; text is taken for words. `zone` is that of
    stamps that bear none. A row without a time is left out. Raises DataError (`where`, and what to do).
    """
    import polars as pl

    if frame.width not in (3, 4):
        raise DataError(
            f"{where} gives {frame.width} columns: tag, time, value and, if there is one, quality are needed"
        )
    named = pl.DataFrame([series.alias(name) for name, series in zip(COLUMNS, frame.iter_columns(), strict=False)])
    time, clear = times(named["time"], where, zone)
    value = values(named["value"], where)
    word = (
        qualities(named["quality"], where, kind)
        if named.width == 4
        else pl.Series([str(Quality.GOOD)]).new_from_index(0, frame.height)
    )
    known = value.is_finite().fill_null(False) & clear
    bad = pl.Series([str(Quality.BAD)]).new_from_index(0, frame.height)
    made = {
        "tag": named["tag"].cast(pl.String).str.strip_chars(),
        "time": time,
        "value": value.zip_with(
            value.is_finite().fill_null(False), pl.Series([None], dtype=pl.Float64).new_from_index(0, frame.height)
        ),
        "quality": word.zip_with(known, bad),
    }
    return pl.DataFrame([series.alias(name) for name, series in made.items()]).drop_nulls(["tag", "time"])


def times(series: pl.Series, where: str, zone: str | None) -> tuple[pl.Series, pl.Series]:
    """Moments in us UTC, and which of them are sure: not those in the hour that comes twice in autumn.

    Raises DataError for stamps that are none, that bear no zone while none is declared, and that the clock skips.
    """
    import polars as pl

    if series.dtype == pl.Null:
        series = series.cast(pl.Datetime("us", "UTC"))
    if series.dtype.is_numeric():
        number = series.cast(pl.Float64)
        size = float(number.abs().max() or 0.0)  # type: ignore[arg-type]
        scale = 10.0 ** (6 - 3 * sum(size >= limit for limit in levels.UNIX))
        whole = (
            series.cast(pl.Int64) * round(scale)
            if series.dtype.is_integer() and scale >= 1
            else (number * scale).round().cast(pl.Int64)
        )
        return whole.cast(pl.Datetime("us")).dt.replace_time_zone("UTC"), _all(series)
    if series.dtype == pl.String:
        series = _from_text(series, where)
    if series.dtype == pl.Date or not series.dtype.is_temporal() or series.dtype in (pl.Time, pl.Duration):
        raise DataError(f"{where}: the time is of type {series.dtype}: select a time stamp as the second column")
    own: str | None = series.dtype.time_zone  # type: ignore[attr-defined]
    if own is not None:
        return series.cast(pl.Datetime("us", own)).dt.convert_time_zone("UTC"), _all(series)
    if zone is None:
        raise DataError(
            f"{where}: the stamps bear no zone: set data.source.time_zone to that of their clock, such as UTC"
        )
    local = series.cast(pl.Datetime("us"))
    early, late = (
        local.dt.replace_time_zone(zone, ambiguous=which, non_existent="null") for which in ("earliest", "latest")
    )
    skipped = early.is_null() & local.is_not_null()
    if bool(skipped.any()):
        first = local.filter(skipped)[0]
        raise DataError(
            f"{where}: the stamp {first} does not exist in {zone}, whose clock skips that hour: name the zone that the "
            "stamps really follow (data.source.time_zone), for instance UTC"
        )
    return early.dt.convert_time_zone("UTC"), (early == late).fill_null(True)


def _all(series: pl.Series) -> pl.Series:
    import polars as pl

    return pl.Series([True]).new_from_index(0, len(series))


def _from_text(text: pl.Series, where: str) -> pl.Series:
    """ISO 8601, with an offset in all cells or in none."""
    plain = text.str.strip_chars().str.replace(r"^(\d{4}-\d\d-\d\d)T", "$1 ").str.replace(r"Z$", "+00:00")
    plain = (
        plain.str.replace(r"([+-]\d\d)$", "$1:00")
        if bool(plain.str.contains(r":\d\d(\.\d+)?[+-]\d\d$").any())
        else plain
    )
    known = plain.drop_nulls()
    borne = known.str.contains(r"[+-]\d\d:?\d\d$")
    if len(known) and bool(borne.any()) != bool(borne.all()):
        raise DataError(f"{where}: some stamps bear an offset from UTC and others none: select them in one way")
    form = "%Y-%m-%d %H:%M:%S%.f"
    if bool(borne.any()):
        read = plain.str.to_datetime(f"{form}%z", strict=False, time_unit="us")
    else:
        read = plain.str.to_datetime(form, strict=False, time_unit="us")
    lost = read.is_null() & plain.is_not_null()
    if bool(lost.any()):
        shown = text.filter(lost)[0]
        raise DataError(
            f"{where}: {shown[:40]!r} is no time: select stamps such as 2026-10-01 00:00:00, or seconds since 1970"
        )
    return read


def values(series: pl.Series, where: str) -> pl.Series:
    """Numbers, null where a cell holds none. Raises DataError for a type that is no number, and where all is text."""
    import polars as pl

    if series.dtype == pl.Boolean or series.dtype.is_numeric() or series.dtype == pl.Null:
        return series.cast(pl.Float64)
    if series.dtype in (pl.String, pl.Categorical, pl.Enum):
        text = series.cast(pl.String)
        numbers = text.str.strip_chars().cast(pl.Float64, strict=False)
        if numbers.null_count() == len(numbers) and text.null_count() < len(text):
            seen = text.drop_nulls()[0][:40]
            raise DataError(f"{where}: the value is text ({seen!r}): select numbers, those of a mode too")
        return numbers
    raise DataError(
        f"{where}: the value is of type {str(series.dtype).split('(')[0]}: cast it to a number (float8) in the query"
    )


def qualities(series: pl.Series, where: str, kind: str | None) -> pl.Series:
    """Words, from codes of which `kind` says what they mean. A quality that is empty is uncertain.

    Raises DataError for numbers of which nobody says what they mean.
    """
    import polars as pl

    text = series.dtype in (pl.String, pl.Categorical, pl.Enum)
    if kind == "words" or (kind is None and text):
        word = series.cast(pl.String).str.strip_chars().str.to_lowercase()
        good, unsure = (
            word.str.contains(r"^(good|ok|valid|normal|gut)\b"),
            word.str.contains(r"^(uncertain|questionable|doubtful)\b"),
        )
    elif kind is None and series.dtype != pl.Null:
        raise DataError(
            f'{where}: the quality is a number: say what it means with data.source.quality = "opc", "pi" or "percent"'
        )
    else:
        code = series.cast(pl.Float64, strict=False)
        # OPC keeps the quality in bits 6 and 7: 3 is good, 1 uncertain
        good = {"opc": code.is_between(192, 255), "percent": code == 100}.get(kind or "pi", code == 0)
        none = code.is_null() & code.is_not_null()
        unsure = {"opc": code.is_between(64, 127), "percent": (code > 0) & (code < 100)}.get(kind or "pi", none)
    frame = pl.DataFrame([good.alias("good"), unsure.alias("unsure"), series.is_null().alias("empty")])
    word_of = (
        pl.when(pl.col("empty")).then(pl.lit(str(Quality.UNCERTAIN)))
        .when(pl.col("good")).then(pl.lit(str(Quality.GOOD)))
        .when(pl.col("unsure")).then(pl.lit(str(Quality.UNCERTAIN)))
        .otherwise(pl.lit(str(Quality.BAD)))
    )  # fmt: skip
    return frame.select(word_of.alias("quality")).to_series()
