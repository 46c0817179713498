"""Times in words: in the zone of the record, right across changes of its clock; numbers stay numbers."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueplant.calendar import Calendar, duration
from trueplant.errors import DataError
from trueplant.record import Channel, Layout, read_record

AMSTERDAM = "Europe/Amsterdam"
SPRING = Calendar("min", datetime(2024, 3, 31, 0, 0, tzinfo=UTC), AMSTERDAM)
"""01:00 CET; at 02:00 the clock jumps to 03:00."""
AUTUMN = Calendar("min", datetime(2024, 10, 27, 0, 0, tzinfo=UTC), AMSTERDAM)
"""02:00 CEST; at 03:00 the clock steps back to 02:00."""


def layout(**extra: object) -> Layout:
    return Layout((Channel("T", "pv"),), (Channel("Q", "op"),), **extra)  # type: ignore[arg-type]


def frame(time: object) -> dict[str, object]:
    return {"time": time, "pv": np.sin(np.arange(20)), "op": np.arange(20) % 4}


def test_the_hour_that_is_skipped_in_spring():
    assert [SPRING.text(t) for t in (59, 60)] == ["2024-03-31 01:59:00 CET", "2024-03-31 03:00:00 CEST"]
    assert SPRING.span(30, 90) == "2024-03-31 01:30:00 CET to 2024-03-31 03:30:00 CEST"
    assert SPRING.stamps((0, 60)) == ("2024-03-31T01:00:00+01:00", "2024-03-31T03:00:00+02:00")
    assert SPRING.axis([0, 60, 120]) == ["2024-03-31 01:00:00", "2024-03-31 03:00:00", "2024-03-31 04:00:00"]


def test_the_hour_that_comes_twice_in_autumn():
    assert [AUTUMN.text(t) for t in (15, 75)] == ["2024-10-27 02:15:00 CEST", "2024-10-27 02:15:00 CET"]
    assert AUTUMN.axis(np.array([15.0, 75.0])) == ["2024-10-27 02:15:00"] * 2
    twice = datetime(2024, 10, 27, 2, 15)
    assert (AUTUMN.time(twice), AUTUMN.time(twice, late=True)) == (15, 75)


@given(st.integers(0, 2 * 366 * 24 * 4), st.sampled_from([AMSTERDAM, "America/New_York", "Asia/Kolkata", "-03:30"]))
def test_stamps_lead_back_to_the_time(quarters: int, zone: str):
    calendar = Calendar("h", datetime(2023, 1, 1, tzinfo=UTC), zone)
    stamp = calendar.stamp(quarters / 4)
    assert stamp is not None
    assert calendar.time(datetime.fromisoformat(stamp)) == quarters / 4


def test_the_axis_shows_what_the_words_say():
    """All hours of a year, against polars' own conversion."""
    hours = np.arange(366 * 24, dtype=float)
    begin = datetime(2024, 1, 1, tzinfo=UTC)
    walls = pl.Series([begin + timedelta(hours=h) for h in hours.tolist()]).dt.convert_time_zone(AMSTERDAM)
    assert Calendar("h", begin, AMSTERDAM).axis(hours) == walls.dt.strftime("%Y-%m-%d %H:%M:%S").to_list()


def test_what_both_ends_share_is_said_once():
    assert AUTUMN.span(-600, -560) == "2024-10-26 16:00:00 to 16:40:00 CEST"
    assert AUTUMN.span(-600, -600) == AUTUMN.text(-600) and Calendar("min").span(3, 3) == "3 min"
    assert AUTUMN.span(-600, -60) == "2024-10-26 16:00:00 to 2024-10-27 01:00:00 CEST"


def test_moments_without_a_zone_stay_as_they_stand():
    calendar = Calendar("s", datetime(2024, 3, 31, 1, 30))
    assert calendar.text(3600) == "2024-03-31 02:30:00" and calendar.stamp(3600.25) == "2024-03-31T02:30:00.250"
    assert calendar.span(0, 0.5) == "2024-03-31 01:30:00 to 01:30:00.500" and calendar.label == ""
    assert calendar.time(datetime(2024, 3, 31, 2)) == 1800


def test_numbers_keep_their_unit():
    calendar = Calendar("min")
    assert calendar.text(412.5) == "412.5 min" and calendar.span(0, 123456.7) == "0 to 123457 min"
    assert calendar.stamp(1.0) is None and calendar.axis([1.0, None]) == [1.0, None] and calendar.label == "min"
    assert calendar.text(None) == "unknown"
    with pytest.raises(DataError, match="numbers for its time"):
        calendar.time(datetime(2024, 1, 1))


