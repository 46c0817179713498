"""A saved result drawn again: the same page, without the data."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from support.saved import project, saved
from trueplant import output
from trueplant.cli import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return saved(tmp_path, project())


def _said(capsys) -> str:
    return capsys.readouterr().out


def test_page_is_that_of_the_run_byte_for_byte(folder, capsys):
    page, document = Path("out/report.html").read_bytes(), Path("out/result.json").read_bytes()
    for name in ("record.csv", "project.toml", "out/report.html"):
        Path(name).unlink()
    _said(capsys)
    assert main(["report", "out"]) == 0
    assert "the same page as before" in _said(capsys)
    assert Path("out/report.html").read_bytes() == page
    assert Path("out/result.json").read_bytes() == document
    assert main(["report", "out/result.json", "--out", "other.html"]) == 0
    assert Path("other.html").read_bytes() == page


def test_thinned_trends_are_told_and_their_errors_left_out(folder, capsys, monkeypatch):
    monkeypatch.setattr(output, "MOST_SAMPLES", 100)
    assert main(["run", "project.toml", "--out", "out"]) == 0
    assert "prediction error (rms)" in Path("out/report.html").read_text()
    _said(capsys)
    assert main(["report", "out"]) == 0
    assert "of 601 samples, the extremes" in _said(capsys)
    page = Path("out/report.html").read_text()
    assert "of 601 samples, the extremes" in page
    assert "prediction error (rms)" not in page
    sums = json.loads(Path("out/result.json").read_text())["files"]
    assert sums["report.html"] == hashlib.sha256(page.encode()).hexdigest()
    curves = json.loads(Path("out/curves.json").read_text())
    assert np.size(curves["trends"][0]["t"]) <= 110
    assert main(["run", "project.toml", "--out", "out"]) == 0  # what was drawn again is known to have been


def test_missing_curves_are_told(folder, capsys):
    Path("out/curves.json").unlink()
    _said(capsys)
    assert main(["report", "out"]) == 0
    assert "curves.json is not there" in _said(capsys)


def test_foreign_pages_and_files_of_the_result_stay(folder, capsys):
    Path("out/report.html").write_text("my notes")
    assert main(["report", "out"]) == 2
    assert Path("out/report.html").read_text() == "my notes"
    plant = Path("out/plant.toml").read_text()
    assert main(["report", "out", "--out", "out/plant.toml", "--force"]) == 2
    assert Path("out/plant.toml").read_text() == plant
    assert main(["report", "out", "--force"]) == 0
    assert "<html" in Path("out/report.html").read_text()


def test_folder_without_a_result_is_one_message(folder, capsys):
    assert main(["report", "nowhere"]) == 2
    assert "holds no result.json" in capsys.readouterr().err


def test_sheet_for_the_shift_belongs_to_the_result_and_goes_with_it(folder, capsys):
    assert main(["report", "out", "--shift"]) == 0
    sums = json.loads(Path("out/result.json").read_text())["files"]
    assert sums["shift.html"] == hashlib.sha256(Path("out/shift.html").read_bytes()).hexdigest()
    _said(capsys)
    assert main(["report", "out", "--shift"]) == 0
    assert "the same page as before" in _said(capsys)
    assert main(["run", "project.toml", "--out", "out"]) == 0
    assert not Path("out/shift.html").exists()  # of an earlier analysis
