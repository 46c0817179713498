"""Segments: uniform grids from gaps, jitter, rounding and irregular sampling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.record import Channel, Layout, Screened, read_record, screen
from trueplant.record.runs import hold_same

LAYOUT = Layout((Channel("T", "pv", sp="sp"),), (Channel("Q", "op"),), (Channel("amb", "amb"),), project_time_unit="s")
RNG = np.random.default_rng(7)
N = 300


def record_at(t: np.ndarray) -> dict[str, Any]:
    k = np.arange(t.size)
    return {
        "t": t,
        "sp": np.where(k < t.size // 2, 1.0, 2.0),
        "pv": np.sin(t / 9) + 0.3 * np.cos(t / 3.7),
        "op": RNG.uniform(0, 1, t.size),
        "amb": np.cos(t / 50),
    }


def screened(data: dict[str, Any]) -> Screened:
    return screen(read_record(data, LAYOUT), LAYOUT)


def test_a_long_gap_begins_a_new_segment() -> None:
    t = np.arange(N) * 2.0
    t[200:] += 50.0
    result = screened(record_at(t))
    assert [(s.t[0], s.t[-1], s.h) for s in result.segments] == [(0.0, 398.0, 2.0), (450.0, 648.0, 2.0)]
    (gap,) = [f for f in result.findings if f.kind == "gap"]
    assert gap.spans == ((398.0, 450.0),)


def test_short_gaps_are_bridged_by_holding_op() -> None:
    whole = record_at(np.arange(N) * 2.0)
    kept = np.delete(np.arange(N), [50, 120, 121])
    result = screened({name: x[kept] for name, x in whole.items()})
    (segment,) = result.segments
    assert len(segment) == N
    np.testing.assert_allclose(segment.t, np.arange(N) * 2.0)
    assert np.flatnonzero(np.isnan(segment.y[:, 0])).tolist() == [50, 120, 121]
    expected = whole["op"].copy()
    expected[50], expected[[120, 121]] = whole["op"][49], whole["op"][119]
    np.testing.assert_array_equal(segment.u[:, 0], expected)
    assert any(f.kind == "gap" and f.samples == 3 for f in result.findings)


def test_missing_op_is_held_for_three_samples_and_no_more() -> None:
    data = record_at(np.arange(N) * 2.0)
    data["op"][50:53] = np.nan
    data["op"][150:154] = np.nan
    result = screened(data)
    assert [(s.t[0], s.t[-1]) for s in result.segments] == [(0.0, 298.0), (308.0, 598.0)]
    np.testing.assert_array_equal(result.segments[0].u[50:53, 0], data["op"][49])
    assert all(np.isfinite(s.u).all() and np.isfinite(s.d).all() for s in result.segments)
    assert any(f.kind == "missing" and f.signal == "Q" for f in result.findings)


def test_short_pieces_are_dropped() -> None:
    t = np.arange(N) * 1.0
    t[100:] += 50
    t[109:] += 50
    assert [len(s) for s in screened(record_at(t)).segments] == [100, N - 109]


def test_small_jitter_is_an_even_grid() -> None:
    t = np.arange(N) + 0.02 * RNG.standard_normal(N)
    data = record_at(t)
    (segment,) = screened(data).segments
    assert len(segment) == N
    assert segment.h == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_array_equal(segment.y[:, 0], data["pv"])


@pytest.mark.parametrize("h", [1.6, 2.5, 3.4])
def test_stamps_rounded_to_full_seconds_are_an_even_grid(h: float) -> None:
    data = record_at(np.floor(np.arange(N) * h))
    result = screened(data)
    (segment,) = result.segments
    assert segment.h == pytest.approx(h, rel=2e-3)
    assert len(segment) == N
    np.testing.assert_array_equal(segment.y[:, 0], data["pv"])


def test_irregular_sampling_is_interpolated_and_said() -> None:
    t = np.cumsum(RNG.uniform(0.3, 1.7, 600))
    data = record_at(t)
    result = screened(data)
    (note,) = [f for f in result.findings if f.kind == "irregular"]
    assert "interpolated" in note.message
    (segment,) = result.segments
    y = segment.y[:, 0]
    # sin(t/9) + 0.3 cos(t/3.7): interpolation over 1.5 h errs by at most h^2/8 max|y''| = 0.0096 at h = 1.5
    assert np.nanmax(np.abs(y - (np.sin(segment.t / 9) + 0.3 * np.cos(segment.t / 3.7)))) < 0.0096
    assert 0.5 < np.isfinite(y).mean() < 1.0
    # OP is the mean of what was held over each step of the grid; here by sampling that finely
    fine = segment.t[:-1, None] + segment.h * (np.arange(400) + 0.5) / 400
    held = data["op"][np.searchsorted(t, fine, side="right") - 1].mean(axis=1)
    np.testing.assert_allclose(segment.u[:-1, 0], held, atol=0.01)


def test_exclusions_are_not_interpolated_over() -> None:
    t = np.cumsum(RNG.uniform(0.6, 1.4, 300))
    record = read_record(record_at(t), LAYOUT)
    result = screen(record, LAYOUT, exclude=[(100.0, 120.0)])
    y = result.segments[0].y[:, 0]
    inside = (result.segments[0].t > 100.5) & (result.segments[0].t < 119.5)
    assert np.isnan(y[inside]).all()


@settings(max_examples=50, deadline=None)
@given(
    steps=st.lists(st.integers(1, 8), min_size=25, max_size=120),
    h=st.sampled_from([0.25, 1.0, 10.0]),
    holes=st.sets(st.integers(0, 119), max_size=15),
)
def test_segments_hold_only_recorded_values_at_their_times(steps: list[int], h: float, holes: set[int]) -> None:
    """On a grid with missing rows and cells: every finite y is the recorded one, u is the last known one."""
    # mostly single steps, so that h is the median
    place = np.cumsum([1 if k % 3 else s for k, s in enumerate(steps)])
    data = record_at(place * h)
    missing = np.array(sorted(k for k in holes if k < place.size), dtype=int)
    data["pv"][missing] = np.nan
    result = screened(data)
    seen = 0
    for segment in result.segments:
        assert segment.h == pytest.approx(h)
        np.testing.assert_allclose(np.diff(segment.t), h)
        at = np.searchsorted(place * h, segment.t + h / 2) - 1
        on = np.abs(place[at] * h - segment.t) < h / 4
        np.testing.assert_array_equal(segment.u[:, 0], data["op"][at])
        np.testing.assert_array_equal(
            segment.y[on, 0], np.where(result.usable_y[at[on], 0], data["pv"][at[on]], np.nan)
        )
        assert np.isnan(segment.y[~on]).all()
        assert np.isfinite(segment.y[[0, -1]]).all()
        seen += int(np.isfinite(segment.y).sum())
    assert seen <= int(result.usable_y.sum())


@pytest.mark.parametrize("hold", [None, "linear", "zoh"])
def test_a_measured_disturbance_comes_to_the_grid_as_it_runs(hold: str | None) -> None:
    t = np.cumsum(RNG.uniform(0.3, 1.7, 600))
    data = record_at(t) | {"amb": RNG.standard_normal(600)}
    layout = Layout(
        LAYOUT.outputs, LAYOUT.inputs, (Channel("amb", "amb", hold=hold),), time_unit="s", project_time_unit="s"
    )
    (segment,) = screen(read_record(data, layout), layout).segments
    assert segment.holds == ("written", hold or "linear")
    if hold == "zoh":
        # what acts until the next instant of the grid, from a grid 1,000 times as fine
        fine = segment.t[:-1, None] + segment.h * (np.arange(1000) + 0.5) / 1000
        expected = data["amb"][np.searchsorted(t, fine, side="right") - 1].mean(axis=1)
        np.testing.assert_allclose(segment.d[:-1, 0], expected, atol=0.01)
    else:
        np.testing.assert_allclose(segment.d[:, 0], np.interp(segment.t, t, data["amb"]))


def test_set_points_are_held_over_gaps_between_the_same_values() -> None:
    nan = np.nan
    x = np.array([[nan, 1, nan, nan, nan, 1, nan, 2, 2, nan], [1, 1, 1, nan, nan, nan, nan, 2, nan, 2]], dtype=float).T
    expected = [[nan, 1, 1, 1, 1, 1, nan, 2, 2, nan], [1, 1, 1, nan, nan, nan, nan, 2, 2, 2]]
    np.testing.assert_array_equal(hold_same(x), np.array(expected, dtype=float).T)


@pytest.mark.parametrize(
    ("excluded", "spans"),
    [
        ([(100, 149)], [(0, 299)]),  # shorter than what lies on either side: one record with samples missing
        ([(60, 249)], [(0, 59), (250, 299)]),
        ([(40, 99), (130, 259)], [(0, 39), (100, 129), (260, 299)]),
        ([(0, 199)], [(200, 299)]),
        ([(40, 199)], [(0, 39), (200, 299)]),
        ([(40, 119)], [(0, 299)]),  # longer than the part before, but not than that after
    ],
)
def test_what_is_excluded_for_longer_than_it_separates_cuts_the_record(excluded, spans):
    t = np.arange(300.0)
    frame = {"t": t, "pv": np.sin(t / 7) + 0.01 * np.cos(3 * t), "op": np.cos(t / 5)}
    layout = Layout((Channel("T", "pv"),), (Channel("Q", "op"),), time_unit="min")
    found = screen(read_record(frame, layout), layout, exclude=excluded)
    assert [(s.t[0], s.t[-1]) for s in found.segments] == spans
    assert sum(np.isfinite(s.y).sum() for s in found.segments) == 300 - sum(b - a + 1 for a, b in excluded)
