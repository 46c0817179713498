"""An anonymised bundle gives the same answer, and says nothing of where it comes from."""

from __future__ import annotations

import csv
import json
import tomllib
import zipfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from support.command import refused
from support.saved import project, saved
from trueplant import Project, check
from trueplant.cli import main

SECRET = """\
# Distillation of the secret plant
time_unit = "s"
[data]
files = ["march line 4.csv"]
time = "Zeit"
time_zone = "Europe/Berlin"
exclude = [{from = 2024-03-31T03:02:00, to = 2024-03-31T03:02:30}]
[[output]]
name = "kerosene_end_point"
pv = "TIC-4711.PV"
sp = "TIC-4711.SP"
unit = "degF"
status = "TIC-4711.Q"
[[input]]
name = "secret_valve"  # do not tell
op = "TIC-4711.OP"
unit = "klb/h"
mode = "TIC-4711.MODE"
automatic_values = ["KASKADE"]
[[model]]
output = "kerosene_end_point"
input = "secret_valve"
tf = "2 exp(-2 s)/(10 s + 1)"
[[controller]]
input = "secret_valve"
output = "kerosene_end_point"
Kc = 0.8
Ti = 8.0
sample_time = 0.5
"""
WORDS = ("march", "4711", "kerosene", "secret", "degF", "klb", "KASKADE", "Berlin", "2024", "Zeit", "TIC", "Distil")


def stamped(folder: Path) -> None:
    """The record of a changed plant as a control system would export it, across a change of the clock."""
    saved(folder, project(gain=2.6))
    rows = list(csv.DictReader((folder / "record.csv").read_text().splitlines()))
    start = datetime(2024, 3, 31, 0, 58, tzinfo=UTC)
    lines = ["Zeit;TIC-4711.SP;TIC-4711.PV;TIC-4711.OP;TIC-4711.MODE;TIC-4711.Q;SECRET.PV"]
    for k, row in enumerate(rows):
        at = (start + timedelta(seconds=float(row["t"]))).astimezone(ZoneInfo("Europe/Berlin"))
        mode, quality = ("HAND" if 300 <= k < 320 else "KASKADE"), ("Bad" if k == 40 else "Good")
        stamp = at.strftime("%d.%m.%Y %H:%M:%S.%f")[:-3]
        pv = "I/O Timeout" if k == 60 else row["pv"]
        lines.append(f"{stamp};{row['sp']};{pv};{row['op']};{mode};{quality};7")
    (folder / "march line 4.csv").write_text("\n".join(lines) + "\n")
    (folder / "plant.toml").write_text(SECRET)


