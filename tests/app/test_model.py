"""The screen Model: what is typed is checked by the library, written as it stands, and held against the record."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from app.asking import Visitor
from app.results import UNSAFE
from trueplant.app.screens import laws
from trueplant.app.screens.model_edits import set_controller, set_element
from trueplant.project import Project
from trueplant.project.document import without_entries
from trueplant.tune.vendors import VENDORS

PROJECT = "?project=project.toml"
CELL = {"output": "top_temperature", "input": "reflux"}
PLACES = [(y, u) for y in ("top_temperature", "vaporisation") for u in ("reflux", "fuel_gas")]


@pytest.fixture
def visitor(demo_folder: Path) -> Visitor:
    return Visitor.inside(demo_folder)


def post(visitor: Visitor, verb: str, **said: Any) -> Any:
    return visitor.post(f"/api/model/{verb}{PROJECT}", said)


def changed_lines(before: str, after: str) -> list[tuple[str, str]]:
    pairs = zip(before.splitlines(), after.splitlines(), strict=True)
    return [(old, new) for old, new in pairs if old != new]


def test_a_page_that_cannot_be_shows_the_formula_that_is_wrong_in_lines_of_their_own(
    visitor: Visitor, demo_folder: Path
) -> None:
    file = demo_folder / "project.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("/(18 s + 1)", "/(18 s + 1"), encoding="utf-8")
    page = visitor.ask("GET", f"/model{PROJECT}")
    assert page.status == 422
    assert "<pre>    3.2 exp(-3 s)/(18 s + 1\n                  ^</pre>" in page.text


# -- elements ------------------------------------------------------------------------------------------------------


def test_the_page_shows_every_element_and_its_step(visitor: Visitor) -> None:
    page = visitor.ask("GET", f"/model{PROJECT}")
    assert page.status == 200 and not UNSAFE.search(page.text)
    assert page.text.count('class="cell"') == 4
    assert page.text.count("<polyline") == 3  # vaporisation does not answer to reflux
    for formula in ("-0.464/(12 s + 1)", "3.2 exp(-3 s)/(18 s + 1)", "3.8 exp(-0.5 s)/(2.8 s + 1)"):
        assert formula in page.text


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("-0.464/(12 s + ", "column"),
        ("2 s", "proper"),
        ("1/(0 s + 0)", "zero"),
        ("", "type a formula"),
        ("1/(1e30 s + 1)", "correct it"),
    ],
)
def test_a_wrong_formula_says_why_and_leaves_the_file(
    visitor: Visitor, demo_folder: Path, formula: str, said: str
) -> None:
    file = demo_folder / "project.toml"
    before = file.read_bytes()
    found = post(visitor, "check", **CELL, kind="tf", keys={"tf": formula}).json()
    assert found["right"] is False and said in found["why"], found["why"]
    assert str(demo_folder) not in found["why"]
    assert post(visitor, "element", **CELL, kind="tf", keys={"tf": formula}).status == 422
    assert file.read_bytes() == before


def test_a_right_formula_is_drawn_and_written_in_its_line(visitor: Visitor, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    before = file.read_text()
    keys = {"tf": "-0.58 exp(-s)/(10 s + 1)"}
    found = post(visitor, "check", **CELL, kind="tf", keys=keys).json()
    assert found["right"] and found["svg"].startswith("<svg") and "gain -0.58" in found["told"]
    assert file.read_text() == before
    answer = post(visitor, "element", **CELL, kind="tf", keys=keys)
    assert answer.status == 200 and answer.json()["can_undo"] is True
    assert answer.json()["cells"]["top_temperature"]["reflux"]["formula"] == keys["tf"]
    assert changed_lines(before, file.read_text()) == [('tf = "-0.464/(12 s + 1)"', f'tf = "{keys["tf"]}"')]
    assert visitor.post(f"/api/project/undo{PROJECT}", {}).status == 200
    assert file.read_text() == before


def test_a_change_of_what_another_has_changed_is_refused(visitor: Visitor, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    file.write_text(f"{file.read_text()}\n# by hand\n")
    before = file.read_text()
    answer = post(visitor, "element", **CELL, kind="none", keys={}, version="0" * 64)
    assert answer.status == 409 and file.read_text() == before


def test_an_element_is_taken_out_and_looked_for(visitor: Visitor, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    assert post(visitor, "element", **CELL, kind="none", keys={}).status == 200
    assert ("top_temperature", "reflux") not in Project.load(file).models
    assert not Project.load(file).wanted(0, 0)
    answer = post(visitor, "element", **CELL, kind="auto", keys={"structure": "fopdt"})
    assert answer.json()["cells"]["top_temperature"]["reflux"]["kind"] == "auto"
    assert Project.load(file).wanted(0, 0) and Project.load(file).structure(0, 0) == "fopdt"


def test_the_first_formula_leaves_the_rest_to_be_found(demo_folder: Path) -> None:
    bare = without_entries((demo_folder / "project.toml").read_text(), "model", lambda one: True)
    assert all(Project.from_toml(bare, demo_folder).wanted(i, j) for i in range(2) for j in range(2))
    assert set_element(bare, PLACES[0], {"structure": "auto"}, PLACES) == bare
    one = Project.from_toml(set_element(bare, PLACES[0], {"tf": "1/(s + 1)"}, PLACES), demo_folder)
    assert [one.wanted(i, j) for i in range(2) for j in range(2)] == [False, True, True, True]
    none = Project.from_toml(set_element(bare, PLACES[0], None, PLACES), demo_folder)
    assert [none.wanted(i, j) for i in range(2) for j in range(2)] == [False, True, True, True]
    text = bare
    for place in PLACES:
        text = set_element(text, place, None, PLACES)
    assert not any(Project.from_toml(text, demo_folder).wanted(i, j) for i in range(2) for j in range(2))


def test_step_coefficients_of_a_file_are_drawn_with_what_was_fitted(visitor: Visitor, demo_folder: Path) -> None:
    import numpy as np

    rows = [f"{t:g},{-0.5 * (1 - np.exp(-t / 8)):.6f},{1.0 if t else 0:g}" for t in np.arange(0, 60, 1.0)]
    (demo_folder / "steps.csv").write_text("t,reflux -> top_temperature,other\n" + "\n".join(rows) + "\n")
    listed = visitor.ask("GET", f"/api/model/columns{PROJECT}&file=steps.csv").json()["columns"]
    assert listed == ["t", "reflux -> top_temperature", "other"]
    keys = {"step": "steps.csv", "time": "t"}
    found = post(visitor, "check", **CELL, kind="step", keys=keys).json()
    assert found["right"], found
    assert 'class="points"' in found["svg"] and "fitted within" in found["words"]
    assert post(visitor, "element", **CELL, kind="step", keys=keys).status == 200
    model = Project.load(demo_folder / "project.toml").models["top_temperature", "reflux"]
    assert model.system.dc_gain == pytest.approx(-0.5, rel=0.02)
    missing = post(visitor, "check", **CELL, kind="step", keys={"step": "nothing.csv", "time": "t"}).json()
    assert missing["right"] is False and "nothing.csv" in missing["why"]
    assert visitor.ask("GET", f"/api/model/columns{PROJECT}&file=../etc/passwd").status == 404


def test_a_state_space_of_a_file(visitor: Visitor, demo_folder: Path) -> None:
    system = {"A": [[-0.1]], "B": [[1.0]], "C": [[-0.06]], "D": [[0.0]]}
    (demo_folder / "plant.json").write_text(json.dumps(system))
    assert "plant.json" in visitor.ask("GET", f"/model{PROJECT}").text
    found = post(visitor, "check", **CELL, kind="state_space", keys={"state_space": "plant.json"}).json()
    assert found["right"] and "gain -0.6" in found["told"]
    assert post(visitor, "element", **CELL, kind="state_space", keys={"state_space": "plant.json"}).status == 200
    assert Project.load(demo_folder / "project.toml").models["top_temperature", "reflux"].file == "plant.json"


def test_files_outside_and_elements_that_are_none_are_refused(visitor: Visitor, demo_folder: Path) -> None:
    before = (demo_folder / "project.toml").read_bytes()
    outside = post(visitor, "element", **CELL, kind="state_space", keys={"state_space": "../../x.json"})
    assert outside.status == 404
    assert post(visitor, "element", output="no", input="reflux", kind="none", keys={}).status == 400
    assert post(visitor, "element", **CELL, kind="guess", keys={}).status == 400
    assert (demo_folder / "project.toml").read_bytes() == before


# -- controllers ---------------------------------------------------------------------------------------------------


def test_a_controller_is_changed_in_its_lines(visitor: Visitor, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    before = file.read_text()
    keys = {"way": "ideal", "Kc": "1.0", "Ti": "6", "Td": "0.5", "alpha": "0.1", "action": "direct", "sample_time": 0.1}
    keys |= {key: str(value) for key, value in laws.DEFAULTS.items() if key not in keys} | {"setpoint_weight": "1"}
    found = post(visitor, "check-law", **CELL, keys=keys).json()
    assert found == {"right": True, "told": "ideal: Kc 1, Ti 6 min, Td 0.5 min, alpha 0.1"}
    assert post(visitor, "controller", **CELL, keys=keys).status == 200
    assert changed_lines(before, file.read_text()) == [("Ti = 8.0", "Ti = 6.0")]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"way": "ideal", "Kc": "", "Ti": "6"}, "Kc: is needed"),
        ({"way": "ideal", "Kc": "a lot"}, "is no number"),
        ({"way": "ideal", "Kc": "1", "Ti": "-3"}, "must be above 0"),
        ({"way": "vendor:Emerson DeltaV", "gain": "1"}, "span"),
        ({"way": "nobody's"}, "choose how"),
        ({"way": "tf", "tf": "1/(s"}, "column"),
    ],
)
def test_a_wrong_controller_says_why(visitor: Visitor, demo_folder: Path, keys: dict[str, Any], said: str) -> None:
    before = (demo_folder / "project.toml").read_bytes()
    found = post(visitor, "check-law", **CELL, keys=keys).json()
    assert found["right"] is False and said in found["why"], found["why"]
    assert post(visitor, "controller", **CELL, keys=keys).status == 422
    assert (demo_folder / "project.toml").read_bytes() == before


@pytest.mark.parametrize("vendor", VENDORS, ids=lambda vendor: vendor.name)
def test_every_vendor_has_fields_that_make_a_controller(demo_folder: Path, vendor: Any) -> None:
    text = (demo_folder / "project.toml").read_text().replace('unit = "degC"', 'unit = "degC"\nspan = [0, 200]')
    text = text.replace('name = "reflux"', 'name = "reflux"\nspan = [0, 100]', 1)
    way = f"vendor:{vendor.name}"
    said: dict[str, Any] = {key: "2" for key in laws.choices()["ways"][way]["keys"]}
    keys = laws.keys_of(tomllib.loads(text), PLACES[0], {"way": way, **said, "action": "direct"})
    project = Project.from_toml(set_controller(text, PLACES[0], keys), demo_folder)
    law = project.controllers[0]
    assert law.shown_by == vendor and law.kind == vendor.form and law.in_percent
    assert law.sample_time is None  # not said on this page
    assert vendor.form in laws.plain_words(project, PLACES[0])


def test_what_the_page_does_not_show_of_a_controller_stays(demo_folder: Path) -> None:
    text = (demo_folder / "project.toml").read_text().partition("\n[simulate]\n")[0]
    text = text.replace("Kc = 1.0\n", "Kc = 1.0  # since May\ngap = 0.5\n", 1)
    said = {"way": "ideal", "Kc": 1.0, "Ti": 7, "action": "direct"}
    after = set_controller(text, PLACES[0], laws.keys_of(tomllib.loads(text), PLACES[0], said))
    law = Project.from_toml(after, demo_folder).controllers[0]
    assert (law.gap, law.Ti, law.Td) == (0.5, 7.0, None)
    assert "# since May" in after and "# reflux cools the top" in after


def test_a_controller_is_added_and_taken_out(visitor: Visitor, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    assert post(visitor, "controller", **CELL, gone=True).status == 200
    assert [law.input for law in Project.load(file).controllers] == ["fuel_gas"]
    keys = {"way": "parallel", "Kp": "1", "Ki": "0.1", "action": "direct"}
    assert post(visitor, "controller", **CELL, keys=keys).status == 200
    law = Project.load(file).controllers[1]
    assert (law.input, law.kind, law.Kp, law.Ki) == ("reflux", "parallel", 1.0, 0.1)


# -- replay --------------------------------------------------------------------------------------------------------


def test_the_replay_says_whether_the_controllers_wrote_op(visitor: Visitor, demo_folder: Path) -> None:
    found = visitor.ask("GET", f"/api/model/replay{PROJECT}").json()["replays"]
    assert [(one["input"], one["confirmed"]) for one in found] == [("reflux", True), ("fuel_gas", True)]
    assert all("reproduces OP" in one["message"] and 'class="law"' in one["svg"] for one in found)
    file = demo_folder / "project.toml"
    file.write_text(file.read_text().replace("Ti = 8.0", "Ti = 4.0"))
    wrong = visitor.ask("GET", f"/api/model/replay{PROJECT}").json()["replays"]
    assert [(one["input"], one["confirmed"]) for one in wrong] == [("reflux", False), ("fuel_gas", True)]
    assert "integral time 2.000" in wrong[0]["message"]


def test_without_controllers_there_is_nothing_to_replay(visitor: Visitor, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    file.write_text(without_entries(file.read_text(), "controller", lambda one: True))
    assert visitor.ask("GET", f"/api/model/replay{PROJECT}").json() == {"replays": []}
