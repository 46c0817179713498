"""First models: nobody says what is there. All records are simulated; what made them stands beside each."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from support.simulated import coloured, random_switching
from trueplant import Project
from trueplant.errors import ProjectError
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix, tf
from trueplant.lti.structure import structure_of
from trueplant.output import write_results
from trueplant.result import ElementVerdict, Result, Status
from trueplant.study.pipeline import analyse
from trueplant.tracking.track import track

SAMPLES = 2000
TRIANGLE = [["1.5 exp(-2.3 s)/(9 s + 1)", "0"], ["0.6 exp(-4.6 s)/(12 s + 1)", "-2 exp(-3.4 s)/(15 s + 1)"]]
"""Column 2 does not act on row 1."""
PIS = Controller.diagonal([PID(Kc=0.9, Ti=9.0, sample_time=1.0), PID(Kc=-0.7, Ti=15.0, sample_time=1.0)])


def record(plant: list[list[str]], law: Controller, seed: int, moved: bool = True) -> pl.DataFrame:
    rng, n = np.random.default_rng(seed), len(plant)
    r = random_switching(rng, SAMPLES, n, 40.0) * moved
    v = coloured(rng, SAMPLES, n, [1, -0.8], [1], 0.1)
    done = simulate(TransferMatrix.of(plant, "min"), law, r, 1.0, v=v)
    columns = {"t": done.t}
    for k in range(n):
        columns |= {f"sp{k}": done.r[:, k], f"pv{k}": done.y[:, k], f"op{k}": done.u[:, k]}
    return pl.DataFrame(columns)


def project(n: int, **tables: object) -> Project:
    said = {
        "time_unit": "min",
        "data": {"files": ["record"], "time": "t"},
        "output": [{"name": f"y{k}", "pv": f"pv{k}", "sp": f"sp{k}"} for k in range(n)],
        "input": [{"name": f"u{k}", "op": f"op{k}", "actuator": "other"} for k in range(n)],
    }
    return Project(**{**said, **tables})


@pytest.fixture(scope="module")
def triangle() -> pl.DataFrame:
    return record(TRIANGLE, PIS, 1)


@pytest.fixture(scope="module")
def first(triangle: pl.DataFrame) -> Result:
    return analyse(project(2), frames=[triangle])


def at(result: Result, output: str, input_: str):
    return next(e for e in result.elements if (e.output, e.input) == (output, input_))


def test_what_is_there_is_found_and_covered(first: Result):
    assert first.status is Status.OK
    for i, row in enumerate(TRIANGLE):
        for j, formula in enumerate(row):
            if formula == "0":
                continue
            element = at(first, f"y{i}", f"u{j}")
            structure, values = structure_of(tf(formula))
            assert (element.verdict, element.structure) == (ElementVerdict.FOUND, str(structure))
            for name, value in zip(structure.names, values, strict=True):
                found = next(p for p in element.parameters if p.name == name)
                assert abs(found.plant - value) < 4 * found.std_error
                assert found.std_error < 0.1 * abs(value)


def test_what_is_not_there_is_not_found(first: Result):
    element = at(first, "y0", "u1")
    assert (element.verdict, element.parameters, element.tf_plant) == (ElementVerdict.NONE_FOUND, (), None)
    assert element.p_adjusted > 0.01


def test_nothing_is_compared_with_a_model_that_nobody_gave(first: Result):
    assert not first.mismatch
    assert {e.tf_model for e in first.elements} == {None}
    assert {e.tf_mismatch for e in first.elements} == {None}
    parameters = [p for e in first.elements for p in e.parameters]
    assert {(p.model, p.p_value, p.p_adjusted, p.changed, p.change_percent) for p in parameters} == {(None,) * 5}
    assert all(d.model is None for e in first.elements for d in e.derived)
    assert all(np.isnan(row.fit_percent_model) for row in first.fit)
    assert np.isnan(first.curves.step_model).all()


def test_the_headline_tells_the_model(first: Result):
    assert first.headline.startswith("First model found, 3 of 4 elements: u0 -> y0 has a gain of 1.")
    assert "changed" not in first.headline
    assert not [note for note in first.notes if re.search("model's structure|does not describe", note.message)]


def test_the_plant_found_is_the_model_of_the_next_run(triangle: pl.DataFrame, first: Result):
    found = project(2).with_model({place: first.plant.nominal[place] for place in ((0, 0), (1, 0), (1, 1))})
    assert not any(found.wanted(*place) for place in np.ndindex(2, 2))
    again = analyse(found, frames=[triangle])
    assert {(e.output, e.input): e.verdict for e in again.elements} == dict.fromkeys(
        [("y0", "u0"), ("y1", "u0"), ("y1", "u1")], ElementVerdict.UNCHANGED
    )


def test_the_file_of_the_plant_has_what_was_found_and_no_more(first: Result, tmp_path: Path):
    written = Project.load(write_results(first, project(2), tmp_path)["plant.toml"])
    assert [(e.output, e.input) for e in written.model] == [("y0", "u0"), ("y1", "u0"), ("y1", "u1")]


def test_one_element_may_be_looked_for_beside_a_model(triangle: pl.DataFrame):
    model = [
        {"output": "y0", "input": "u0", "tf": TRIANGLE[0][0]},
        {"output": "y1", "input": "u1", "tf": TRIANGLE[1][1]},
        {"output": "y1", "input": "u0", "structure": "auto"},
        {"output": "y0", "input": "u1", "structure": "auto"},
    ]
    result = analyse(project(2, model=model), frames=[triangle])
    verdicts = {(e.output, e.input): str(e.verdict) for e in result.elements}
    assert verdicts == {
        ("y0", "u0"): "unchanged",
        ("y0", "u1"): "none found",
        ("y1", "u0"): "found",
        ("y1", "u1"): "unchanged",
    }


def test_an_element_that_the_model_has_as_zero_has_changed(triangle: pl.DataFrame):
    """A zero that was declared is something that was said."""
    model = [
        {"output": "y0", "input": "u0", "tf": TRIANGLE[0][0]},
        {"output": "y1", "input": "u1", "tf": TRIANGLE[1][1]},
        {"output": "y1", "input": "u0", "tf": "0", "structure": "auto"},
    ]
    element = at(analyse(project(2, model=model), frames=[triangle]), "y1", "u0")
    assert (element.verdict, element.tf_model) == (ElementVerdict.CHANGED, "0")


LEVEL = [["0.05 exp(-4.3 s)/s"]]
LEVEL_PI = Controller.diagonal([PID(Kc=1.2, Ti=60.0, sample_time=1.0)])


@pytest.mark.parametrize("kind", [None, "level"])
def test_what_integrates_is_found_to_integrate(kind: str | None):
    outputs = [{"name": "y0", "pv": "pv0", "sp": "sp0"} | ({"kind": kind} if kind else {})]
    element = analyse(project(1, output=outputs), frames=[record(LEVEL, LEVEL_PI, 2)]).elements[0]
    assert (element.verdict, element.structure) == (ElementVerdict.FOUND, "integrator")
    slope = element.parameters[0]
    assert slope.ci[0] <= 0.05 <= slope.ci[1]


def test_a_level_that_comes_to_rest_is_not_taken_to_integrate():
    outputs = [{"name": "y0", "pv": "pv0", "sp": "sp0", "kind": "level"}]
    plant, law = [["1.5 exp(-2.3 s)/(9 s + 1)"]], Controller.diagonal([PID(Kc=0.9, Ti=9.0, sample_time=1.0)])
    element = analyse(project(1, output=outputs), frames=[record(plant, law, 3)]).elements[0]
    assert (element.verdict, element.structure) == (ElementVerdict.FOUND, "fopdt")


def test_no_move_no_model(triangle: pl.DataFrame):
    result = analyse(project(2), frames=[record(TRIANGLE, PIS, 4, moved=False)])
    assert result.status is Status.REFUSED
    assert {str(e.verdict) for e in result.elements} == {"not identifiable"}
    assert {e.tf_model for e in result.elements} == {None}


def test_a_loop_with_any_controller_may_be_looked_at():
    """Without a model there is nothing that the sign of a controller could contradict."""
    said = [{"input": "u0", "output": "y0", "Kc": 0.9, "Ti": 9.0, "sample_time": 1.0}]
    plant, law = [["1.5 exp(-2.3 s)/(9 s + 1)"]], Controller.diagonal([PID(Kc=0.9, Ti=9.0, sample_time=1.0)])
    result = analyse(project(1, controller=said), frames=[record(plant, law, 5)])
    assert result.robustness.margins.plant[0].stable
    assert not [note for note in result.notes if "unstable" in note.message]


def test_what_needs_a_model_says_so():
    with pytest.raises(ProjectError, match="track follows one.*trueplant run"):
        track(project(1), frames=[record(LEVEL, LEVEL_PI, 2)])
    with pytest.raises(ProjectError, match="simulate.plant.*needs a plant"):
        project(1, simulate={"duration": 100, "sample_time": 1, "seed": 0})
    with pytest.raises(ProjectError, match=r"model\[1\].tf.*is missing"):
        project(1, model=[{"output": "y0", "input": "u0"}])
    with pytest.raises(ProjectError, match=r"model\[1\].estimate.*give its tf"):
        project(1, model=[{"output": "y0", "input": "u0", "structure": "auto", "estimate": False}])
