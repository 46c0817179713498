"""Events of a historian on an even grid: what is reconstructed, what stays missing, and that compression is noticed."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueplant.errors import DataError
from trueplant.record import Channel, Kind, Layout, read_record, screen
from trueplant.record.grid import Grid

START = datetime(2026, 10, 1, tzinfo=UTC)
LAYOUT = Layout(
    outputs=(Channel("y", "pv", sp="sp"),),
    inputs=(Channel("u", "op", mode="mode", automatic_values=(1,)),),
    time="time",
    project_time_unit="s",
    sample_time=5.0,
    max_gap=20.0,
)


def events(**tags: list[tuple[float, float, str]]) -> pl.DataFrame:
    rows = [(tag, START + timedelta(seconds=t), v, q) for tag, own in tags.items() for t, v, q in own]
    return pl.DataFrame(rows, schema=["tag", "time", "value", "quality"], orient="row")


def good(*pairs: tuple[float, float]) -> list[tuple[float, float, str]]:
    return [(t, v, "good") for t, v in pairs]


PV = [(3.0 * k, 10.0 + k) for k in range(41)]


def read(layout: Layout = LAYOUT, **changed: list[tuple[float, float, str]]):
    tags = {
        "pv": good(*PV),
        "op": good(*((4.0 * k, float(k)) for k in range(31))),
        "sp": good((-3600.0, 7.0), (31.0, 8.0)),
        "mode": good((-7200.0, 1.0), (40.0, 0.0)),
    }
    return read_record(events(**(tags | changed)), layout)


def test_pv_runs_straight_and_the_others_hold():
    record = read()
    t = np.arange(0.0, 121.0, 5.0)
    np.testing.assert_allclose(record.t, t, atol=1e-9)
    np.testing.assert_allclose(record.y[:, 0], 10 + t / 3, atol=1e-9)
    np.testing.assert_array_equal(record.u[:, 0], np.floor(t / 4))
    np.testing.assert_array_equal(record.r[:, 0], np.where(t < 31, 7.0, 8.0))
    np.testing.assert_array_equal(record.automatic[:, 0], t < 40)
    assert record.start == START


def test_bad_events_stay_bad_until_the_next_good_one():
    pv = [(t, v, "bad" if t == 21 else "uncertain" if t == 42 else "good") for t, v in PV]
    record = read(pv=pv)
    inside = ((record.t > 18) & (record.t < 24)) | ((record.t > 39) & (record.t < 45))
    np.testing.assert_array_equal(np.isnan(record.y[:, 0]), inside)
    assert any(note.kind is Kind.BAD_QUALITY for note in record.notes)
    op = [(4.0 * k, float(k), "bad" if k == 5 else "good") for k in range(31)]
    np.testing.assert_array_equal(np.isnan(read(op=op).u[:, 0]), (record.t >= 20) & (record.t < 24))


def test_nothing_is_drawn_across_a_long_gap():
    record = read(pv=good(*[pair for pair in PV if not 27 < pair[0] < 51]))
    np.testing.assert_array_equal(np.isnan(record.y[:, 0]), (record.t > 27) & (record.t < 51))
    record = read(op=good((0.0, 1.0), (32.0, 2.0), *((32.0 + 10 * k, 3.0) for k in range(1, 9))))
    np.testing.assert_array_equal(np.isnan(record.u[:, 0]), (record.t > 20) & (record.t < 32))


def test_a_code_is_not_interpolated_to():
    pv = good(*((t, -9999.0 if t == 30 else v) for t, v in PV))
    record = read(pv=pv)
    known = record.y[np.isfinite(record.y[:, 0]), 0]
    assert known.min() == 10.0
    np.testing.assert_array_equal(np.isnan(record.y[:, 0]), (record.t > 27) & (record.t < 33))


@given(
    st.lists(st.floats(0, 1000), min_size=2, max_size=30, unique=True),
    st.floats(0.5, 50),
    st.floats(1, 500),
)
def test_linear_is_that_of_numpy_where_no_gap_is_too_long(times, step, gap):
    stamps = np.sort(np.round(times, 3))
    if np.any(np.diff(stamps) < 1e-3):
        return
    values = np.sin(stamps)
    grid = Grid(np.arange(-10, 1010, step), step, gap)
    found = grid.linear(stamps, values)
    at = grid.moments
    k = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, stamps.size - 2)
    inside = (at >= stamps[0]) & (at <= stamps[-1])
    short = (np.diff(stamps)[k] <= gap) | np.isin(at, stamps)
    np.testing.assert_array_equal(np.isfinite(found), inside & short)
    np.testing.assert_allclose(found[inside & short], np.interp(at, stamps, values)[inside & short], atol=1e-9)


def test_two_pvs_by_exception_keep_their_samples():
    """Joined on common stamps each of two PVs that are stored in turn loses half of its samples."""
    rng = np.random.default_rng(0)
    a = good(*((5.0 * k, rng.normal()) for k in range(200)))
    b = good(*((5.0 * k + 2.5, rng.normal()) for k in range(200)))
    op = good(*((5.0 * k, rng.normal()) for k in range(200)))
    layout = Layout(
        outputs=(Channel("a", "a"), Channel("b", "b")), inputs=(Channel("u", "op"),), time="time",
        project_time_unit="s", sample_time=5.0, max_gap=20.0,
    )  # fmt: skip
    record = read_record(events(a=a, b=b, op=op), layout)
    assert np.isfinite(record.y).sum(axis=0).tolist() == [200, 199]


def test_filled_in_samples_are_noticed_as_compression():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.integers(2, 10, 400)).astype(float)
    pv = good(*zip(t, np.cumsum(rng.normal(size=t.size)), strict=True))
    op = good(*((float(k), rng.normal()) for k in range(int(t[-1]))))
    layout = replace(LAYOUT, outputs=(Channel("y", "pv"),), inputs=(Channel("u", "op"),), sample_time=1.0, max_gap=60.0)
    record = read_record(events(pv=pv, op=op), layout)
    told = [note for note in record.notes if note.kind is Kind.ALIGNED]
    # an event of its own has one moment of the grid in 5.5, the mean of 2 to 9 seconds apart
    assert told[0].value == pytest.approx(1 - 1 / 5.5, abs=0.02)
    found = [f for f in screen(record, layout).findings if f.kind is Kind.COMPRESSED and f.signal == "y"]
    assert found and found[0].value == pytest.approx(1 - told[0].value, abs=0.1)


def test_a_wide_file_has_its_own_grid():
    wide = pl.DataFrame({"time": np.arange(20.0), "pv": np.arange(20.0), "op": np.arange(20.0)})
    layout = replace(LAYOUT, outputs=(Channel("y", "pv"),), inputs=(Channel("u", "op"),))
    with pytest.raises(DataError, match="leave out data.sample_time"):
        read_record(wide, layout)


def test_a_grid_that_would_fill_the_memory_is_refused():
    with pytest.raises(DataError, match="longer data.sample_time"):
        read(replace(LAYOUT, most=20))
