"""Cells that are no measurements, and times that can be read in two ways: a finding or one message, never a guess."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import polars as pl
import pytest

from support.command import PROJECT, refused
from trueplant.cli import main

# -- numbers that are no measurements ----------------------------------------------------------------------------


def column(folder: Path, name: str, change) -> None:
    """Put change(k, value) for the cells of a column of the record."""
    frame = pl.read_csv(folder / "record.csv")
    cells = [str(change(k, value)) for k, value in enumerate(frame[name].to_list())]
    frame.with_columns(pl.Series(name, cells)).write_csv(folder / "record.csv")


CODES = ["inf", "-inf", "1e308", "3.4e38", "-9999", "32767", "I/O Timeout", "[-11059] No Good Data", "#N/A"]


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("name", ["pv", "op", "sp"])
def test_codes_among_measurements_are_missing_samples_with_a_finding(code, name, folder, capsys):
    column(folder, name, lambda k, value: code if 100 <= k < 110 else value)
    assert main(["check", "project.toml"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.count(f"{name}: ") == 1
    assert f"10 rows, '{code}' (first: line 102)" in out


@pytest.mark.parametrize("code", CODES)
def test_a_column_of_codes_is_an_error_that_shows_them(code, folder, capsys):
    column(folder, "pv", lambda k, value: value if k % 5 == 0 else code)
    refused(["check", "project.toml"], capsys, "'pv'", repr(code), "480 rows of 601")


def test_a_measurement_that_looks_like_a_code_stays_one(folder, capsys):
    column(folder, "pv", lambda k, value: 999 if k == 300 else 990 + 20 * value)
    assert main(["check", "project.toml"]) == 0
    assert "no measurement" not in capsys.readouterr().out


def test_words_for_quality_that_nobody_knows_are_shown(folder, capsys):
    wide = pl.read_csv(folder / "record.csv")
    long = wide.unpivot(index="t", variable_name="tag").with_columns(pl.lit("Brauchbar").alias("quality"))
    long.write_csv(folder / "record.csv")
    refused(
        ["check", "project.toml"], capsys, "'quality' says 'Brauchbar' (601)", "Good are words that begin with good, ok"
    )


# -- times -------------------------------------------------------------------------------------------------------

START = datetime(2024, 3, 1, 22, 0)


def moment(k: int) -> datetime:
    return START + timedelta(seconds=30 * k)


SERIAL = datetime(1899, 12, 30)
NOTATIONS = {
    "20240301220000": lambda k: f"{moment(k):%Y%m%d%H%M%S}",
    "202403012200": lambda k: f"{START + timedelta(minutes=k):%Y%m%d%H%M}",
    "serial days": lambda k: (moment(k) - SERIAL) / timedelta(days=1),
    "unix s": lambda k: int(moment(k).replace(tzinfo=UTC).timestamp()),
    "unix ms": lambda k: int(moment(k).replace(tzinfo=UTC).timestamp()) * 10**3,
    "unix us": lambda k: int(moment(k).replace(tzinfo=UTC).timestamp()) * 10**6,
    "unix ns": lambda k: int(moment(k).replace(tzinfo=UTC).timestamp()) * 10**9,
    "2024-03-01": lambda k: f"{moment(k):%Y-%m-%d %H:%M:%S}",
}


@pytest.mark.parametrize("notation", NOTATIONS)
def test_numbers_that_are_moments_are_read_as_such_and_said(notation, folder, capsys):
    column(folder, "t", lambda k, _: NOTATIONS[notation](k))
    assert main(["check", "project.toml"]) == 0
    out = capsys.readouterr().out
    step = 60 if notation == "202403012200" else 30
    last = START + timedelta(seconds=600 * step)
    assert f"601 samples, 2024-03-01 22:00:00 to {last:%Y-%m-%d %H:%M:%S}" in out
    assert f"one every {step} s" in out
    assert ("were read as moments" in out) == (notation != "2024-03-01")


@pytest.mark.parametrize(
    ("cells", "unit", "words"),
    [
        (NOTATIONS["unix ms"], "s", ("2024-03-01 22:00:00 to 2024-03-02 03:00:00 (unix ms)", "'numbers'")),
        (lambda k: 45352.5 + 0.00035 * k, None, ("(spreadsheet)", "'numbers'")),
        (lambda k: f"24-03-01 {k // 60:02d}:{k % 60:02d}:00", None, ("2001-03-24 (dmy)", "2024-03-01 (ymd)")),
        (lambda k: f"03/04/05 {k // 60:02d}:{k % 60:02d}:00", None, ("(dmy)", "data.time_format")),
    ],
)
def test_times_that_can_be_read_in_two_ways_are_asked_for(cells, unit, words, folder, capsys):
    column(folder, "t", lambda k, _: cells(k))
    if unit:
        text = PROJECT.replace('time = "t"', f'time = "t"\ntime_unit = "{unit}"')
        (folder / "project.toml").write_text(text)
    refused(["check", "project.toml"], capsys, "data.time_format", *words)


@pytest.mark.parametrize(
    ("cells", "said", "words"),
    [
        (lambda k: f"24-03-01 {k // 60:02d}:{k % 60:02d}:00", "ymd", "2024-03-01 00:00:00"),
        (lambda k: f"24-03-01 {k // 60:02d}:{k % 60:02d}:00", "dmy", "2001-03-24 00:00:00"),
        (lambda k: 45352.5 + 0.00035 * k, "spreadsheet", "2024-03-01 12:00:00"),
        (lambda k: 45352.5 + 0.00035 * k, "numbers", "45352.5 to 45352.7 s"),
        (NOTATIONS["unix ms"], "unix ms", "2024-03-01 22:00:00"),
        (NOTATIONS["unix ms"], "numbers", "1709330400000 to 1709348400000 s"),
    ],
)
def test_the_project_says_how_times_are_meant(cells, said, words, folder, capsys):
    column(folder, "t", lambda k, _: cells(k))
    (folder / "project.toml").write_text(PROJECT.replace('time = "t"', f'time = "t"\ntime_format = "{said}"'))
    assert main(["check", "project.toml"]) == 0
    assert words in capsys.readouterr().out


TIMES = {
    "before the year 1": (pl.Int64, -(2**63) + 5, pl.Datetime("us"), "years 1 to 9999"),
    "after the year 9999": (pl.Int64, 253402300800 * 10**6, pl.Datetime("us"), "years 1 to 9999"),
    "days beyond dates": (pl.Int32, 2**31 - 1, pl.Date, "dates that cannot be"),
    "lists": (pl.List(pl.Int64), [1, 2], pl.List(pl.Int64), "no time"),
    "bytes": (pl.Binary, b"12", pl.Binary, "no time"),
    "durations": (pl.Int64, 5, pl.Duration("ms"), "without a date"),
}


@pytest.mark.parametrize("kind", TIMES)
def test_columns_that_are_no_times_are_named(kind, folder, capsys):
    stored, value, dtype, words = TIMES[kind]
    frame = pl.read_csv(folder / "record.csv")
    frame.with_columns(pl.Series("t", [value] * frame.height, dtype=stored).cast(dtype)).write_parquet("record.parquet")
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", "record.parquet"))
    refused(["check", "project.toml"], capsys, "record.parquet", "'t'", words)


@pytest.mark.parametrize("cell", ["", "1e300", "99999999999999999999"])
def test_a_moment_that_is_none_is_one_row_or_one_message(cell, folder, capsys):
    column(folder, "t", lambda k, _: cell if k == 5 else NOTATIONS["20240301220000"](k))
    status = main(["check", "project.toml"])
    out, err = capsys.readouterr()
    assert status == (2 if cell else 0), out + err
    assert "1 row without a time" in out if status == 0 else err.count("\n") == 1


def test_the_time_is_no_signal(folder, capsys):
    (folder / "project.toml").write_text(PROJECT.replace('pv = "pv"', 'pv = "t"'))
    refused(["check", "project.toml"], capsys, "'t' is named as time and as a signal")


def test_times_that_stretch_without_end_take_no_memory(folder, capsys):
    column(folder, "t", lambda k, _: 10 ** (k / 30))
    assert main(["check", "project.toml"]) in (0, 3)
    assert capsys.readouterr().err == ""
