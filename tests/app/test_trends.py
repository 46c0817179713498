"""The requests of the screen Trends: what is drawn, what is struck, what is left out and found."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.asking import Visitor
from app.plant_files import STEP, german_csv, parquet
from trueplant.app.screens.asking import Seen
from trueplant.app.screens.lights import light_of
from trueplant.app.screens.records import read_shown
from trueplant.arrays import Array
from trueplant.cli.find import find_usable
from trueplant.project import Project
from trueplant.project.draft import draft_project
from trueplant.project.look import look
from trueplant.record.readers import read_table
from trueplant.result import Check
from trueplant.study.check import check

PROJECT = "?project=export.toml"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    path = german_csv(tmp_path / "export.csv")
    project = tmp_path / "export.toml"
    text = draft_project(path.name, look(read_table(path)))
    project.write_text(
        text.replace("# limits = [0, 100]   # the inst", "limits = [0, 90]   # the inst"), encoding="utf-8"
    )
    return project


@pytest.fixture
def visitor(place: Path) -> Iterator[Visitor]:
    visitor = Visitor.inside(place.parent)
    yield visitor
    seen: Seen | None = getattr(visitor.app.state, "trends", None)
    if seen is not None:
        seen.aside.close()


def get(visitor: Visitor, verb: str, **query: Any) -> Any:
    asked = "".join(f"&{key}={value}" for key, value in query.items())
    answer = visitor.ask("GET", f"/api/trends/{verb}{PROJECT}{asked}")
    assert answer.status == 200, answer.text
    return answer.json()


def view(visitor: Visitor, **query: Any) -> dict[str, Array]:
    signals = get(visitor, "record")["signals"]
    asked = "".join(f"&{key}={value}" for key, value in query.items())
    answer = visitor.ask("GET", f"/api/trends/view{PROJECT}{asked}")
    assert answer.status == 200, answer.text
    rows = np.frombuffer(answer.content, dtype="<f8").reshape(len(signals) + 1, -1)
    return dict(zip(["t", *signals], rows, strict=True))


def answered(visitor: Visitor, kind: str = "check") -> Any:
    assert visitor.post(f"/api/trends/ask{PROJECT}", {"kind": kind}).status == 200
    until = time.monotonic() + 120
    while (found := get(visitor, "answer", kind=kind))["state"] == "running":
        assert time.monotonic() < until
    return found


def test_a_record_is_told_before_it_is_drawn(visitor: Visitor) -> None:
    record = get(visitor, "record")
    assert record["samples"] == 1500 and record["step"] == pytest.approx(STEP / 60)
    assert record["signals"] == ["pv fic101_pv", "sp fic101_pv", "op fic101_op"]
    assert record["start"] == datetime.fromisoformat("2024-03-04T20:00:00+00:00").timestamp()
    assert (record["offsets"], record["exclusions"]) == ([], [])


def test_a_view_of_few_samples_is_what_was_recorded(visitor: Visitor, place: Path) -> None:
    project = Project.load(place)
    shown = read_shown(project, project.experiments[0])
    few = view(visitor, **{"from": 100, "to": 110, "points": 500})
    a, b = np.searchsorted(shown.t, few["t"][[0, -1]])
    np.testing.assert_array_equal(few["t"], shown.t[a : b + 1])
    np.testing.assert_array_equal(few["pv fic101_pv"], shown.signals["pv", "fic101_pv"].x[a : b + 1])
    assert few["t"][0] <= 100 and few["t"][-1] >= 110


def test_a_view_of_many_samples_keeps_extremes_and_gaps(visitor: Visitor) -> None:
    whole = view(visitor, points=60)
    pv = whole["pv fic101_pv"]
    assert pv.size <= 2 * 62 + 2 and np.all(np.diff(whole["t"]) > 0)
    assert np.nanmax(pv) == 95.0
    short = view(visitor, **{"from": 101, "to": 109, "points": 60})
    assert np.isnan(short["pv fic101_pv"]).all() and not np.isnan(short["op fic101_op"]).any()


@pytest.mark.parametrize("query", ["from=x", "from=nan&to=1", "from=0&to=inf", "points=many"])
def test_a_view_of_nonsense_is_refused(visitor: Visitor, query: str) -> None:
    assert visitor.ask("GET", f"/api/trends/view{PROJECT}&{query}").status == 400
    assert visitor.ask("GET", f"/api/trends/record{PROJECT}&record=7").status == 400


def test_what_check_struck_is_a_gap_with_its_reason_and_can_be_overruled(visitor: Visitor, place: Path) -> None:
    found = answered(visitor)
    assert found["state"] == "done" and not found["refused"]
    rows = {row["reason"]: row for row in found["struck"]}
    assert set(rows) == {"missing", "out-of-range", "frozen"}
    assert rows["missing"]["overrule"] is None and rows["missing"]["never"] == "there is no value to use"
    assert rows["frozen"]["spans"][0][2] == "2024-03-05 03:30:00 to 05:09:30"
    whole = view(visitor, points=4000)["pv fic101_pv"]
    assert np.isnan(whole[900:1100]).all() and np.nanmax(whole) < 70
    for nonsense in ({"signal": "fic101_pv", "reason": "missing"}, {"signal": "nobody", "reason": "frozen"}):
        assert visitor.post(f"/api/trends/overrule{PROJECT}", nonsense).status == 422
    assert "overrule" in rows["out-of-range"]["words"] or rows["out-of-range"]["overrule"].startswith("Use them")
    assert (
        visitor.post(f"/api/trends/overrule{PROJECT}", {"signal": "fic101_pv", "reason": "out-of-range"}).status == 200
    )
    assert Project.load(place).outputs[0].limits is None
    again = {row["reason"]: row["samples"] for row in answered(visitor)["struck"]}
    assert "out-of-range" not in again and again["spike"] == 2  # what was beyond the range is a spike, too


def test_what_looks_frozen_is_used_if_somebody_says_so_and_no_longer_if_not(visitor: Visitor, place: Path) -> None:
    before = place.read_text()
    overrule = {"signal": "fic101_pv", "reason": "frozen"}

    def row() -> dict[str, Any]:
        (found,) = (one for one in answered(visitor)["struck"] if one["reason"] == "frozen")
        return dict(found)

    assert row()["overrule"] == "Use them all the same"
    assert visitor.post(f"/api/trends/overrule{PROJECT}", overrule).status == 200
    assert Project.load(place).outputs[0].keep == ["frozen"]
    assert row()["overrule"] == "Leave them out again" and "used" in row()["words"]
    whole = view(visitor, points=4000)["pv fic101_pv"]
    assert np.isfinite(whole[900:1100]).all()
    assert visitor.post(f"/api/trends/overrule{PROJECT}", overrule).status == 200
    assert place.read_text() == before


def test_a_stretch_is_left_out_and_used_again(visitor: Visitor, place: Path) -> None:
    before = place.read_text(encoding="utf-8")
    start = get(visitor, "time", text="2024-03-04 20:10:10")["time"]
    end = get(visitor, "time", text="2024-03-04T20:20")["time"]
    done = visitor.post(f"/api/trends/exclude{PROJECT}", {"record": 0, "from": start, "to": end}).json()
    assert done["excluded"] == "2024-03-04 20:10:30 to 20:20:00"
    entry = Project.load(place).data.exclude[0]
    assert (entry.start, entry.end) == (datetime(2024, 3, 4, 20, 10, 30), datetime(2024, 3, 4, 20, 20))
    listed = get(visitor, "record")["exclusions"]
    assert [(one["place"], one["text"]) for one in listed] == [(0, "2024-03-04 20:10:30 to 20:20:00")]
    few = view(visitor, **{"from": 0, "to": 30, "points": 500})
    gone = (few["t"] >= 10.5) & (few["t"] <= 20)
    for name in ("pv fic101_pv", "sp fic101_pv", "op fic101_op"):
        np.testing.assert_array_equal(np.isnan(few[name]), gone)
    found = check(Project.load(place))
    struck = [one for one in found.data[0].excluded if one.reason == "excluded"]
    assert [(one.start, one.end) for one in struck] == [(10.5, 20.0)]
    assert visitor.post(f"/api/trends/include{PROJECT}", {"place": 0}).status == 200
    assert visitor.post(f"/api/trends/include{PROJECT}", {"place": 0}).status == 422
    assert Project.load(place).data.exclude == []
    for _ in range(2):
        assert visitor.post(f"/api/project/undo{PROJECT}", {}).status == 200
    assert place.read_text(encoding="utf-8") == before


@pytest.mark.parametrize(
    "given", [{"from": 5, "to": 1}, {"from": None, "to": 1}, {"from": 0.1, "to": 0.2}, {"from": "0", "to": 1}, {}]
)
def test_no_stretch_is_nothing_written(visitor: Visitor, place: Path, given: dict[str, Any]) -> None:
    before = place.read_bytes()
    answer = visitor.post(f"/api/trends/exclude{PROJECT}", {"record": 0, **given})
    assert answer.status in (400, 422) and answer.json()["error"]
    assert place.read_bytes() == before


def test_a_time_that_is_none_is_said(visitor: Visitor) -> None:
    for text in ("noon", "2024-13-01", "2024-03-04T20:00:00%2B01:00"):
        answer = visitor.ask("GET", f"/api/trends/time{PROJECT}&text={text}")
        assert answer.status == 422 and answer.json()["error"]


def test_times_and_exclusions_in_the_records_zone(tmp_path: Path) -> None:
    path = parquet(tmp_path / "export.parquet")
    project = tmp_path / "export.toml"
    text = draft_project(path.name, look(read_table(path)))
    project.write_text(text.replace("[data]\n", '[data]\ntime_zone = "Europe/Oslo"\n'), encoding="utf-8")
    visitor = Visitor.inside(tmp_path)
    record = get(visitor, "record")
    assert record["offsets"] == [[datetime.fromisoformat("2024-03-04T20:00:00+00:00").timestamp(), 3600.0]]
    assert get(visitor, "time", text="2024-03-04 21:05:00")["time"] == 5.0
    assert get(visitor, "time", text="2024-03-04T20:05:00%2B00:00")["time"] == 5.0
    assert visitor.post(f"/api/trends/exclude{PROJECT}", {"record": 0, "from": 5, "to": 6}).status == 200
    assert "from = 2024-03-04T21:05:00+01:00" in project.read_text(encoding="utf-8")


def test_of_several_records_one_is_left_out_of(tmp_path: Path) -> None:
    parquet(tmp_path / "export.parquet")
    parquet(tmp_path / "other.parquet", 1200)
    text = draft_project("export.parquet", look(read_table(tmp_path / "export.parquet")))
    place = tmp_path / "export.toml"
    place.write_text(text.replace('["export.parquet"]', '["export.parquet", "other.parquet"]'), encoding="utf-8")
    visitor = Visitor.inside(tmp_path)
    assert get(visitor, "record", record=1)["samples"] == 1200
    assert visitor.post(f"/api/trends/exclude{PROJECT}", {"record": 1, "from": 5, "to": 6}).status == 200
    assert Project.load(place).data.exclude[0].file == "other.parquet"
    assert len(get(visitor, "record", record=1)["exclusions"]) == 1
    assert get(visitor, "record", record=0)["exclusions"] == []
    page = visitor.ask("GET", f"/trends{PROJECT}").text
    assert '<option value="1">other.parquet</option>' in page


def test_a_historian_without_an_answer_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "export.toml").write_text(
        """time_unit = "min"
