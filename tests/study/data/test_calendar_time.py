"""Check, exclude and track speak of a record with time stamps in calendar time, in its zone (simulated)."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from support.pages import unpacked
from support.stamped import AMSTERDAM, project_text, record, square_wave, stamped
from trueplant.cli.data import show_check
from trueplant.cli.track import show as show_track
from trueplant.errors import ProjectError
from trueplant.project import Project
from trueplant.report.page import render
from trueplant.report.track import render as render_track
from trueplant.result import Check, Curves, Track
from trueplant.result.codec import build, plain
from trueplant.study.check import check
from trueplant.study.pipeline import analyse
from trueplant.tracking.track import track

N = 1500
COLUMNS = record(square_wave(N, 60))
ZONE = f'time_zone = "{AMSTERDAM}"'


def checked(how: str, data: str = "") -> Check:
    return check(Project.from_toml(project_text(data)), frames=[stamped(COLUMNS, how)])


EXCLUDE = "exclude = [{{from = {}, to = {}}}]"
"""20:00 to 21:00 on the wall is 60 to 120 min: the record begins at 19:00 CET."""


@pytest.mark.parametrize(
    ("how", "data"),
    [
        ("numbers", EXCLUDE.format(60, 120)),
        ("local", f"{ZONE}\n{EXCLUDE.format('2024-03-30T20:00:00', '2024-03-30T21:00:00')}"),
        ("local", f"{ZONE}\n{EXCLUDE.format('2024-03-30T20:00:00+01:00', '2024-03-30T20:00:00Z')}"),
        ("local", EXCLUDE.format("2024-03-30T20:00:00", "2024-03-30T21:00:00")),
        ("offset", f"{ZONE}\n{EXCLUDE.format('2024-03-30T20:00:00', '2024-03-30T21:00:00')}"),
        ("offset", EXCLUDE.format("2024-03-30T19:00:00", "2024-03-30T20:00:00")),
    ],
)
def test_a_stretch_is_excluded_by_the_clock_of_the_record(how: str, data: str):
    found = checked(how, data)
    (cut,) = [e for e in found.data[0].excluded if e.reason == "excluded"]
    assert (cut.start, cut.end) == (60, 120)


def test_an_excluded_stretch_across_the_change_of_the_clock():
    """From 01:30 CET to 03:30 CEST an hour goes by."""
    found = checked("local", f"{ZONE}\n{EXCLUDE.format('2024-03-31T01:30:00', '2024-03-31T03:30:00')}")
    (cut,) = [e for e in found.data[0].excluded if e.reason == "excluded"]
    assert (cut.start, cut.end) == (390, 450)
    assert cut.calendar == ("2024-03-31T01:30:00+01:00", "2024-03-31T03:30:00+02:00")
    assert found.to_dict()["data"][0]["excluded"][0]["calendar"] == list(cut.calendar)


def test_an_offset_without_a_zone_is_refused():
    with pytest.raises(ProjectError, match=r"bear none.*data\.time_zone"):
        checked("local", EXCLUDE.format("2024-03-30T20:00:00Z", "2024-03-30T21:00:00Z"))
    with pytest.raises(ProjectError, match="numbers for its time"):
        checked("numbers", EXCLUDE.format("2024-03-30T20:00:00", "2024-03-30T21:00:00"))


def test_check_says_when(capsys: pytest.CaptureFixture[str]):
    show_check(checked("local", f"{ZONE}\n{EXCLUDE.format('2024-03-31T01:30:00', '2024-03-31T03:30:00')}"))
    said = capsys.readouterr().out
    assert "2024-03-30 19:00:00 CET to 2024-03-31 20:59:00 CEST, one every 1 min" in said
    assert "left out as asked. 2024-03-31 01:30:00 CET to 2024-03-31 03:30:00 CEST." in said
    show_check(checked("numbers", EXCLUDE.format(60, 120)))
    said = capsys.readouterr().out
    assert "0 to 1499 min, one every 1 min" in said and "left out as asked. 60 to 120 min." in said


def test_check_json_gains_time_stamps_and_keeps_its_numbers():
    local, numbers = checked("local", ZONE).to_dict()["data"][0], checked("numbers").to_dict()["data"][0]
    assert local["span"] == numbers["span"] and local["used"] == numbers["used"]
    assert local["time_zone"] == AMSTERDAM
    assert local["span_calendar"] == ["2024-03-30T19:00:00+01:00", "2024-03-31T20:59:00+02:00"]
    assert [datetime.fromisoformat(x).utcoffset() is not None for x in local["used_calendar"][0]] == [True, True]
    assert not {"time_zone", "span_calendar", "used_calendar"} & numbers.keys()


@pytest.fixture(scope="module")
def tracks() -> dict[str, Track]:
    """The gain rises by 40 % in the middle: the loop is simulated in two halves, each from rest."""
    project = project_text(ZONE)
    columns = record(square_wave(2600, 60), std=0.05)
    columns["op"] = np.where(columns["t"] < 1300, columns["op"], 50 + (columns["op"] - 50) / 1.4)
    return {how: track(Project.from_toml(project), frames=[stamped(columns, how)]) for how in ("numbers", "local")}


def test_a_track_bears_time_stamps_beside_its_numbers(tracks: dict[str, Track]):
    numbers, local = tracks["numbers"], tracks["local"]
    assert numbers.start is None and local.start == "2024-03-30T18:00:00+00:00" and local.time_zone == AMSTERDAM
    (was,), (is_) = numbers.changes, local.changes[0]
    assert (was.kind, was.time, was.interval) == (is_.kind, is_.time, is_.interval)
    assert was.time_calendar is None and is_.time_calendar == local.calendar.stamp(is_.time)
    for w in local.windows:
        assert w.calendar == local.calendar.stamps((w.start, w.end))
    assert all(w.calendar is None for w in numbers.windows)
    assert local.calendar.text(is_.time) in local.headline and "CEST" in local.headline
    assert numbers.calendar.text(was.time) in numbers.headline


def test_the_page_and_the_terminal_say_when(tracks: dict[str, Track], capsys: pytest.CaptureFixture[str]):
    local = tracks["local"]
    when = local.calendar.text(local.changes[0].time)
    page = render_track(local)
    figures = unpacked(page)["book"]
    assert when in page and "Amsterdam)" in figures and '"type":"date"' in figures
    show_track(local)
    assert when[:16] in capsys.readouterr().out


def test_a_project_file_on_disk_is_read_in_its_zone(tmp_path: Path):
    (tmp_path / "p.toml").write_text(project_text(ZONE))
    stamped(COLUMNS, "local").write_csv(tmp_path / "march.csv")
    found = check(Project.load(tmp_path / "p.toml"))
    assert found.data[0].calendar("min").text(0.0) == "2024-03-30 19:00:00 CET"


def test_the_report_says_when():
    """Its table of the data, its trends and where it comes from; a saved result keeps its zone."""
    data = f"{ZONE}\n{EXCLUDE.format('2024-03-31T01:30:00', '2024-03-31T03:30:00')}"
    result = analyse(Project.from_toml(project_text(data)), frames=[stamped(COLUMNS, "local")])
    page = render(result)
    assert page.count("2024-03-30 19:00:00 CET to 2024-03-31 20:59:00 CEST") >= 2
    assert "2024-03-31 01:30:00 CET to 2024-03-31 03:30:00 CEST" in page and '"type":"date"' in unpacked(page)["book"]
    assert result.curves is not None
    again = build(Curves, plain(result.curves))
    assert again.calendar(again.trends[0]) == result.curves.calendar(result.curves.trends[0])
    assert again.calendar(again.trends[0]).text(0.0) == "2024-03-30 19:00:00 CET"


def test_check_says_a_sample_time_below_one_unit_in_seconds(capsys: pytest.CaptureFixture[str]):
    found = checked("numbers", EXCLUDE.format(60, 120))
    show_check(replace(found, data=(replace(found.data[0], sample_time=10 / 60),)))
    assert "0 to 1499 min, one every 10 s" in capsys.readouterr().out