def test_the_ends_of_the_calendar_are_no_internal_error():
    with pytest.raises(DataError, match="end of the calendar"):
        SPRING.time(datetime(1, 1, 1))


def test_seconds_are_rounded_where_the_unit_is_longer():
    assert Calendar("min", datetime(2024, 1, 1)).text(0.9999) == "2024-01-01 00:01:00"


def test_an_offset_says_nothing_to_a_record_without_one():
    with pytest.raises(DataError, match=r"set data\.time_zone"):
        Calendar("min", datetime(2024, 1, 1)).time(datetime(2024, 1, 1, tzinfo=UTC))


@pytest.mark.parametrize(("mark", "zone"), [("+02:00", "+02:00"), ("Z", "UTC"), ("-0530", "-05:30")])
def test_stamps_are_shown_in_the_offset_that_they_bear(mark: str, zone: str):
    stamps = [f"2024-07-01T10:{k:02d}:00{mark}" for k in range(20)]
    record = read_record(frame(stamps), layout())
    assert record.zone == zone
    assert record.calendar.text(0.0).startswith("2024-07-01 10:00:00 UTC")
    assert record.calendar.stamp(5.0) == datetime.fromisoformat(stamps[5]).isoformat()
    local = read_record(frame(stamps), layout(time_zone="Asia/Tokyo"))
    assert local.calendar.stamp(5.0) == datetime.fromisoformat(stamps[5]).astimezone(ZoneInfo("Asia/Tokyo")).isoformat()


def test_several_offsets_are_shown_in_utc_unless_the_zone_is_named():
    moments = [datetime(2024, 3, 31, 0, 0, tzinfo=UTC) + timedelta(minutes=10 * k) for k in range(20)]
    stamps = [m.astimezone(ZoneInfo(AMSTERDAM)).isoformat() for m in moments]
    record = read_record(frame(stamps), layout())
    assert record.calendar.text(0.0) == "2024-03-31 00:00:00 UTC"
    assert any("+01:00, +02:00" in note.message and "data.time_zone" in note.message for note in record.notes)
    named = read_record(frame(stamps), layout(time_zone=AMSTERDAM))
    assert named.calendar.text(60.0) == "2024-03-31 03:00:00 CEST"
    assert not any("offsets" in note.message for note in named.notes)


def test_the_zone_of_a_column_of_moments_is_kept():
    moments = pl.datetime_range(
        datetime(2024, 3, 31), datetime(2024, 3, 31, 3, 10), "10m", time_zone="UTC", eager=True
    ).dt.convert_time_zone(AMSTERDAM)
    record = read_record(
        pl.DataFrame({"time": moments[:20], **{k: v for k, v in frame(0).items() if k != "time"}}), layout()
    )
    assert record.zone == AMSTERDAM and record.calendar.text(60.0) == "2024-03-31 03:00:00 CEST"


def test_an_offset_can_be_the_declared_zone():
    stamps = [f"2024-07-01 10:{k:02d}:00" for k in range(20)]
    record = read_record(frame(stamps), layout(time_zone="+05:30"))
    assert record.start == datetime(2024, 7, 1, 4, 30, tzinfo=UTC)
    assert record.calendar.stamp(0.0) == "2024-07-01T10:00:00+05:30"
    with pytest.raises(DataError, match="unknown time zone"):
        read_record(frame(stamps), layout(time_zone="+5 hours"))


def test_an_unknown_zone_is_named_even_where_stamps_bear_offsets():
    stamps = [f"2024-07-01T10:{k:02d}:00Z" for k in range(20)]
    with pytest.raises(DataError, match="did you mean Europe/Amsterdam"):
        read_record(frame(stamps), layout(time_zone="Europe/Amsterdm"))


@pytest.mark.parametrize(
    ("length", "unit", "said"),
    [
        (10 / 60, "min", "10 s"),
        (89.6667, "min", "89.7 min"),
        (162.0, "min", "2.7 h"),
        (119.0, "s", "119 s"),
        (120.0, "s", "2 min"),
        (0.5, "h", "30 min"),
        (1.0, "min", "1 min"),
        (0.25, "d", "6 h"),
        (3.0, "d", "3 d"),
        (0.02, "s", "0.02 s"),
        (0.005, "min", "0.3 s"),
        (500.0, "ms", "500 ms"),
    ],
)
def test_a_length_of_time_is_said_in_the_unit_that_reads_best(length: float, unit: str, said: str) -> None:
    assert duration(length, unit) == said