[data]
from = 2026-10-01T00:00:00Z
to = 2026-10-02T00:00:00Z
source = {kind = "sqlite", path = "gone.db", query = "select 1 from t where :tags and :from and :to"}
[[output]]
name = "y"
pv = "a"
[[input]]
name = "u"
op = "b"
"""
    )
    visitor = Visitor.inside(tmp_path)
    answer = visitor.ask("GET", f"/api/trends/record{PROJECT}")
    assert answer.status == 422 and "gone.db" in answer.json()["error"]
    assert "trueplant fetch" in visitor.ask("GET", f"/api/tags/columns{PROJECT}").json()["told"]


def test_a_clock_change_within_the_record_is_told(tmp_path: Path) -> None:
    clock = [(hour, minute) for hour in range(4) for minute in range(0, 60, 5)]
    rows = [f"2024-03-31T{h:02d}:{m:02d}:00Z,{k % 7},{k % 3},{k % 5}" for k, (h, m) in enumerate(clock)]
    (tmp_path / "export.csv").write_text("\n".join(["time,pv1,sp1,op1", *rows]))
    text = draft_project("export.csv", look(read_table(tmp_path / "export.csv")))
    (tmp_path / "export.toml").write_text(text.replace("[data]\n", '[data]\ntime_zone = "Europe/Oslo"\n'))
    offsets = get(Visitor.inside(tmp_path), "record")["offsets"]
    change = datetime.fromisoformat("2024-03-31T01:00:00+00:00").timestamp()
    assert [offset for _, offset in offsets] == [3600.0, 7200.0] and offsets[1][0] == change


def test_windows_are_those_of_the_command_line(visitor: Visitor, place: Path) -> None:
    found = answered(visitor, "find")
    assert found["state"] == "done" and found["usable"]
    assert found["usable"][0]["moves"] >= 1 and found["usable"][0]["gains"][0]["element"] == "fic101_op → fic101_pv"
    other = place.with_name("other.toml")
    other.write_bytes(place.read_bytes())
    assert find_usable(other, write=True, json=False) == 0
    done = visitor.post(f"/api/trends/write{PROJECT}", {}).json()
    assert done["count"] == len(Project.load(place).data.exclude) > 0
    assert place.read_text(encoding="utf-8") == other.read_text(encoding="utf-8")
    assert visitor.post(f"/api/trends/write{PROJECT}", {}).status == 422


def test_a_question_is_given_up(visitor: Visitor) -> None:
    assert visitor.post(f"/api/trends/ask{PROJECT}", {"kind": "find"}).status == 200
    assert visitor.post(f"/api/trends/cancel{PROJECT}", {}).status == 200
    assert get(visitor, "answer", kind="find")["state"] == "cancelled"
    assert answered(visitor, "check")["state"] == "done"
    assert visitor.post(f"/api/trends/ask{PROJECT}", {"kind": "rm"}).status == 400


def test_a_process_that_is_killed_is_said_and_the_next_question_is_answered(visitor: Visitor) -> None:
    assert visitor.post(f"/api/trends/ask{PROJECT}", {"kind": "check"}).status == 200
    process = visitor.app.state.trends.aside._process
    process.kill()
    found = answered_state(visitor)
    assert found["state"] == "failed" and "memory" in found["error"]
    assert answered(visitor)["state"] == "done"


def answered_state(visitor: Visitor) -> Any:
    until = time.monotonic() + 30
    while (found := get(visitor, "answer", kind="check"))["state"] == "running":
        assert time.monotonic() < until
    return found


def test_data_that_cannot_be_read_are_one_message(visitor: Visitor, place: Path) -> None:
    (place.parent / "export.csv").write_text("Zeitstempel;FIC101.PV\n1;2\n")
    answer = visitor.ask("GET", f"/api/trends/record{PROJECT}")
    assert answer.status == 422 and "export.csv" in answer.json()["error"]
    assert str(place.parent) not in answer.json()["error"]
    (place.parent / "export.csv").unlink()
    answer = visitor.ask("GET", f"/api/trends/record{PROJECT}")
    assert answer.status == 422 and "export.csv does not exist" in answer.json()["error"]
    found = answered(visitor)
    assert found["state"] == "failed" and "export.csv does not exist" in found["error"]
    assert visitor.ask("GET", f"/api/tags/columns{PROJECT}").status == 422


# -- the light -------------------------------------------------------------------------------------------------------


def checked(sp: Array, pv: Array, op: Array, loop: str = "closed", recorded: bool = True) -> Check:
    text = f"""time_unit = "min"
