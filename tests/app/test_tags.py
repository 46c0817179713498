"""The requests of the screen Tags: every change stands in the project file, and can be undone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.asking import Visitor
from app.plant_files import german_csv, parquet, pi_export
from trueplant.app.screens.columns import certainty, columns_of
from trueplant.app.screens.loops import pairs_of
from trueplant.project import Project
from trueplant.project.draft import draft_project
from trueplant.project.look import look
from trueplant.record.readers import read_table

PROJECT = "?project=export.toml"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    path = german_csv(tmp_path / "export.csv")
    project = tmp_path / "export.toml"
    project.write_text(draft_project(path.name, look(read_table(path))), encoding="utf-8")
    return project


@pytest.fixture
def visitor(place: Path) -> Visitor:
    return Visitor.inside(place.parent)


def change(visitor: Visitor, verb: str, **given: Any) -> Any:
    answer = visitor.post(f"/api/tags/{verb}{PROJECT}", given)
    assert answer.status == 200, answer.text
    return answer.json()


def test_the_page_and_its_columns(visitor: Visitor) -> None:
    assert visitor.ask("GET", f"/tags{PROJECT}").status == 200
    found = visitor.ask("GET", f"/api/tags/columns{PROJECT}").json()
    by_name = {one["name"]: one for one in found["columns"]}
    assert list(by_name) == ["FIC101.PV", "FIC101.SP", "FIC101.OP", "FIC101.MODE", "FI300.PV"]
    assert by_name["FIC101.MODE"]["modes"] == [["AUTO", 1430, True], ["MAN", 50, False], ["BCASX", 20, None]]
    assert by_name["FIC101.PV"]["unit"] == "m³/h" and by_name["FIC101.PV"]["modes"] is None
    assert found["outside"] == ["FI300.PV"]
    trend = by_name["FIC101.PV"]["trend"]
    assert 50 < len(trend) < 120
    assert all(pair is None or 0 <= pair[0] <= pair[1] <= 1 for pair in trend)


def test_small_trends_keep_gaps_and_are_not_flattened_by_a_spike(place: Path) -> None:
    columns = {one.name: one for one in columns_of(read_table(place.parent / "export.csv"), "tag", "value")}
    trend = columns["FIC101.PV"].trend
    assert None in trend  # twenty samples are missing
    inside = [pair[1] - pair[0] for pair in trend if pair is not None]
    assert max(inside) > 0.3 and columns["FIC101.PV"].high == 95.0


def test_tags_of_a_long_export(tmp_path: Path) -> None:
    columns = columns_of(read_table(pi_export(tmp_path / "pi.txt")), "tag", "value")
    assert [one.name for one in columns] == ["FIC101.PV", "FIC101.SP", "FIC101.OP"]
    assert columns[1].modes is None or len(columns[1].modes) <= 40
    assert columns[0].low is not None and columns[0].low > 50


def test_keys_are_set_and_undone(visitor: Visitor, place: Path) -> None:
    before = place.read_text(encoding="utf-8")
    state = change(visitor, "set", table="output", name="fic101_pv", keys={"limits": ["0", "120,5"], "kind": "level"})
    assert state["can_undo"] and state["state"]["loops"][0]["output"]["limits"] == [0, 120.5]
    project = Project.load(place)
    assert (project.outputs[0].limits, project.outputs[0].kind) == ((0, 120.5), "level")
    change(visitor, "set", table="input", name="fic101_op", keys={"automatic_values": ["AUTO", "BCASX"]})
    assert Project.load(place).inputs[0].automatic_values == ["AUTO", "BCASX"]
    change(visitor, "set", table="output", name="fic101_pv", keys={"limits": ["", ""], "kind": ""})
    assert Project.load(place).outputs[0].limits is None
    for _ in range(3):
        assert visitor.post(f"/api/project/undo{PROJECT}", {}).status == 200
    assert place.read_text(encoding="utf-8") == before


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"table": "output", "name": "fic101_pv", "keys": {"limits": ["9", "1"]}}, "low below high"),
        ({"table": "output", "name": "fic101_pv", "keys": {"limits": ["x", "1"]}}, "no number"),
        ({"table": "output", "name": "fic101_pv", "keys": {"pv": ""}}, "needs its PV"),
        ({"table": "output", "name": "fic101_pv", "keys": {"name": "other"}}, "cannot be changed"),
        ({"table": "data", "name": "x", "keys": {"pv": "a"}}, "cannot be changed"),
        ({"table": "output", "name": "gone", "keys": {"pv": "a"}}, "load the page again"),
        ({"table": "input", "name": "fic101_op", "keys": {"slave_sp": "a"}}, "go together"),
    ],
)
def test_what_makes_no_project_is_not_written(
    visitor: Visitor, place: Path, given: dict[str, Any], message: str
) -> None:
    before = place.read_bytes()
    answer = visitor.post(f"/api/tags/set{PROJECT}", given)
    assert answer.status in (400, 422) and message in answer.json()["error"]
    assert place.read_bytes() == before


def test_another_change_is_not_overwritten(visitor: Visitor, place: Path) -> None:
    version = change(visitor, "set", table="output", name="fic101_pv", keys={"unit": "t/h"})["version"]
    place.write_text(place.read_text(encoding="utf-8") + "\n# mine\n", encoding="utf-8")
    given = {"table": "output", "name": "fic101_pv", "keys": {"unit": "%"}, "version": version}
    assert visitor.post(f"/api/tags/set{PROJECT}", given).status == 409
    assert place.read_text(encoding="utf-8").endswith("# mine\n")


def test_a_loop_is_added_and_removed(visitor: Visitor, place: Path) -> None:
    state = change(visitor, "add", pv="FI300.PV", op="FIC101.SP", sp="", mode="", name="ratio 7")["state"]
    assert [loop["output"]["name"] for loop in state["loops"]] == ["fic101_pv", "ratio_7_pv"]
    assert state["loops"][1]["certainty"] == {
        "pv": "sure", "sp": "none", "op": "chosen", "mode": "none", "status_output": "none", "status_input": "none"
    }  # fmt: skip
    change(visitor, "remove", output="ratio_7_pv", input="ratio_7_op")
    assert Project.load(place).output_names == ("fic101_pv",)
    last = visitor.post(f"/api/tags/remove{PROJECT}", {"output": "fic101_pv", "input": "fic101_op"})
    assert last.status == 400 and "at least one loop" in last.json()["error"]


def test_another_column_as_a_disturbance(visitor: Visitor, place: Path) -> None:
    change(visitor, "use", column="FI300.PV", use="disturbance", unit="t/h")
    assert [(one.column, one.unit) for one in Project.load(place).disturbances] == [("FI300.PV", "t/h")]
    change(visitor, "use", column="FI300.PV", use="disturbance")
    assert len(Project.load(place).disturbances) == 1
    change(visitor, "use", column="FI300.PV", use="ignore")
    assert not Project.load(place).disturbances


@pytest.mark.parametrize(
    ("column", "role", "said"),
    [
        ("FIC101.PV", "pv", "sure"),
        ("reactor temperature", "pv", "likely"),
        ("something", "pv", "chosen"),
        ("FIC101.OP", "pv", "chosen"),
        (None, "sp", "none"),
        ("FIC101.MODE", "mode", "sure"),
    ],
)
def test_how_surely_a_column_is_what_it_is_taken_for(column: str | None, role: Any, said: str) -> None:
    assert certainty(column, role) == said


def test_loops_are_paired_by_controllers_then_tags_then_order(tmp_path: Path) -> None:
    path = parquet(tmp_path / "two.parquet", 100)
    text = draft_project(path.name, look(read_table(path)))
    assert pairs_of(Project.from_toml(text)) == [(0, 0), (1, 1)]
    law = '\n[[controller]]\ninput = "fic102_op"\noutput = "fic101_pv"\nform = "ideal"\nKc = 1\nTi = 1\n'
    assert pairs_of(Project.from_toml(text + law)) == [(0, 1), (1, 0)]
    plain = (
        'time_unit = "s"\noutput = [{name = "a", pv = "a"}]\ninput = [{name = "b", op = "b"}, {name = "c", op = "c"}]\n'
    )
    assert pairs_of(Project.from_toml(plain)) == [(0, 0), (None, 1)]


def test_a_broken_project_is_one_message(visitor: Visitor, place: Path) -> None:
    place.write_text("[data]\nfiles = 3\n", encoding="utf-8")
    answer = visitor.ask("GET", f"/tags{PROJECT}")
    assert answer.status == 422 and "files" in answer.text
    assert visitor.ask("GET", "/tags").status == 400
    assert visitor.ask("GET", "/tags?project=other.toml").status == 404
