"""What a refuted estimate does to a result; the records are simulated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from support.forced import forced
from support.one_loop import declared, one_loop
from support.simulated import wood_berry
from support.two_loops import project, written
from trueplant import Project, Result
from trueplant.study import pipeline
from trueplant.study.plant.identified import Identified, identify

TF = "2 exp(-13.4 s)/(60 s + 1)"


def analysed(monkeypatch: pytest.MonkeyPatch, made: Project, wrong: Mapping[int, Mapping[int, float]]) -> Result:
    """The analysis, with estimates forced to wrong values: {output: {place in theta: value}}."""

    def misled(*given: object) -> Identified:
        found = identify(*given)
        estimates = {i: forced(one, wrong[i]) if i in wrong else one for i, one in found.estimates.items()}
        return replace(found, estimates=estimates)

    monkeypatch.setattr(pipeline, "identify", misled)
    return pipeline.analyse(made)


def test_an_estimate_that_predicts_worse_than_the_model_is_refused_with_its_reason(tmp_path: Path, monkeypatch):
    made = declared(tmp_path, one_loop(1, samples=1000), TF)
    result = analysed(monkeypatch, made, {0: {2: 120.6}})
    assert result.status == "refused"
    first, *others = result.reasons
    assert (first.code, first.where) == ("refuted", "y")
    assert first.message.startswith("the model predicts y in one.csv better than the estimate does (its prediction ")
    assert "data.exclude" in first.message
    assert [reason.code for reason in others] == ["not-identifiable"]
    (element,) = result.elements
    assert element.verdict == "not identifiable"
    assert element.p_adjusted is None
    assert element.tf_plant is None
    assert {p.plant for p in element.parameters} == {None}
    assert first.message in result.headline


def test_the_other_outputs_are_answered_all_the_same(tmp_path: Path, monkeypatch):
    written(tmp_path, "record.csv", wood_berry(1, 1500))
    result = analysed(monkeypatch, project(tmp_path), {0: {2: 12.6}})
    assert result.status == "ok"
    assert [(note.code, note.where) for note in result.notes if note.code == "refuted"] == [("refuted", "top")]
    for e in result.elements:
        assert (e.verdict == "not identifiable") == (e.output == "top")
        assert {p.plant is None for p in e.parameters} == {e.output == "top"}
    assert not any("cause" in note.code and "top" in note.where for note in result.notes)


def test_a_right_estimate_passes(tmp_path: Path, monkeypatch):
    result = analysed(monkeypatch, declared(tmp_path, one_loop(2, samples=1000), TF), {})
    assert result.status == "ok"
    assert "refuted" not in {note.code for note in result.notes}
