"""What is understood of a data file at first sight, and what of it can be corrected."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from app.plant_files import german_csv, parquet, pi_export, workbook
from trueplant.app.screens.historian import source_text
from trueplant.app.screens.preview import command, preview, project_text
from trueplant.cli import main
from trueplant.errors import DataError, ProjectError
from trueplant.project import Project
from trueplant.project.hints import Hints


def test_german_csv(tmp_path: Path) -> None:
    seen = preview(german_csv(tmp_path / "export.csv"), Hints()).to_dict()
    assert (seen["separator"], seen["encoding"], seen["decimal"]) == ("semicolon", "cp1252", "comma")
    assert (seen["time"], seen["stamped"], seen["interval"], seen["zone"]) == ("Zeitstempel", True, "30 s", None)
    assert seen["height"] == 1500 and not seen["long"] and not seen["doubt"]
    assert seen["units"]["FIC101.PV"] == "m³/h"
    assert seen["loops"] == [{"pv": "FIC101.PV", "sp": "FIC101.SP", "op": "FIC101.OP", "mode": "FIC101.MODE"}]
    assert seen["rows"][0][0] == "04.03.2024 20:00:00"
    assert seen["span"] == "2024-03-04 20:00:00 to 2024-03-05 08:29:30"
    assert any("BCASX" in note for note in seen["modes"])


def test_utf16_export_of_a_pi_system(tmp_path: Path) -> None:
    seen = preview(pi_export(tmp_path / "pi.txt"), Hints()).to_dict()
    assert (seen["separator"], seen["encoding"], seen["long"]) == ("tab", "utf-16", True)
    assert (seen["interval"], seen["zone"]) == ("30 s", "UTC")
    assert seen["tags"] == ["FIC101.PV", "FIC101.SP", "FIC101.OP"]
    assert len(seen["loops"]) == 1


def test_workbook_with_the_data_on_its_second_sheet(tmp_path: Path) -> None:
    path = workbook(tmp_path / "book.xlsx")
    with pytest.raises(DataError, match="sheet"):
        preview(path, Hints())
    seen = preview(path, Hints.of({"sheet": "Data"})).to_dict()
    assert seen["height"] == 400 and seen["interval"] == "30 s" and seen["loops"][0]["pv"] == "TIC7.PV"
    assert seen["separator"] is None and seen["decimal"] is None
    assert 'sheet = "Data"' in project_text(path, tmp_path / "book.toml", Hints.of({"sheet": "Data"}))


def test_parquet(tmp_path: Path) -> None:
    seen = preview(parquet(tmp_path / "two.parquet"), Hints()).to_dict()
    assert [loop["op"] for loop in seen["loops"]] == ["FIC101.OP", "FIC102.OP"]
    assert (seen["zone"], seen["interval"], seen["stamped"]) == ("UTC", "30 s", True)


def test_zone_and_order_of_dates_are_corrected_and_written(tmp_path: Path) -> None:
    path = german_csv(tmp_path / "export.csv")
    hints = Hints.of({"time_zone": "Europe/Berlin", "time_format": "dmy", "shape": "", "tag": ""})
    seen = preview(path, hints).to_dict()
    assert seen["zone"] == "Europe/Berlin"
    assert seen["span"] == "2024-03-04 20:00:00 to 2024-03-05 08:29:30 CET"
    project = Project.from_toml(project_text(path, tmp_path / "export.toml", hints), tmp_path)
    assert (project.data.time_zone, project.data.time_format) == ("Europe/Berlin", "dmy")


def test_a_zone_that_is_none_is_said_in_one_message(tmp_path: Path) -> None:
    seen = preview(german_csv(tmp_path / "export.csv"), Hints.of({"time_zone": "Europe/Bern"})).to_dict()
    assert "Europe/Bern" in seen["doubt"] and "did you mean" in seen["doubt"]


def test_numbers_that_count_take_their_unit(tmp_path: Path) -> None:
    path = tmp_path / "counts.csv"
    path.write_text("t,pv1,sp1,op1\n" + "".join(f"{k / 2},{k % 7},{k % 3},{k % 5}\n" for k in range(50)))
    assert preview(path, Hints()).to_dict()["interval"] is None
    hints = Hints.of({"time_unit": "min"})
    seen = preview(path, hints).to_dict()
    assert (seen["interval"], seen["span"]) == ("30 s", "0 to 24.5 min")
    text = project_text(path, tmp_path / "counts.toml", hints)
    assert text.count("time_unit") == 2 and Project.from_toml(text, tmp_path).data.time_unit == "min"


def test_a_long_export_with_unusual_columns(tmp_path: Path) -> None:
    path = tmp_path / "odd.csv"
    rows = [f"2024-03-05 00:{k:02d}:00;{tag};{k % 9}" for k in range(40) for tag in ("a.PV", "a.OP", "a.SP")]
    path.write_text("\n".join(["when;who;how much", *rows]))
    assert not preview(path, Hints()).to_dict()["long"]
    hints = Hints.of({"tag": "who", "value": "how much", "time": "when"})
    seen = preview(path, hints).to_dict()
    assert seen["long"] and seen["interval"] == "1 min" and seen["loops"][0]["op"] == "a.OP"
    project = Project.from_toml(project_text(path, tmp_path / "odd.toml", hints), tmp_path)
    assert (project.data.tag, project.data.value) == ("who", "how much")


def test_a_long_export_on_an_even_grid(tmp_path: Path) -> None:
    path = pi_export(tmp_path / "pi.txt")
    hints = Hints.of({"sample_time": "0,5", "max_gap": " 5 "})
    assert preview(path, hints).to_dict()["grid_unit"] == "min"
    project = Project.from_toml(project_text(path, tmp_path / "pi.toml", hints), tmp_path)
    assert (project.data.sample_time, project.data.max_gap, project.time_unit) == (0.5, 5.0, "min")
    with pytest.raises(DataError, match="go together"):
        Hints.of({"max_gap": "5"})
    for wrong in ("often", "-1", "nan"):
        with pytest.raises(DataError, match="no length of time"):
            Hints.of({"sample_time": wrong})


def test_what_cannot_be_long_is_said(tmp_path: Path) -> None:
    path = german_csv(tmp_path / "export.csv")
    with pytest.raises(DataError, match="long export"):
        preview(path, Hints.of({"shape": "long"}))
    assert not preview(pi_export(tmp_path / "pi.txt"), Hints.of({"shape": "wide"})).seen.long


@pytest.mark.parametrize(
    ("make", "given"),
    [
        (german_csv, {}),
        (german_csv, {"separator": "semicolon"}),
        (german_csv, {"encoding": "cp1252", "time": "Zeitstempel", "shape": "wide"}),
        (german_csv, {"time_zone": "Europe/Berlin", "time_format": "dmy"}),
        (workbook, {"sheet": "Data"}),
        (pi_export, {"sample_time": "0,5", "max_gap": "5", "shape": "long"}),
    ],
)
def test_the_command_that_is_shown_writes_the_same_project(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[Path], Path], given: dict[str, str]
) -> None:
    path = make(tmp_path / f"a plant.{'xlsx' if make is workbook else 'csv'}")
    hints = Hints.of(given)
    shown = command(path.name, "a project.toml", hints)
    assert shown.startswith(f"trueplant init '{path.name}' --out 'a project.toml'")
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(shown)[1:]) == 0
    written = (tmp_path / "a project.toml").read_text(encoding="utf-8")
    assert written == project_text(path, tmp_path / "a project.toml", hints)


@pytest.mark.parametrize("wrong", ["zone=x", "time_zone", "time_zone=", "sample_time=often"])
def test_a_key_that_cannot_be_set_is_one_message(
    tmp_path: Path, wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = german_csv(tmp_path / "export.csv")
    assert main(["init", str(path), "--set", wrong]) == 2
    assert capsys.readouterr().err.count("trueplant:") == 1
    assert not (tmp_path / "export.toml").exists()


HISTORIAN = {
    "kind": "opcua",
    "url": "opc.tcp://hist:4840",
    "from": "2026-10-01T00:00:00+02:00",
    "to": "2026-10-08T00:00:00+02:00",
    "time_unit": "min",
    "sample_time": "0,5",
    "max_gap": "5",
    "loops": [{"name": "fic101", "pv": "FIC101.PV", "sp": "FIC101.SP", "op": "FIC101.OP", "mode": ""}, {"pv": ""}],
}


def test_a_historian_becomes_a_project() -> None:
    given = HISTORIAN | {"security": "sign and encrypt", "user": "reader", "password_env": "UA_PASSWORD"}
    text = source_text(given | {"certificate": "a.der", "private_key": "a.pem", "path": "not of this kind"})
    project = Project.from_toml(text)
    assert project.data.source is not None
    assert (project.data.source.password_env, project.data.source.path) == ("UA_PASSWORD", None)
    assert (project.data.sample_time, project.data.max_gap) == (0.5, 5.0)
    assert (project.outputs[0].sp, project.inputs[0].name, project.inputs[0].mode) == ("FIC101.SP", "fic101_op", None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"password_env": "hunter2!"}, "name of the variable"),
        ({"loops": []}, "at least one loop"),
        ({"loops": [{"pv": "a"}]}, "the OP of loop 1"),
        ({"from": "yesterday"}, "no moment"),
        ({"kind": "excel"}, "no kind of historian"),
        ({"sample_time": "often"}, "no number"),
    ],
)
def test_what_is_missing_of_a_historian_is_said(change: dict[str, object], message: str) -> None:
    with pytest.raises(ProjectError, match=message):
        source_text(HISTORIAN | change)


def test_a_password_in_an_address_is_refused() -> None:
    with pytest.raises(ProjectError, match="password"):
        Project.from_toml(source_text(HISTORIAN | {"kind": "postgresql", "url": "postgresql://a:b@h/d", "query": "q"}))
