"""Text files read in blocks are what they are read at once; of wide ones no more is kept than is named."""

from __future__ import annotations

import hashlib
from dataclasses import fields

import numpy as np
import polars as pl
import pytest

from trueplant.errors import DataError
from trueplant.record import Channel, Layout, Record, levels, read_record, read_table
from trueplant.record.runs import spans_of
from trueplant.record.screening import screen
from trueplant.record.table import did_you_mean

LAYOUT = Layout((Channel("y", "pv", sp="sp"),), (Channel("u", "op"),), project_time_unit="s")
ROWS = 400
FILES = {
    "plain": lambda k: f"{k},1.5,{k % 7}.25,{k / 8}",
    "stamps": lambda k: f"2024-03-01 00:{k // 60:02d}:{k % 60:02d},1.5,{k % 7}.25,{k / 8}",
    "stamps with a T": lambda k: f"2024-03-01T00:{k // 60:02d}:{k % 60:02d}.5,1.5,{k % 7}.25,{k / 8}",
    "quotes": lambda k: f'"2024-03-01 00:{k // 60:02d}:{k % 60:02d}","1.5","{k % 7}.25","{k / 8}"',
    "words": lambda k: f"{k},1.5,{'Bad' if 200 <= k < 210 else k % 7 + 0.25},{k / 8}",
    "empty cells": lambda k: f"{k},1.5,{'' if k % 50 == 3 else k % 7 + 0.25},{k / 8}",
    "blank lines and comments": lambda k: (
        f"{k},1.5,{k % 7}.25,{k / 8}" + ("\n\n# logger restarted" if k == 300 else "")
    ),
    "decimal commas late": lambda k: f"{k};1;{k % 7};{k // 8}" + (",5" if k > 300 else ""),
    "thousands, and decimal commas late": lambda k: f"{k};1;{k % 7};{k // 8}" + (",5" if k > 300 else ".000"),
    "stamps of two kinds": lambda k: (
        f"2024-03-01 00:{k // 60:02d}:{k % 60:02d}{'' if k < 300 else '.25'},1.5,{k % 7}.25,{k / 8}"
    ),
    "an inch mark": lambda k: f"{k},1.5,{k % 7}.25,{k / 8}",
    "other encoding": lambda k: f"{k},1.5,{k % 7}.25,{k / 8}",
    "spaces": lambda k: f"{k}  1.5   {k % 7}.25 {k / 8}",
}


def written(path, kind):
    separator = ";" if "commas" in kind else " " if kind == "spaces" else ","
    head = separator.join(["t", "sp", "pv", "op"])
    if kind == "an inch mark":
        head = 'logger on the 12" line, in °C,,\n' + head
    encoding = "cp1252" if kind == "other encoding" else "utf-8"
    note = "# °C\n" if kind == "other encoding" else ""
    path.write_text("\n".join([note + head, *map(FILES[kind], range(ROWS))]) + "\n", encoding=encoding)
    return path


def same(one: Record, other: Record) -> None:
    for field in fields(Record):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray) else a == b, field.name


@pytest.mark.parametrize("kind", FILES)
def test_blocks_change_nothing(kind, tmp_path, monkeypatch):
    path = written(tmp_path / "run.csv", kind)
    whole = read_record(path, LAYOUT)
    assert whole.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert np.isfinite(whole.u).all()
    for size in (97, 1000, 4001):
        monkeypatch.setattr(levels, "BLOCK_BYTES", size)
        same(read_record(path, LAYOUT), whole)


@pytest.mark.parametrize("kind", ["words", "blank lines and comments"])
def test_lines_are_those_of_the_file(kind, tmp_path, monkeypatch):
    path = written(tmp_path / "run.csv", kind)
    text = path.read_text().splitlines()
    text[-1] = text[-1].replace(",", ",,", 1)
    path.write_text("\n".join(text))
    monkeypatch.setattr(levels, "BLOCK_BYTES", 500)
    with pytest.raises(DataError, match=rf"run\.csv, line {len(text)}: 5 fields where the lines above have 4"):
        read_record(path, LAYOUT)


