"""Usable stretches of a history: those in which the moves are, ranked by what they tell (simulated, seeds stated)."""

from __future__ import annotations

import json
import tomllib
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import trueplant as tp
from support.changing import PROJECT
from support.month import LARGE, LIMIT, MANUAL, MIDDLE, SMALL, month
from support.simulated import BLT, WOOD_BERRY, coloured, segment_of, wood_berry
from support.stamped import AMSTERDAM, project_text, stamped
from trueplant.cli import main
from trueplant.identify import Row, Spec, fit_row, pieces_of
from trueplant.loop import simulate
from trueplant.lti.structure import Structure
from trueplant.project import Project
from trueplant.result import Check, Code, Status
from trueplant.study.pipeline import analyse
from trueplant.tracking.find import find
from trueplant.tracking.windows import blocks_of

MODE = 'mode = "mode"'
ZONE = f'time_zone = "{AMSTERDAM}"'
SETTLE = 110
"""Minutes: five lags and the dead time of the plant, roughly."""


def found_in(columns: dict[str, np.ndarray], how: str = "numbers", data: str = "", change: str = "") -> Check:
    text = project_text(data, MODE)
    text = text.replace('tf = "2 exp(-3 s)/(20 s + 1)"', change) if change else text
    return find(Project.from_toml(text), frames=[stamped(columns, how)])


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    return month()


@pytest.fixture(scope="module")
def numbers(columns: dict[str, np.ndarray]) -> Check:
    return found_in(columns)


