"""Results on disk are whole, or not there."""

from __future__ import annotations

import pytest

import trueplant as tp
from trueplant import output
from trueplant.project import plant_project
from trueplant.result import Result

PLANT = """\
time_unit = "s"
[data]
files = ["record.csv"]
[[output]]
name = "y"
pv = "pv"
[[input]]
name = "u"
op = "op"
[simulate]
plant = "other.toml"
duration = 10
sample_time = 1
"""
RESULT = Result("refused", (), {}, (), ())


def test_check_of_the_folder_leaves_nothing_behind(tmp_path):
    assert output.prepare_output(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list(tmp_path.iterdir()) == []


def test_existing_folder_is_kept(tmp_path):
    (tmp_path / "a").mkdir()
    output.prepare_output(tmp_path / "a")
    assert list(tmp_path.iterdir()) == [tmp_path / "a"]


def test_file_in_the_way_is_named(tmp_path):
    (tmp_path / "f").write_text("x")
    for path in (tmp_path / "f", tmp_path / "f" / "below"):
        with pytest.raises(tp.OutputError, match=f"{tmp_path / 'f'} is a file"):
            output.prepare_output(path)
    assert (tmp_path / "f").read_text() == "x"


def test_place_that_cannot_be_written_is_named():
    with pytest.raises(tp.OutputError, match="cannot write to /proc/trueplant"):
        output.prepare_output("/proc/trueplant/out")


def test_results_of_an_earlier_analysis_do_not_stay(tmp_path):
    full = Result("ok", (), {}, (), (), plant_toml=PLANT)
    assert set(output.write_results(full, tmp_path, "<html>")) == {"result.json", "plant.toml", "report.html"}
    assert set(output.write_results(RESULT, tmp_path)) == {"result.json"}
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_paths_of_the_plant_hold_where_it_lies(tmp_path):
    full = Result("ok", (), {}, (), (), plant_toml=PLANT)
    written = output.write_results(full, tmp_path / "a" / "b", None, tmp_path / "project")
    plant = tp.Project.load(written["plant.toml"])
    assert plant.experiments[0].path.resolve() == (tmp_path / "project" / "record.csv").resolve()
    assert plant.simulate is not None
    assert plant.simulate.plant == "../../project/other.toml"


def test_comments_of_the_project_stand_in_the_plant(tmp_path):
    text = plant_project(
        tp.Project.from_toml(PLANT.replace('"record.csv"]', '"record.csv"] # of March'), tmp_path),
        {(0, 0): tp.tf("2/(s + 1)")},
    )
    written = output.write_results(Result("ok", (), {}, (), (), plant_toml=text), tmp_path / "out", None, tmp_path)
    assert 'files = ["../record.csv"] # of March\n' in written["plant.toml"].read_text()
    assert tp.Project.load(written["plant.toml"]).model_matrix().dc_gain.tolist() == [[2]]


def test_refusal_has_no_plant(tmp_path):
    refused = Result("refused", (), {}, (), (), plant_toml=PLANT)
    assert set(output.write_results(refused, tmp_path)) == {"result.json"}


def test_failure_leaves_the_old_files(tmp_path, monkeypatch):
    output.write_files(tmp_path, {"a": "old", "b": "old"})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(output.os, "fchmod", full)
    with pytest.raises(tp.OutputError, match="No space left"):
        output.write_files(tmp_path, {"a": "new", "b": "new"})
    assert sorted((p.name, p.read_text()) for p in tmp_path.iterdir()) == [("a", "old"), ("b", "old")]
