"""Two saved results beside each other, as the command shows them."""

from __future__ import annotations

import json

import pytest

from support.command import refused
from support.saved import project, saved
from trueplant.cli import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in (("before", project()), ("again", project(seed=2)), ("after", project(gain=2.6))):
        saved(tmp_path / name, text)
    return tmp_path


def compared(capsys, *folders: str) -> dict:
    capsys.readouterr()
    assert main(["compare", *folders, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_two_records_of_one_plant_do_not_differ(folder, capsys):
    found = compared(capsys, "before/out", "again/out")
    assert found["independent"] is True
    assert [p["differs"] for p in found["elements"][0]["parameters"]] == [False, False, False]


def test_gain_that_changed_in_between_does(folder, capsys):
    found = compared(capsys, "before/out", "after/out")
    assert [p["differs"] for p in found["elements"][0]["parameters"]] == [True, False, False]
    assert found["elements"][0]["parameters"][0]["difference"] == pytest.approx(0.6, rel=0.05)
    assert found["elements"][0]["verdicts"] == ["unchanged", "changed"]
    assert main(["compare", "before/out", "after/out"]) == 0
    said = capsys.readouterr().out
    assert "gain +30 %" in said
    assert "unchanged, then changed" in said


def test_same_data_twice_is_noticed(folder, capsys):
    found = compared(capsys, "before/out", "before/out")
    assert found["independent"] is False
    assert all(p["p_value"] is None for p in found["elements"][0]["parameters"])


def test_other_names_are_one_message(folder, capsys):
    path = folder / "after" / "out" / "result.json"
    path.write_text(path.read_text().replace('"input": "u"', '"input": "valve"'))
    refused(["compare", "before/out", "after/out"], capsys, "no element in common", "valve -> y", "u -> y")


def test_folder_without_a_result_is_one_message(folder, capsys):
    refused(["compare", "before/out", "nowhere"], capsys, "nowhere", "result.json")