def test_the_stretches_with_moves_in_automatic_are_found_the_best_first(numbers: Check):
    assert numbers.status == Status.OK and numbers.usable is not None
    # what is worth most has the largest moves; half the number of moves of a quarter of the size is worth least
    for one, known in zip(numbers.usable, (LARGE, MIDDLE, SMALL), strict=True):
        assert known[0] - 1.5 * SETTLE <= one.start <= known[0] - 0.5 * SETTLE
        assert known[1] - 60 + 0.5 * SETTLE <= one.end <= known[1] + 1.5 * SETTLE
        # there and back every hour, the last time by itself
        assert (one.moves, one.moved) == ((known[1] - known[0]) // 60, ("T",))


@pytest.mark.parametrize("place", [0, 1, 2])
def test_the_error_foretold_is_that_of_an_analysis_of_the_stretch(
    numbers: Check, columns: dict[str, np.ndarray], place: int
):
    assert numbers.usable is not None
    one = numbers.usable[place]
    inside = (columns["t"] >= one.start) & (columns["t"] <= one.end)
    part = stamped({name: x[inside] for name, x in columns.items()}, "numbers")
    analysis = analyse(Project.from_toml(project_text("", MODE)), frames=[part])
    gain = analysis.elements[0].parameters[0]
    (told,) = one.expected
    assert (told.parameter, gain.name) == ("gain", "gain") and told.std_error is not None
    assert gain.std_error is not None and 0.6 < told.std_error / gain.std_error < 1.5
    assert abs(told.value - 2.0) < 0.2


@pytest.mark.parametrize(("how", "data"), [("local", ZONE), ("offset", ZONE), ("local", "")])
def test_stretches_bear_the_time_of_the_record(numbers: Check, columns: dict[str, np.ndarray], how: str, data: str):
    if not data:  # without its zone no clock may jump within the record
        columns = {name: x[600:] for name, x in columns.items()}
    found = found_in(columns, how, data)
    assert found.usable is not None and numbers.usable is not None
    for one, same in zip(found.usable, numbers.usable, strict=True):
        assert one.calendar is not None
        begin = datetime.fromisoformat(one.calendar[0])
        assert (begin.tzinfo is None) == (data == "")
        on_the_wall = (begin.replace(tzinfo=None) - datetime(2024, 3, 30, 19)).total_seconds() / 60
        # all three lie in summer time, an hour ahead of the clock with which the record begins
        assert on_the_wall == pytest.approx(same.start + 60, abs=0.1 * SETTLE)


@pytest.mark.parametrize(
    ("only", "why"),
    [((), "no set-point changes"), ((MANUAL,), "only while the loop is in manual"), ((LIMIT,), "OP is at a limit")],
)
def test_where_nothing_is_usable_it_is_said_why(only: tuple[tuple[int, int], ...], why: str):
    found = found_in(month(only=only))
    assert found.status == Status.REFUSED and found.usable == ()
    assert found.reasons[0].code == Code.NO_EXCITATION and why in found.reasons[0].message
    assert why in found.headline


def test_a_set_point_that_is_missing_for_a_while_is_found_elsewhere(columns: dict[str, np.ndarray], numbers: Check):
    sp = columns["sp"].copy()
    sp[:2050] -= 0.5
    sp[2000:2100] = np.nan
    found = found_in(columns | {"sp": sp})
    assert found.usable is not None and numbers.usable is not None
    assert [(one.start, one.moves) for one in found.usable] == [(one.start, one.moves) for one in numbers.usable]


def test_moves_far_below_the_noise_are_not_usable():
    found = found_in(month(std=5.0, only=(SMALL,)))
    assert found.status == Status.REFUSED and "too little against" in found.reasons[0].message


def test_a_record_without_a_model_is_searched_as_well(columns: dict[str, np.ndarray], numbers: Check):
    found = found_in(columns, change='tf = "0"\nstructure = "fopdt"')
    assert found.usable is not None and numbers.usable is not None
    assert [round(one.start / 400) for one in found.usable] == [round(one.start / 400) for one in numbers.usable]


def test_each_loop_is_wanted_in_turn():
    """The second loop moves in one short stretch alone, which is worth less in itself than any of the first loop."""
    r, k = np.zeros((6000, 2)), np.arange(6000)
    for first in (300, 1500, 2700):
        r[first : first + 600, 0] = k[:600] // 60 % 2 == 0
    r[4300:4660, 1] = 0.5 * (k[:360] // 60 % 2 == 0)
    run = simulate(WOOD_BERRY, BLT, r, 1.0, v=coloured(np.random.default_rng(7), 6000, 2, [1, -0.8], [1], 0.1))
    frame = {"t": run.t} | {
        f"{name}{i + 1}": x[:, i] for name, x in (("sp", run.r), ("op", run.u), ("pv", run.y)) for i in range(2)
    }
    found = find(Project.from_toml(PROJECT), frames=[frame])
    assert found.usable is not None and len(found.usable) == 4
    assert {one.moved for one in found.usable} == {("top",), ("bottom",)}
    assert ("bottom",) in [one.moved for one in found.usable[:2]]


@pytest.fixture
def on_disk(tmp_path: Path, columns: dict[str, np.ndarray]) -> Path:
    stamped(columns, "local").write_csv(tmp_path / "march.csv")
    path = tmp_path / "p.toml"
    path.write_text(project_text(ZONE, MODE), "utf-8")
    return path


def test_all_but_the_stretches_is_excluded_once(on_disk: Path, capsys: pytest.CaptureFixture[str]):
    before = on_disk.read_text("utf-8")
    assert main(["check", str(on_disk), "--find", "--write"]) == 0
    said = capsys.readouterr().out
    assert "2024-04-11 " in said and "±" in said and "4 stretches excluded" in said
    after = on_disk.read_text("utf-8")
    # nothing else has changed
    added = tomllib.loads(after)["data"].pop("exclude")
    assert len(added) == 4 and all(e["from"].utcoffset() is not None for e in added)
    begin = after.index("exclude = ")
    assert after[:begin] + after[after.index("]\n", begin) + 2 :] == before
    # what is left are the stretches
    again = tp.check(on_disk)
    free = [span for span in again.data[0].excluded if span.reason == "excluded"]
    gaps = [(a.end + 1, b.start - 1) for a, b in pairwise(free)]
    for gap, known in zip(gaps, (SMALL, LARGE, MIDDLE), strict=True):
        assert gap[0] < known[0] and known[1] - 60 < gap[1] and gap[1] - gap[0] < known[1] - known[0] + 3 * SETTLE
    # and a second time nothing is left to do
    assert main(["check", str(on_disk), "--find", "--write"]) == 0
    assert "nothing to write" in capsys.readouterr().out and on_disk.read_text("utf-8") == after


def test_the_project_that_was_written_is_analysed(on_disk: Path):
    assert main(["check", str(on_disk), "--find", "--write"]) == 0
    analysis = tp.run(on_disk)
    assert analysis.status == Status.OK
    gain = analysis.elements["T", "steam"].parameters[0]
    assert gain.ci is not None and gain.ci[0] < 2.0 < gain.ci[1] and gain.ci[1] - gain.ci[0] < 0.2


def test_nothing_is_written_where_nothing_was_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    stamped(month(only=(MANUAL,)), "numbers").write_csv(tmp_path / "march.csv")
    path = tmp_path / "p.toml"
    path.write_text(project_text("", MODE).replace("\n", "\r\n"), "utf-8", newline="")
    before = path.read_bytes()
    assert main(["check", str(path), "--find", "--write", "--json"]) == 3
    body = json.loads(capsys.readouterr().out)
    assert body["status"] == "refused" and path.read_bytes() == before


def test_json_tells_the_stretches(on_disk: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["check", str(on_disk), "--find", "--json"]) == 0
    body = json.loads(capsys.readouterr().out)
    assert [one["moves"] for one in body["usable"]] == [12, 12, 6]
    assert datetime.fromisoformat(body["usable"][0]["calendar"][0]).utcoffset() is not None
    assert body["usable"][0]["expected"][0]["parameter"] == "gain"


def test_write_goes_with_find(on_disk: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["check", str(on_disk), "--write"]) == 2
    assert "--find" in capsys.readouterr().err


def test_a_file_without_usable_moves_is_excluded_whole(columns: dict[str, np.ndarray], tmp_path: Path):
    """Numeric time in hours, in a project that reckons in minutes."""
    for name, part in (("idle.csv", slice(0, 5_000)), ("moves.csv", slice(15_000, 20_000))):
        some = {key: x[part] for key, x in columns.items()}
        stamped(some | {"t": some["t"] / 60}, "numbers").write_csv(tmp_path / name)
    text = project_text('time_unit = "h"', MODE).replace('["march.csv"]', '["idle.csv", "moves.csv"]')
    (tmp_path / "p.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert main(["check", str(tmp_path / "p.toml"), "--find", "--write"]) == 0
    assert (tmp_path / "p.toml").read_bytes().startswith(b"\xef\xbb\xbf\ntime_unit")
    cut = Project.load(tmp_path / "p.toml").data.exclude
    assert [e.file for e in cut] == ["idle.csv", "moves.csv", "moves.csv"]
    assert (cut[0].start, cut[0].end) == (0, pytest.approx(4999 / 60))
    kept = cut[1].end * 60, cut[2].start * 60
    assert kept[0] < LARGE[0] < LARGE[1] - 60 < kept[1] and kept[1] - kept[0] < 720 + 3 * SETTLE
    again = tp.check(tmp_path / "p.toml")
    assert [one.refused is None for one in again.data] == [False, True] and again.status == Status.OK


def test_an_element_that_would_settle_in_a_million_years_takes_no_memory() -> None:
    """Blocks are as long as the piece at most; they were as long as the element takes to settle."""
    segment = segment_of(wood_berry(3, 400))
    row = Row(tuple(Spec(j, Structure.parse("fopdt")) for j in range(2)), pieces_of([segment], 0))
    fit = fit_row(row, np.array([12.8, 5e11, 1.4, -18.9, 21.0, 3.4]), np.zeros(0), iterations=0)
    found = blocks_of(fit, row, np.array([50.0]))
    assert found.start.size == 1
    assert found.end[0] - found.start[0] < segment.t[-1] - segment.t[0] + segment.h
    assert np.all(np.isfinite(found.information))