def elements(place: str) -> list[dict]:
    return json.loads(Path(place).read_text())["elements"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stamped(tmp_path)
    return tmp_path


def test_bundle_gives_the_same_answer_and_no_word_of_the_plant(folder):
    assert main(["run", "plant.toml", "--out", "own"]) == 0
    assert main(["bundle", "plant.toml", "--out", "help.zip"]) == 0
    with zipfile.ZipFile("help.zip") as archive:
        assert archive.namelist() == ["project.toml", "record1.csv"]
        texts = [archive.read(name).decode() for name in archive.namelist()]
        archive.extractall("unpacked")
    for word in WORDS:
        assert word.lower() not in texts[0].lower()
        if not word.isdigit():  # some of the numbers have these digits
            assert word.lower() not in texts[1].lower()
    assert texts[1].startswith("time,PV1,SP1,OP1,STATUS_PV1,MODE1\n2000-01-01T00:00:00,")
    assert texts[1].count("MAN") == 20

    assert main(["run", "unpacked/project.toml", "--out", "theirs"]) == 0
    for mine, other in zip(elements("own/result.json"), elements("theirs/result.json"), strict=True):
        assert mine["verdict"] == other["verdict"] == "changed"
        for p, q in zip(mine["parameters"], other["parameters"], strict=True):
            for key in ("plant", "std_error", "change_percent"):
                assert q[key] == pytest.approx(p[key], rel=1e-4)
            assert p["changed"] == q["changed"]
    own, theirs = (json.loads(Path(f"{name}/result.json").read_text())["data"][0] for name in ("own", "theirs"))
    assert theirs["samples"] == own["samples"]
    assert [e["from"] for e in theirs["excluded"]] == pytest.approx([e["from"] for e in own["excluded"]])
    assert theirs["start"] == "2000-01-01T00:00:00"


def test_original_names_stand_beside_never_inside(folder):
    assert main(["bundle", "plant.toml"]) == 0
    rows = list(csv.reader(Path("bundle-names.csv").read_text().splitlines()))
    assert ["output", "y1", "kerosene_end_point"] in rows
    assert ["column", "PV1", "TIC-4711.PV"] in rows
    assert ["time", "2000-01-01T00:00:00", "2024-03-31T00:58:00+00:00"] in rows


def test_excluded_stretch_is_shifted_with_the_record(folder):
    assert main(["bundle", "plant.toml"]) == 0
    with zipfile.ZipFile("bundle.zip") as archive:
        tables = tomllib.loads(archive.read("project.toml").decode())
    # 00:58 UTC is 01:58 before the change of the clock, and 03:02 comes four minutes later
    assert tables["data"]["exclude"] == [{"from": datetime(2000, 1, 1, 0, 4), "to": datetime(2000, 1, 1, 0, 4, 30)}]
    assert "simulate" not in tables


def test_coefficients_go_into_the_project(folder):
    Path("steps.csv").write_text("c\n" + "\n".join(f"{2 * (1 - 0.8**k)}" for k in range(40)) + "\n")
    Path("plant.toml").write_text(
        SECRET.replace('tf = "2 exp(-2 s)/(10 s + 1)"', 'step = "steps.csv"\ncolumn = "c"\nsample_time = 2.0')
    )
    assert main(["bundle", "plant.toml"]) == 0
    with zipfile.ZipFile("bundle.zip") as archive:
        model = tomllib.loads(archive.read("project.toml").decode())["model"][0]
    assert len(model["step"]) == 40
    assert model["sample_time"] == 2.0
    assert model["step"][1] == pytest.approx(0.4)


def test_numbers_keep_the_unit_of_the_data(folder):
    text = (
        project().replace('time_unit = "s"', 'time_unit = "min"').replace("2 exp(-2 s)/(10 s", "2 exp(-0.03 s)/(0.17 s")
    )
    text = text.replace("Ti = 8.0\nsample_time = 0.5", "Ti = 0.13")
    text = text[: text.index("[simulate]")].replace(
        'time = "t"', 'time = "t"\ntime_unit = "s"\nexclude = [{from = 200, to = 210}]'
    )
    Path("minutes.toml").write_text(text)
    assert main(["bundle", "minutes.toml"]) == 0
    with zipfile.ZipFile("bundle.zip") as archive:
        archive.extractall("unpacked")
    left_out = [
        [(e.start, e.end) for e in check(Project.load(place)).data[0].excluded]
        for place in ("minutes.toml", "unpacked/project.toml")
    ]
    assert any(start == pytest.approx(200 / 60, abs=0.01) for start, _ in left_out[0])
    for mine, other in zip(*left_out, strict=True):
        assert other == pytest.approx(mine)


def test_same_project_gives_the_same_bytes_and_nothing_is_overwritten(folder, capsys):
    assert main(["bundle", "plant.toml"]) == 0
    first = Path("bundle.zip").read_bytes()
    refused(["bundle", "plant.toml"], capsys, "bundle.zip", "--force")
    assert main(["bundle", "plant.toml", "--force"]) == 0
    assert Path("bundle.zip").read_bytes() == first
    refused(["bundle", "plant.toml", "--out", "bundle.tar"], capsys, ".zip")
    refused(["bundle", "gone.toml"], capsys, "gone.toml")
