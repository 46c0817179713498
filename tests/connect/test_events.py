"""Rows of any source as events: times in UTC, numbers, and quality in words."""

from __future__ import annotations

from datetime import UTC, datetime

import polars as pl
import pytest

from trueplant.connect.events import events, qualities, times, values
from trueplant.errors import DataError

MOMENT = datetime(2026, 3, 5, 4, 0, 0, 250000, tzinfo=UTC)


def utc(series: pl.Series, zone: str | None = None) -> list[datetime]:
    return times(series, "here", zone)[0].to_list()


@pytest.mark.parametrize(
    "cells",
    [
        ["2026-03-05T04:00:00.25Z"],
        ["2026-03-05 04:00:00.250000+00"],
        ["2026-03-05T05:00:00.25+01:00"],
        ["2026-03-05T04:00:00.2500000Z"],
        [1772683200.25],
        [1772683200250],
        [1772683200250000],
        [1772683200250000000],
        [MOMENT],
    ],
    ids=str,
)
def test_one_moment_in_many_notations(cells):
    assert utc(pl.Series(cells)) == [MOMENT]


def test_stamps_without_a_zone_go_by_the_declared_one():
    local = pl.Series([datetime(2026, 3, 5, 5, 0, 0, 250000)])
    assert utc(local, "Europe/Oslo") == [MOMENT]
    assert utc(pl.Series(["2026-03-05 05:00:00.25"]), "Europe/Oslo") == [MOMENT]
    with pytest.raises(DataError, match="bear no zone"):
        times(local, "here", None)


def test_a_local_time_that_the_clock_skips_is_an_error_and_not_moved():
    with pytest.raises(DataError, match=r"2026-03-29 02:30:00 does not exist in Europe/Oslo"):
        times(pl.Series([datetime(2026, 3, 29, 2, 30)]), "here", "Europe/Oslo")


def test_the_hour_that_comes_twice_is_kept_as_bad():
    frame = pl.DataFrame(
        {"a": ["x"] * 3, "b": [datetime(2026, 10, 25, hour, 30) for hour in (1, 2, 3)], "c": [1.0, 2.0, 3.0]}
    )
    assert events(frame, "here", None, "Europe/Oslo")["quality"].to_list() == ["good", "bad", "good"]


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (["5 March"], "is no time"),
        (["2026-03-05 04:00:00Z", "2026-03-05 04:00:00"], "some stamps bear an offset"),
        ([True], "type Boolean"),
        ([MOMENT.date()], "type Date"),
    ],
)
def test_what_is_no_time_is_refused(cells, words):
    with pytest.raises(DataError, match=words):
        times(pl.Series(cells), "here", "UTC")


@pytest.mark.parametrize(
    ("kind", "cells", "words"),
    [
        ("opc", [192, 216, 255, 64, 80, 127, 0, 24, 128, 300], "ggguuubbbb"),
        ("opc", [0, 0, 0], "bbb"),
        ("pi", [0, 1, -255], "gbb"),
        ("percent", [100, 99, 0, 50], "gubu"),
        ("words", ["Good", "good, local override", "UNCERTAIN", "Bad", "GoodEnough", ""], "ggubbb"),
        (None, ["good", "bad"], "gb"),
        ("opc", [None, 192], "ug"),
        ("pi", [None], "u"),
    ],
)
def test_quality_in_words(kind, cells, words):
    names = {"g": "good", "u": "uncertain", "b": "bad"}
    found = qualities(pl.Series(cells), "here", kind).to_list()
    assert found == [names[word] for word in words]


def test_codes_of_which_nobody_says_what_they_mean_are_refused():
    with pytest.raises(DataError, match=r'data.source.quality = "opc", "pi" or "percent"'):
        qualities(pl.Series([0, 0, 0]), "here", None)


def test_values_are_numbers():
    assert values(pl.Series(["1.5", " 2 ", "Bad Input", None]), "here").to_list() == [1.5, 2.0, None, None]
    assert values(pl.Series([True, False]), "here").to_list() == [1.0, 0.0]
    with pytest.raises(DataError, match="the value is text"):
        values(pl.Series(["AUTO", "MAN"]), "here")
    with pytest.raises(DataError, match="cast it to a number"):
        values(pl.Series([[1.0]]), "here")


def test_what_is_no_number_is_bad():
    frame = pl.DataFrame({"t": ["a"] * 4, "s": [MOMENT] * 4, "v": [1.0, None, float("nan"), float("inf")]})
    found = events(frame, "here", None, None)
    assert found["quality"].to_list() == ["good", "bad", "bad", "bad"]
    assert found["value"].to_list() == [1.0, None, None, None]


def test_columns_are_counted():
    with pytest.raises(DataError, match="gives 2 columns"):
        events(pl.DataFrame({"a": ["x"], "b": [MOMENT]}), "here", None, None)