def test_blocks_of_a_screened_record_change_nothing(tmp_path, monkeypatch):
    rng = np.random.default_rng(4)
    n = 3000
    pv = np.round(np.cumsum(rng.normal(size=n)), 2)
    pv[[400, 1500, 2600]] += 90
    op = np.interp(np.arange(n), np.arange(0, n, 7), rng.normal(size=n)[: len(range(0, n, 7))])
    frame = {"t": np.arange(n) * 1.0, "sp": np.repeat([0.0, 1.0], n // 2), "pv": pv, "op": op}
    record = read_record(frame, LAYOUT)
    whole = screen(record, LAYOUT)
    assert {"spike", "compressed"} <= {finding.kind for finding in whole.findings}
    monkeypatch.setattr(levels, "BLOCK", 100)
    assert screen(record, LAYOUT).findings == whole.findings


def wide(columns: int) -> pl.DataFrame:
    rng = np.random.default_rng(6)
    named = {"t": np.arange(50.0), "sp": np.ones(50), "pv": rng.normal(size=50), "op": rng.normal(size=50)}
    return pl.DataFrame(named | {f"x{k}": rng.normal(size=50).round(2) for k in range(columns)})


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_columns_that_are_not_named_are_not_kept(ending, tmp_path):
    path = tmp_path / f"run.{ending}"
    getattr(wide(2000), f"write_{ending}")(path)
    record = read_record(path, Layout(LAYOUT.outputs, LAYOUT.inputs, project_time_unit="s", most=50 * 4))
    assert np.array_equal(record.y[:, 0], wide(0)["pv"].to_numpy())
    with pytest.raises(DataError, match=r"has no column 'pv1' for the PV of y.*did you mean 'pv'.*x1,"):
        read_record(path, Layout((Channel("y", "pv1", sp="sp"),), LAYOUT.inputs, project_time_unit="s"))
    with pytest.raises(DataError, match="199 cells are the most"):
        read_record(path, Layout(LAYOUT.outputs, LAYOUT.inputs, project_time_unit="s", most=50 * 4 - 1))


def test_a_column_that_holds_the_name_comes_before_one_that_looks_like_it():
    assert did_you_mean("TIC1.PV", ["TIC2.PV", "TIC1.PV (degC) raw", "TIC1.PV (degC)"]) == (
        "; did you mean 'TIC1.PV (degC)'?"
    )
    assert did_you_mean("TIC1.PW", ["TIC2.OP", "TIC1.PV"]) == "; did you mean 'TIC1.PV'?"
    assert did_you_mean("", ["TIC1.PV"]) == "."


def test_the_clock_to_a_date_is_kept_although_nobody_names_it(tmp_path):
    frame = wide(30).with_columns(
        t=pl.lit("2024-03-01"), at=pl.Series([f"00:00:{k:02d}" for k in range(50)]), x0=pl.lit("Bad")
    )
    frame.write_csv(tmp_path / "run.csv")
    record = read_record(tmp_path / "run.csv", Layout(LAYOUT.outputs, LAYOUT.inputs, time="t", project_time_unit="s"))
    assert record.t.tolist() == list(range(50))


def test_progress_is_told(tmp_path, monkeypatch):
    path = written(tmp_path / "run.csv", "plain")
    monkeypatch.setattr(levels, "BLOCK_BYTES", path.stat().st_size // 4 + 1)
    said: list[str] = []
    read_record(path, LAYOUT, say=said.append)
    assert [line.removeprefix("reading run.csv, ") for line in said] == ["25 %", "50 %", "75 %", "100 %"]


def test_a_table_without_a_layout_is_whole_and_as_it_stands(tmp_path):
    path = written(tmp_path / "run.csv", "thousands, and decimal commas late")
    table = read_table(path)
    assert table.frame["op"].to_list()[:2] == ["0.000", "0.000"]
    assert table.numbers("op")[0][310] == 38.5


def test_of_very_many_stretches_the_longest_are_listed_and_all_are_counted():
    mask = np.arange(300_000) % 10 == 0
    mask[100_000:100_020] = mask[200_000:200_030] = True
    spans = spans_of(np.arange(mask.size) * 0.5, mask)
    assert len(spans) == levels.MOST_SPANS
    assert list(spans) == sorted(spans)
    assert {(50_000.0, 50_010.0), (100_000.0, 100_015.0)} <= set(spans)  # each with the single sample after it
    t = np.arange(mask.size) * 1.0
    pv = np.where(mask, np.nan, np.arange(mask.size) % 7)
    frame = {"t": t, "sp": np.ones(mask.size), "pv": pv, "op": np.sin(t)}
    found = screen(read_record(frame, LAYOUT), LAYOUT).findings
    (missing,) = (finding for finding in found if finding.kind == "missing")
    assert missing.samples == mask.sum() and len(missing.spans) == levels.MOST_SPANS
