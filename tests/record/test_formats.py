"""Frames, Parquet, XLSX and long historian exports hold the same record as a CSV file."""

from __future__ import annotations

import datetime as dt
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest

from trueplant.errors import DataError
from trueplant.record import FORMATS, Channel, Format, Layout, Record, Source, Table, read_record, read_table

N = 40
START = dt.datetime(2024, 10, 17, 21, 55)
ONE = Layout(
    (Channel("T", "pv", sp="sp"),), (Channel("Q", "op", mode="mode"),), (Channel("amb", "amb"),), project_time_unit="s"
)
RNG = np.random.default_rng(1)
COLUMNS: dict[str, Any] = {
    "time": [START + dt.timedelta(seconds=10 * k) for k in range(N)],
    "sp": np.repeat([50.0, 55.0], N // 2),
    "pv": 50 + RNG.standard_normal(N),
    "op": RNG.uniform(0, 100, N),
    "amb": RNG.uniform(15, 20, N),
    "mode": ["AUTO"] * 30 + ["MAN"] * 10,
}


def check(record: Record, start: dt.datetime | None = START, atol: float = 0.0) -> None:
    np.testing.assert_allclose(record.t, 10.0 * np.arange(N), atol=1e-6)
    for values, name in ((record.r, "sp"), (record.y, "pv"), (record.u, "op"), (record.d, "amb")):
        np.testing.assert_allclose(values[:, 0], COLUMNS[name], rtol=0, atol=atol)
    np.testing.assert_array_equal(record.automatic[:, 0], np.arange(N) < 30)
    assert record.start == start
    assert (record.outputs, record.inputs, record.disturbances) == (("T",), ("Q",), ("amb",))


def test_frames_and_mappings() -> None:
    check(read_record(COLUMNS, ONE))
    check(read_record(pl.DataFrame(COLUMNS), ONE))
    check(read_record(pl.DataFrame(COLUMNS).lazy(), ONE))
    check(read_record(pd.DataFrame(COLUMNS), ONE))
    check(read_record(pd.DataFrame(COLUMNS).set_index("time"), ONE))


def test_pandas_with_a_time_zone() -> None:
    frame = pd.DataFrame(COLUMNS)
    frame["time"] = frame["time"].dt.tz_localize("Europe/Berlin")
    check(read_record(frame, ONE), dt.datetime(2024, 10, 17, 19, 55, tzinfo=dt.UTC))


def test_naive_frame_with_a_declared_zone() -> None:
    record = read_record(pl.DataFrame(COLUMNS), replace(ONE, time_zone="Asia/Shanghai"))
    check(record, dt.datetime(2024, 10, 17, 13, 55, tzinfo=dt.UTC))


def test_missing_values_of_frames() -> None:
    frame = pd.DataFrame(COLUMNS)
    frame.loc[3, "pv"] = np.nan
    frame["op"] = frame["op"].astype(object)
    frame.loc[4, "op"] = "Bad"
    record = read_record(frame, ONE)
    assert np.flatnonzero(np.isnan(record.y[:, 0])).tolist() == [3]
    assert np.flatnonzero(np.isnan(record.u[:, 0])).tolist() == [4]
    assert [n.samples for n in record.notes if n.kind == "text"] == [1]


def test_parquet(tmp_path: Path) -> None:
    pl.DataFrame(COLUMNS).write_parquet(tmp_path / "run.parquet")
    check(read_record(tmp_path / "run.parquet", ONE))
    assert read_table(tmp_path / "run.parquet").names == tuple(COLUMNS)


def test_damaged_files(tmp_path: Path) -> None:
    pl.DataFrame(COLUMNS).write_parquet(tmp_path / "run.parquet")
    data = (tmp_path / "run.parquet").read_bytes()
    (tmp_path / "cut.parquet").write_bytes(data[: len(data) // 2])
    with pytest.raises(DataError, match="not a readable Parquet"):
        read_record(tmp_path / "cut.parquet", ONE)
    (tmp_path / "cut.xlsx").write_bytes(b"PK\x03\x04" + b"x" * 200)
    with pytest.raises(DataError, match="not a readable Excel"):
        read_record(tmp_path / "cut.xlsx", ONE)
    (tmp_path / "text.xlsx").write_text("t,pv\n1,2\n")
    with pytest.raises(DataError, match=r"not the \.xlsx file"):
        read_record(tmp_path / "text.xlsx", ONE)


def _workbook(path: Path) -> None:
    import xlsxwriter

    book = xlsxwriter.Workbook(str(path))
    sheet = book.add_worksheet("Notes")
    sheet.write(0, 0, "nothing here")
    sheet = book.add_worksheet("Run 1")
    stamp = book.add_format({"num_format": "yyyy-mm-dd hh:mm:ss"})
    sheet.write(0, 0, "Export of unit 3")
    sheet.write_row(2, 0, list(COLUMNS))
    sheet.write_row(3, 0, ["", "degC", "degC", "%", "degC"])
    for k in range(N):
        sheet.write_datetime(4 + k, 0, COLUMNS["time"][k], stamp)
        for j, name in enumerate(list(COLUMNS)[1:], start=1):
            sheet.write(4 + k, j, COLUMNS[name][k])
    book.close()


def test_xlsx(tmp_path: Path) -> None:
    _workbook(tmp_path / "run.xlsx")
    check(read_record(tmp_path / "run.xlsx", replace(ONE, sheet="Run 1")), atol=1e-14)
    table = read_table(tmp_path / "run.xlsx", sheet="Run 1")
    assert table.units == {"sp": "degC", "pv": "degC", "op": "%", "amb": "degC"}
    assert table.where(0) == "line 5"
    with pytest.raises(DataError, match="'Notes': no rows of numbers"):
        read_record(tmp_path / "run.xlsx", ONE)
    with pytest.raises(DataError, match="no sheet 'Run 2'; it has: Notes, Run 1"):
        read_record(tmp_path / "run.xlsx", replace(ONE, sheet="Run 2"))


def test_xlsx_keeps_small_numbers_and_counts_empty_rows(tmp_path: Path) -> None:
    import xlsxwriter

    book = xlsxwriter.Workbook(str(tmp_path / "small.xlsx"))
    sheet = book.add_worksheet()
    sheet.write_row(3, 2, ["t", "pv", "op"])
    for k in range(N):
        sheet.write_row(4 + k, 2, [k, k * 1e-12, "Bad" if k == 4 else k % 3])
    book.close()
    record = read_record(tmp_path / "small.xlsx", Layout((Channel("T", "pv"),), (Channel("Q", "op"),)))
    np.testing.assert_allclose(record.y[:, 0], np.arange(N) * 1e-12, rtol=1e-14)
    assert ["line 9" in n.message for n in record.notes if n.kind == "text"] == [True]


def _long(jitter: float = 0.0, heading: tuple[str, ...] = ("tag", "time", "value", "quality")) -> pl.DataFrame:
    rows = []
    for j, name in enumerate(["pv", "op", "sp", "amb", "mode"]):
        for k in range(N):
            if name == "sp" and k not in (0, N // 2):
                continue
            moment = COLUMNS["time"][k] + dt.timedelta(seconds=jitter * j)
            rows.append((name, str(moment), str(COLUMNS[name][k]), "Good"))
    return pl.DataFrame(rows, schema=list(heading), orient="row")


@pytest.mark.parametrize(
    "heading",
    [("tag", "time", "value", "quality"), ("TagName", "Timestamp", "Value", "Status"), ("Point", "Date", "Val", "Q")],
)
def test_long_export(tmp_path: Path, heading: tuple[str, ...]) -> None:
    _long(heading=heading).write_csv(tmp_path / "long.csv", separator=";")
    check(read_record(tmp_path / "long.csv", ONE))


def test_long_export_with_stamps_of_their_own() -> None:
    # each tag 1 s later than the one before: the PV's stamps (first, and densest) are kept, and OP is held
    record = read_record(_long(jitter=1.0), ONE)
    np.testing.assert_allclose(record.t, 10.0 * np.arange(N), atol=1e-6)
    np.testing.assert_array_equal(record.y[:, 0], COLUMNS["pv"])
    np.testing.assert_array_equal(record.d[:, 0], COLUMNS["amb"])
    assert np.isnan(record.u[0, 0])
    np.testing.assert_array_equal(record.u[1:, 0], COLUMNS["op"][:-1])
    (note,) = [n for n in record.notes if n.kind == "aligned"]
    assert note.value == pytest.approx(3.0)


def test_a_slow_pv_in_a_long_export_stays_missing_between_its_stamps() -> None:
    kept = (pl.col("tag") != "pv") | (pl.int_range(pl.len()) % 4 == 0)
    record = read_record(_long().filter(kept), ONE)
    assert np.flatnonzero(np.isfinite(record.y[:, 0])).tolist() == list(range(0, N, 4))


@pytest.mark.parametrize(
    ("good", "bad"), [("Good", "Bad"), ("192", "0"), ("0", "312"), ("100", "0"), ("GOOD, sampled", "Uncertain")]
)
def test_quality_codes(good: str, bad: str) -> None:
    frame = _long().with_columns(quality=pl.when(pl.int_range(pl.len()) == 7).then(pl.lit(bad)).otherwise(pl.lit(good)))
    record = read_record(frame, ONE)
    assert np.flatnonzero(np.isnan(record.y[:, 0])).tolist() == [7]
    assert [(n.kind, n.signal, n.samples) for n in record.notes if n.kind == "bad-quality"] == [
        ("bad-quality", "pv", 1)
    ]


def test_unknown_tag() -> None:
    with pytest.raises(DataError, match=r"no rows for tag 'flow' .*It has: amb, mode, op, pv, sp"):
        read_record(_long(), replace(ONE, outputs=(Channel("F", "flow"),)))
    with pytest.raises(DataError, match=r"no rows for tag 'PVs' .*did you mean 'pv'\?"):
        read_record(_long(), replace(ONE, outputs=(Channel("F", "PVs"),)))


@pytest.mark.parametrize(("key", "near"), [("tag", "tag"), ("value", "value"), ("quality", "quality")])
def test_a_misspelt_column_of_a_long_export_is_not_passed_over(key: str, near: str) -> None:
    """Without its quality column a record would keep the values that the historian calls bad."""
    with pytest.raises(DataError, match=rf"no column '{key}s' for the {key}; did you mean '{near}'\?"):
        read_record(_long(), replace(ONE, **{key: f"{key}s"}))


def test_frames_that_are_no_tables() -> None:
    with pytest.raises(DataError, match="not a table"):
        read_record(3.0, ONE)
    with pytest.raises(DataError, match="no rows"):
        read_record(pl.DataFrame(COLUMNS).clear(), ONE)
    with pytest.raises(DataError, match="do not form a table"):
        read_record(COLUMNS | {"pv": np.zeros(3)}, ONE)
    with pytest.raises(DataError, match="one value for each sample"):
        read_record(COLUMNS | {"pv": np.zeros((N, 2))}, ONE)


def test_mode_values() -> None:
    coded = COLUMNS | {"mode": [1] * 30 + [0] * 10}
    check(read_record(coded, ONE))
    remote = replace(ONE, inputs=(Channel("Q", "op", mode="mode", automatic_values=("CAS", 3)),))
    record = read_record(COLUMNS | {"mode": ["cas"] * 10 + ["MAN"] * 5 + [None] * 5 + ["3"] * 20}, remote)
    np.testing.assert_array_equal(record.automatic[:, 0], np.r_[np.ones(10), np.zeros(10), np.ones(20)].astype(bool))


def test_slave_signals() -> None:
    layout = replace(ONE, inputs=(Channel("Q", "op", slave_sp="sp", slave_pv="amb"),))
    record = read_record(COLUMNS, layout)
    assert record.slave_sp is not None
    assert record.slave_pv is not None
    np.testing.assert_array_equal(record.slave_pv[:, 0], COLUMNS["amb"])
    assert read_record(COLUMNS, ONE).slave_sp is None


def test_the_digest_of_a_frame_follows_its_values() -> None:
    first = read_record(COLUMNS, ONE).sha256
    assert first == read_record(pl.DataFrame(COLUMNS), ONE).sha256
    assert first != read_record(COLUMNS | {"pv": COLUMNS["pv"] + 1e-9}, ONE).sha256


def test_another_format_is_a_line_in_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def reader(source: Source) -> Table:
        frame = pl.read_ndjson(io.BytesIO(source.data))
        return Table(tuple(frame.columns), frame, source.name, source.sha256)

    path = tmp_path / "run.jsonl"
    pl.DataFrame({"t": [0.0, 1.0], "op": [1.0, 2.0]}).write_ndjson(path)
    with pytest.raises(DataError):
        read_table(path).numbers("op")
    monkeypatch.setitem(FORMATS, "JSON lines", Format((".jsonl",), reader))
    assert read_table(path).numbers("op")[0].tolist() == [1.0, 2.0]
