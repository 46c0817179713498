"""Time columns: units, notations, zones, clock changes, order."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from trueplant.errors import DataError
from trueplant.record import Channel, Kind, Layout, levels, read_record

ONE = Layout((Channel("T", "pv"),), (Channel("Q", "op"),))
N = 20
MOMENTS = [datetime(2024, 10, 17, 21, 50) + timedelta(seconds=30 * k) for k in range(N)]


def frame(time: list[object] | np.ndarray, name: str = "time") -> dict[str, object]:
    n = len(time)
    return {name: time, "pv": np.sin(np.arange(n)), "op": np.arange(n) % 4}


@pytest.mark.parametrize(
    "notation",
    [
        "%Y-%m-%d %H:%M:%S",
        "%Y-%m-%dT%H:%M:%S",
        "%Y/%m/%d %H:%M:%S",
        "%d.%m.%Y %H:%M:%S",
        "%m/%d/%Y %I:%M:%S %p",
        "%d-%b-%y %H:%M:%S",
        "%d-%b-%Y %H:%M:%S",
        "%d %b %Y %H:%M:%S",
        "%Y%m%d %H:%M:%S",
        "%Y-%m-%d %H:%M:%S.000",
        "%Y-%m-%d %H:%M:%S,0",
        "%d.%m.%y %H:%M:%S",
    ],
)
def test_notations_of_one_moment(notation: str) -> None:
    record = read_record(frame([m.strftime(notation) for m in MOMENTS]), ONE)
    assert record.start == MOMENTS[0]
    np.testing.assert_allclose(record.t, 0.5 * np.arange(N), atol=1e-12)


def test_stamps_without_seconds_and_at_midnight() -> None:
    moments = [datetime(2024, 1, 31, 23, 50) + timedelta(minutes=k) for k in range(N)]
    stamps = [f"{m:%d.%m.%Y}" if (m.hour, m.minute) == (0, 0) else f"{m:%d.%m.%Y %H:%M}" for m in moments]
    np.testing.assert_allclose(read_record(frame(stamps), ONE).t, np.arange(N), atol=1e-12)


@pytest.mark.parametrize(
    ("step", "notation", "said"),
    [
        (10.0, "%d/%m/%Y %H:%M", "50 rows .*83 % of all, and the stamps hold whole minutes.*with seconds"),
        (30.0, "%Y-%m-%d %H:%M", "30 rows .*50 % of all, and the stamps hold whole minutes.*with seconds"),
        (0.5, "%Y-%m-%d %H:%M:%S", "30 rows .*the stamps hold whole seconds.*with fractions of a second"),
        (600.0, "%Y-%m-%d %H", "50 rows .*the stamps hold whole hours.*with minutes"),
    ],
)
def test_stamps_that_are_cut_are_said_with_what_to_export(step: float, notation: str, said: str) -> None:
    first = datetime(2024, 5, 3, 6, 0)
    stamps = [f"{first + timedelta(seconds=step * k):{notation}}" for k in range(60)]
    record = read_record(frame([f"{s}:00" if notation.endswith("%H") else s for s in stamps]), ONE)
    (found,) = (note for note in record.notes if note.kind is Kind.DUPLICATE)
    assert re.search(said, found.message), found.message
    assert found.samples == 60 - record.t.size


def test_times_in_numbers_that_were_cut_are_said_too() -> None:
    (found,) = (n for n in read_record(frame(np.floor(np.arange(60) / 2)), ONE).notes if n.kind is Kind.DUPLICATE)
    assert re.search("30 rows .*50 % of all, and the times may lack digits", found.message), found.message


@pytest.mark.parametrize(("repeated", "advised"), [(14, False), (16, True)])
def test_stamps_that_repeat_now_and_then_are_not_called_coarse(repeated: int, advised: bool) -> None:
    assert 14 < levels.REPEATED_TIMES * 60 < 16
    moments = [datetime(2024, 5, 3, 6, 0) + timedelta(seconds=k - (k % 2) * (k < 2 * repeated)) for k in range(60)]
    (found,) = (n for n in read_record(frame(moments), ONE).notes if n.kind is Kind.DUPLICATE)
    assert found.samples == repeated and ("fractions of a second" in found.message) == advised


def test_dates_that_could_be_swapped_are_shown_as_they_stand_in_the_file() -> None:
    stamps = [f"03/05/2024 06:{k:02d}" for k in range(30)]
    messages = [note.message for note in read_record(frame(stamps), ONE).notes]
    assert any("dates such as 03/05/2024 06:00 were read as day first" in message for message in messages), messages


@pytest.mark.parametrize("mark", ["Z", "+02:00", "-0530", " UTC"])
def test_offsets_lead_to_utc(mark: str) -> None:
    record = read_record(frame([m.strftime("%Y-%m-%dT%H:%M:%S.250") + mark for m in MOMENTS]), ONE)
    shift = {"Z": 0, " UTC": 0, "+02:00": 120, "-0530": -330}[mark]
    assert record.start == MOMENTS[0].replace(tzinfo=UTC) + timedelta(milliseconds=250) - timedelta(minutes=shift)


def test_day_and_month_are_told_apart_by_the_smoother_time() -> None:
    moments = [datetime(2024, 3, 1) + timedelta(days=k) for k in range(12)]
    for notation in ("%d/%m/%Y %H:%M", "%m/%d/%Y %H:%M"):
        record = read_record(frame([m.strftime(notation) for m in moments]), replace(ONE, project_time_unit="d"))
        np.testing.assert_allclose(record.t, np.arange(12), atol=1e-12)


def test_a_swap_that_cannot_be_told_is_said() -> None:
    record = read_record(frame([f"03.04.2024 10:{k:02d}" for k in range(N)]), ONE)
    assert record.start == datetime(2024, 4, 3, 10)
    assert any("day first" in n.message for n in record.notes)


def test_date_and_clock_in_two_columns() -> None:
    data = {"Date": [f"{m:%Y-%m-%d}" for m in MOMENTS], **frame([f"{m:%H:%M:%S}" for m in MOMENTS], "Time")}
    record = read_record(data, ONE)
    assert record.start == MOMENTS[0]
    np.testing.assert_allclose(record.t, 0.5 * np.arange(N), atol=1e-12)
    with pytest.raises(DataError, match="without a date"):
        read_record(frame([f"{m:%H:%M:%S}" for m in MOMENTS], "Time"), ONE)


@pytest.mark.parametrize("unit", ["ms", "s", "min", "h", "d"])
def test_units_of_numeric_time(unit: str) -> None:
    seconds = {"ms": 1e-3, "s": 1, "min": 60, "h": 3600, "d": 86400}[unit]
    record = read_record(frame(5.0 + np.arange(N)), replace(ONE, time_unit=unit, project_time_unit="min"))
    np.testing.assert_allclose(record.t, (5.0 + np.arange(N)) * seconds / 60)
    assert record.start is None


@pytest.mark.parametrize("zone", ["Europe/Berlin", "America/New_York"])
def test_autumn_clock_change_runs_forward(zone: str) -> None:
    turn = datetime(2024, 10, 26, 22, tzinfo=UTC) if zone == "Europe/Berlin" else datetime(2024, 11, 3, 4, tzinfo=UTC)
    moments = [turn + timedelta(minutes=10 * k) for k in range(30)]
    stamps = [m.astimezone(ZoneInfo(zone)).strftime("%Y-%m-%d %H:%M:%S") for m in moments]
    assert stamps != sorted(stamps)
    record = read_record(frame(stamps), replace(ONE, time_zone=zone))
    np.testing.assert_allclose(record.t, 10 * np.arange(30), atol=1e-9)
    assert record.start == turn
    with pytest.raises(DataError, match="autumn"):
        read_record(frame(stamps), ONE)


def test_spring_clock_change_leaves_no_gap() -> None:
    turn = datetime(2024, 3, 31, 0, tzinfo=UTC)
    stamps = [
        (turn + timedelta(minutes=10 * k)).astimezone(ZoneInfo("Europe/Berlin")).replace(tzinfo=None) for k in range(20)
    ]
    record = read_record(frame([str(s) for s in stamps]), replace(ONE, time_zone="Europe/Berlin"))
    np.testing.assert_allclose(np.diff(record.t), 10, atol=1e-9)


def test_an_hour_that_does_not_exist() -> None:
    stamps = [f"2024-03-31 02:{k:02d}:00" for k in range(N)]
    with pytest.raises(DataError, match="does not exist in Europe/Berlin"):
        read_record(frame(stamps), replace(ONE, time_zone="Europe/Berlin"))


def test_unknown_zone_and_unit() -> None:
    stamps = [str(m) for m in MOMENTS]
    with pytest.raises(DataError, match="Europe/Berlin"):
        read_record(frame(stamps), replace(ONE, time_zone="Europe/Berlinn"))
    with pytest.raises(DataError, match="fortnight"):
        read_record(frame(np.arange(N)), replace(ONE, time_unit="fortnight"))


def test_time_is_found_by_its_name_or_by_its_values() -> None:
    named = {"pv": np.sin(np.arange(N)), "op": np.arange(N) % 3, "Time [s]": 60.0 * np.arange(N)}
    np.testing.assert_allclose(read_record(named, ONE).t, np.arange(N))
    unnamed = {"count": np.arange(N) % 7, "pv": np.sin(np.arange(N)), "op": np.arange(N) % 3, "X": 60.0 * np.arange(N)}
    np.testing.assert_allclose(read_record(unnamed, ONE).t, np.arange(N))
    with pytest.raises(DataError, match="looks like time"):
        read_record({"pv": np.sin(np.arange(N)), "op": np.arange(N) % 3}, ONE)


def test_a_descending_file_is_reversed() -> None:
    data = frame(60.0 * np.arange(N)[::-1])
    record = read_record(data, ONE)
    np.testing.assert_allclose(record.t, np.arange(N))
    np.testing.assert_allclose(record.y[:, 0], np.asarray(data["pv"])[::-1])
    assert [n.kind for n in record.notes] == ["backwards"]


def test_single_rows_out_of_order_are_sorted_in() -> None:
    time = 60.0 * np.arange(200)
    time[[50, 51]] = time[[51, 50]]
    record = read_record(frame(time), ONE)
    np.testing.assert_allclose(record.t, np.arange(200))
    assert record.y[50, 0] == pytest.approx(np.sin(51))
    assert any(n.kind == "backwards" and n.samples == 1 for n in record.notes)


def test_time_that_starts_again_is_an_error() -> None:
    time = np.concatenate([np.arange(100), np.arange(100)]) * 60.0
    with pytest.raises(DataError, match=r"row 101.*runs backwards \(5940 s to 0 s\).*one file for each run"):
        read_record(frame(time), ONE)


def test_repeated_stamps_keep_the_first() -> None:
    time = 60.0 * np.arange(N)
    time[7] = time[6]
    record = read_record(frame(time), ONE)
    assert record.t.size == N - 1
    assert record.y[6, 0] == pytest.approx(np.sin(6))
    (note,) = [n for n in record.notes if n.kind == "duplicate"]
    assert note.samples == 1


def test_stamps_that_cannot_be_read() -> None:
    stamps = [str(m) for m in MOMENTS]
    stamps[4] = "yesterday"
    with pytest.raises(DataError, match=r"row 5, column 'time': 'yesterday'"):
        read_record(frame(stamps), ONE)
