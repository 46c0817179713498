"""The plant found becomes the project's model: nothing else of the file changes, and nothing is lost."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path

import pytest

from support.command import refused
from support.saved import project, saved
from trueplant.cli import main
from trueplant.project.document import with_structures

CHANGED = project(gain=2.6)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return saved(tmp_path, CHANGED)


def accept(*arguments: str) -> int:
    return main(["accept", "out", "--project", "project.toml", *arguments])


def test_run_on_what_was_accepted_finds_no_change(folder):
    assert accept() == 0
    assert main(["run", "project.toml", "--out", "again"]) == 0
    elements = json.loads(Path("again/result.json").read_text())["elements"]
    assert [e["verdict"] for e in elements] == ["unchanged"]
    found = json.loads(Path("out/result.json").read_text())["elements"]
    for mine, theirs in zip(elements[0]["parameters"], found[0]["parameters"], strict=True):
        assert mine["model"] == pytest.approx(theirs["plant"], rel=1e-5)


def test_only_the_model_changes_and_the_old_line_stays_as_a_comment(folder):
    before = Path("project.toml").read_text()
    assert accept() == 0
    after = Path("project.toml").read_text()
    new = [line for line in after.splitlines() if line not in before.splitlines()]
    old = 'tf = "2 exp(-2 s)/(10 s + 1)"'
    assert len(new) == 2 and new[0].startswith("# until 20") and new[0].endswith(f"(trueplant accept out): {old}")
    assert new[1].startswith('tf = "2.6')
    assert after.replace(new[0] + "\n", "").replace(new[1], old) == before
    assert Path("project.toml.bak").read_text() == before


def test_copy_of_the_old_file_never_replaces_an_earlier_one(folder):
    Path("project.toml.bak").write_text("mine")
    assert accept() == 0
    assert Path("project.toml.bak").read_text() == "mine"
    assert Path("project.toml.bak2").read_text() == CHANGED


def test_marks_and_line_ends_stay(folder):
    text = CHANGED.replace("\n", "\r\n").encode("utf-8-sig")
    Path("project.toml").write_bytes(text)
    assert accept("--force") == 0
    after = Path("project.toml").read_bytes()
    assert after.startswith(b"\xef\xbb\xbf") and after.count(b"\n") == after.count(b"\r\n") == text.count(b"\r\n") + 1
    assert tomllib.loads(after.decode("utf-8-sig"))["model"][0]["tf"].startswith("2.6")


def test_changed_project_or_data_are_refused_unless_forced(folder, capsys):
    Path("project.toml").write_text(CHANGED + "\n# a word\n")
    refused(["accept", "out", "--project", "project.toml"], capsys, "project.toml has changed", "--force")
    Path("project.toml").write_text(CHANGED)
    Path("record.csv").write_text(Path("record.csv").read_text() + "999,0,0,0\n")
    refused(["accept", "out", "--project", "project.toml"], capsys, "record.csv has changed", "--force")
    Path("record.csv").unlink()
    refused(["accept", "out", "--project", "project.toml"], capsys, "record.csv is no longer there")
    assert accept("--force") == 0


def test_accepted_twice_is_refused(folder, capsys):
    assert accept() == 0
    refused(["accept", "out", "--project", "project.toml"], capsys, "project.toml has changed")


def test_nothing_is_accepted_where_nothing_changed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    saved(tmp_path, project())
    refused(["accept", "out", "--project", "project.toml", "--force"], capsys, "nothing has changed")


def test_nothing_is_accepted_of_a_refusal(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    saved(tmp_path, CHANGED)
    lines = Path("record.csv").read_text().splitlines(keepends=True)
    Path("record.csv").write_text("".join(lines[:12]))
    assert main(["run", "project.toml", "--out", "out", "--force"]) == 3
    capsys.readouterr()
    assert accept() == 3
    assert "is a refusal" in capsys.readouterr().err
    assert Path("project.toml").read_text() == CHANGED


def test_missing_project_is_asked_for(folder, capsys):
    document = json.loads(Path("out/result.json").read_text())
    document["provenance"]["project"] = "gone.toml"
    Path("out/result.json").write_text(json.dumps(document))
    refused(["accept", "out"], capsys, "gone.toml", "--project")


def test_coefficients_become_a_formula_and_stay_as_comments(folder):
    tf = 'tf = "2 exp(-2 s)/(10 s + 1)"\n'
    values = [f"{2 * (1 - math.exp(min(2 - 2 * k, 0) / 10)):.5f}" for k in range(1, 41)]
    steps = f"step = [{', '.join(values[:20])},\n  {', '.join(values[20:])}]  # of 2019\nsample_time = 2.0\n"
    Path("project.toml").write_text(CHANGED.replace(tf, steps))
    assert accept("--force") == 0
    text = Path("project.toml").read_text()
    model = tomllib.loads(text)["model"][0]
    assert set(model) == {"output", "input", "tf"} and model["tf"].startswith("2.6")
    assert text.count("# until ") == 3 and f"{values[-1]}]  # of 2019" in text


def test_first_models_become_model_tables(folder):
    text = CHANGED.replace('[[model]]\noutput = "y"\ninput = "u"\ntf = "2 exp(-2 s)/(10 s + 1)"\n', "")
    Path("project.toml").write_text(text)
    assert main(["run", "project.toml", "--out", "out"]) == 0
    assert accept() == 0
    after = Path("project.toml").read_text()
    assert after.startswith(text.rstrip())
    assert "# since 20" in after
    assert tomllib.loads(after)["model"][0]["tf"].startswith("2.6")
    assert main(["run", "project.toml", "--out", "again"]) == 0
    assert [e["verdict"] for e in json.loads(Path("again/result.json").read_text())["elements"]] == ["unchanged"]


def test_what_a_first_model_left_open_is_looked_for_on():
    text = with_structures('time_unit = "s"\n', {("y", "u2"): "auto"})
    assert tomllib.loads(text)["model"] == [{"output": "y", "input": "u2", "structure": "auto"}]


def test_rejected_structure_is_replaced_where_it_is_named():
    text = '[[model]]\noutput = "y"\ninput = "u"\ntf = "1/(s + 1)"\nstructure = "fopdt"  # by hand\n'
    assert with_structures(text, {("y", "u"): "sopdt"}) == text.replace('"fopdt"', '"sopdt"')
