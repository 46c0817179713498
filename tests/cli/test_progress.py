"""Progress: each stage by its name, parts counted, compiling told; nothing of it in a pipe."""

from __future__ import annotations

from numba import njit

import trueplant as tp
from support.saved import project, saved
from trueplant.cli import main
from trueplant.compiled import compiling
from trueplant.study.check import check


def test_every_stage_of_a_run_is_told_in_order(tmp_path):
    said: list[str] = []
    tp.run(saved(tmp_path, project()) / "project.toml", progress=said.append)
    stages = [what for what in said if "%" not in what]
    assert stages == [
        "reading the data",
        "reading record.csv",
        "screening record.csv",
        "estimating y",
        "testing structures of y",
        "looking for valves that do not follow OP",
        "comparing methods",
        "margins and robustness of today's loops",
        "settings for the controllers",
        "planning moves that would tell more",
        "putting the result together",
    ]


def test_parts_of_a_stage_are_counted(tmp_path):
    said: list[str] = []
    saved(tmp_path, project())
    (tmp_path / "again.csv").write_bytes((saved(tmp_path / "again", project(seed=2)) / "record.csv").read_bytes())
    text = project().replace('files = ["record.csv"]', 'files = ["record.csv", "again.csv"]')
    check(tp.Project.from_toml(text, tmp_path), said.append)
    assert "reading record.csv, record 1 of 2" in said
    assert "screening again.csv, record 2 of 2" in said


def test_compiling_is_told_and_what_is_compiled_is_not():
    triple = njit(lambda x: 3 * x)
    told: list[bool] = []
    with compiling(told.append):
        assert triple(2.0) == 6.0
        assert told == [True, False]
        assert triple(3.0) == 9.0
    assert told == [True, False]
    assert njit(lambda x: 4 * x)(1.0) == 4.0
    assert told == [True, False]


def test_nothing_is_shown_in_a_pipe(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(saved(tmp_path, project()))
    capsys.readouterr()
    assert main(["run", "project.toml", "--out", "out"]) == 0
    assert capsys.readouterr().err == ""