[[experiment]]
file = "a.csv"
loop = "{loop}"
[[output]]
name = "y"
pv = "pv"
{'sp = "sp"' if recorded else ""}
[[input]]
name = "u"
op = "op"
"""
    frame = {"time": np.arange(sp.size) * 1.0, "sp": sp, "pv": pv, "op": op}
    return check(Project.from_toml(text), frames=[frame])


@pytest.fixture(scope="module")
def signals() -> tuple[Array, Array, Array]:
    from app.plant_files import loop

    return loop()


def test_light_of_moves_that_are_enough(signals: tuple[Array, Array, Array]) -> None:
    found = checked(*signals)
    light = light_of(found, found.data[0], "y")
    assert (light.look, light.symbol) == ("good", "✓") and "moved" in light.told and "PV noise is" in light.told


def test_light_of_a_set_point_that_stands_still(signals: tuple[Array, Array, Array]) -> None:
    sp, pv, op = signals
    found = checked(np.full_like(sp, 60.0), pv, op)
    light = light_of(found, found.data[0], "y")
    assert (light.look, light.words) == ("bad", "set-point never moves")


def test_light_of_moves_that_drown(signals: tuple[Array, Array, Array]) -> None:
    rng = np.random.default_rng(0)
    sp = 60 + 1e-4 * (signals[0] - 60)
    found = checked(sp, 60 + rng.normal(size=sp.size), 50 + rng.normal(size=sp.size))
    light = light_of(found, found.data[0], "y")
    assert light.look in ("bad", "doubt") and light.symbol in ("✗", "?")


def test_light_without_a_set_point_and_in_open_loop(signals: tuple[Array, Array, Array]) -> None:
    found = checked(*signals, recorded=False)
    assert light_of(found, found.data[0], "y").words == "no set-point is named"
    found = checked(*signals, loop="open")
    assert light_of(found, found.data[0], "y").words == "OP moves, in open loop"
