"""A model is the same in each of its formats, and what is wrong with a file is said in one message."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import numpy as np
import polars as pl
import pytest
from scipy.signal import cont2discrete

from trueplant import Project, ProjectError
from trueplant.lti import MeasuredStep, TransferMatrix, from_control, tf
from trueplant.project import plant_project
from trueplant.project.simulation import simulate_record

OUTPUTS, INPUTS = ("top", "bottom"), ("reflux", "steam")
FORMULAS = [
    ["12.8 exp(-1.4 s)/(16.7 s + 1)", "-18.9 exp(-3 s)/(21 s + 1)"],
    ["6.6 exp(-7 s)/(10.9 s + 1)", "-0.4 exp(-3.3 s)/(s (14.4 s + 1))"],
]
PLANT = TransferMatrix.of(FORMULAS)
SIGNALS: dict[str, Any] = {
    "time_unit": "min",
    "output": [
        {"name": "top", "pv": "pv1", "sp": "sp1", "span": [0, 50]},
        {"name": "bottom", "pv": "pv2", "sp": "sp2"},
    ],
    "input": [{"name": "reflux", "op": "op1", "span": [0, 200]}, {"name": "steam", "op": "op2"}],
}
PLACES = [(i, j) for i in range(2) for j in range(2)]
W = np.geomspace(0.01, 1, 20)


def coefficients(h: float, count: int) -> dict[str, np.ndarray]:
    """Column to the response from one sample after the step."""
    return {f"{INPUTS[j]} -> {OUTPUTS[i]}": MeasuredStep.of_system(PLANT[i, j], h, count).values[1:] for i, j in PLACES}


def project(folder: Path, element: Callable[[int, int], dict[str, Any]]) -> Project:
    model = [{"output": OUTPUTS[i], "input": INPUTS[j], **element(i, j)} for i, j in PLACES]
    return Project.from_toml(Project(**SIGNALS).to_toml() + toml(model), folder)


def toml(model: list[dict[str, Any]]) -> str:
    """Entries of [[model]] as text, without a look at them."""
    return "".join("\n[[model]]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in one.items()) for one in model)


def one(folder: Path, **element: Any) -> Project:
    """One element, from steam to top."""
    text = Project(**SIGNALS).to_toml() + toml([{"output": "top", "input": "steam", **element}])
    return Project.from_toml(text, folder)


def is_the_plant(made: Project, rtol: float = 1e-3) -> None:
    assert np.allclose(made.model_matrix()(1j * W), PLANT(1j * W), rtol=rtol)


# -- step and impulse responses ------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_step_coefficients(tmp_path: Path, ending: str) -> None:
    frame = pl.DataFrame(coefficients(1.5, 90))
    frame.write_csv(tmp_path / "steps.csv") if ending == "csv" else frame.write_parquet(tmp_path / "steps.parquet")
    file = f"steps.{ending}"
    made = project(tmp_path, lambda i, j: {"step": file, "sample_time": 1.5, "ramp": (i, j) == (1, 1)})
    is_the_plant(made)
    assert all(model.error < 0.005 for model in made.models.values())
    assert made.files[1:] == (tmp_path / file,)


def test_impulse_response_with_a_column_of_times_and_columns_by_name(tmp_path: Path) -> None:
    steps = coefficients(2.0, 80)
    firs = {f"m{k}": np.concatenate([[0.0], np.diff(s, prepend=0.0)]) for k, s in enumerate(steps.values())}
    pl.DataFrame({"t/min": np.arange(81) * 2.0, **firs}).write_csv(tmp_path / "fir.csv")

    def element(i: int, j: int) -> dict[str, Any]:
        said = {"step": "fir.csv", "kind": "fir", "time": "t/min", "column": f"m{2 * i + j}"}
        return said | ({"ramp": True} if (i, j) == (1, 1) else {})

    is_the_plant(project(tmp_path, element))


def test_declared_coefficients_stay_beside_what_stands_for_them(tmp_path: Path) -> None:
    rough = coefficients(3.0, 40)["steam -> top"] + 0.2 * np.random.default_rng(1).standard_normal(40)
    pl.DataFrame({"a": rough}).write_csv(tmp_path / "rough.csv")
    found = one(tmp_path, step="rough.csv", sample_time=3.0).models["top", "steam"]
    assert found.measured is not None
    assert np.allclose(found.measured.values[1:], rough)
    apart = np.abs(found.measured.values - MeasuredStep.of_system(found.system, 3.0, 40).values)
    assert found.error == pytest.approx(np.max(apart) / np.max(np.abs(rough)), rel=0.05)
    assert found.at == pytest.approx(3.0 * np.argmax(apart))


def test_the_structure_asked_for_is_the_one_fitted(tmp_path: Path) -> None:
    inverse = MeasuredStep.of_system(tf("3 (-1 s + 1)/((10 s + 1)(6 s + 1))"), 2.0, 60).values[1:]
    pl.DataFrame({"a": inverse}).write_csv(tmp_path / "a.csv")
    free = one(tmp_path, step="a.csv", sample_time=2.0).models["top", "steam"]
    held = one(tmp_path, step="a.csv", sample_time=2.0, structure="fopdt").models["top", "steam"]
    assert len(held.system.terms[0].den) == 2 and len(free.system.terms[0].den) == 3
    assert free.error < 1e-3 < held.error


def test_gains_in_percent_of_span(tmp_path: Path) -> None:
    steps = coefficients(1.5, 90)["reflux -> top"] * 200 / 50
    pl.DataFrame({"a": steps}).write_csv(tmp_path / "percent.csv")
    for said in (
        {"step": "percent.csv", "sample_time": 1.5},
        {"tf": "51.2 exp(-1.4 s)/(16.7 s + 1)"},
    ):
        text = Project(**SIGNALS).to_toml()
        text += toml([{"output": "top", "input": "reflux", "gain_unit": "percent of span", **said}])
        made = Project.from_toml(text, tmp_path)
        assert np.allclose(made.model_matrix()[0, 0](1j * W), PLANT[0, 0](1j * W), rtol=1e-3)


# -- state space and fractions -------------------------------------------------------------------------------------


def rational() -> control.StateSpace:
    """The plant without its dead times."""
    num = [[[12.8], [-18.9]], [[6.6], [-0.4]]]
    den = [[[16.7, 1], [21, 1]], [[10.9, 1], [14.4, 1, 0]]]
    A = np.diag([-1 / 16.7, -1 / 21, -1 / 10.9, 0.0, -1 / 14.4])
    B = np.array([[1.0, 0], [0, 1], [1, 0], [0, 1], [0, 1]])
    C = np.array([[12.8 / 16.7, -18.9 / 21, 0, 0, 0], [0, 0, 6.6 / 10.9, -0.4, 0.4]])
    system = control.StateSpace(A, B, C, np.zeros((2, 2)))
    oracle = control.TransferFunction(num, den)
    assert np.allclose(system(0.3j), oracle(0.3j))
    return system


def states(**more: Any) -> dict[str, Any]:
    system = rational()
    return {key: np.asarray(getattr(system, key)).tolist() for key in "ABCD"} | more


DELAYS = [[1.4, 3.0], [7.0, 3.3]]


def test_state_space(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text(json.dumps(states(delays=DELAYS)))
    made = project(tmp_path, lambda i, j: {"state_space": "m.json"})
    is_the_plant(made, 1e-9)
    assert np.allclose(made.model_matrix()(1j * W), from_control(rational(), DELAYS)(1j * W))
    assert made.models["top", "steam"].measured is None


def test_delays_of_inputs_and_outputs_add_up(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text(json.dumps(states(InputDelay=[[1.0], [2.0]], OutputDelay=[0.5, 0])))
    matrix = project(tmp_path, lambda i, j: {"state_space": "m.json"}).model_matrix()
    late = [[matrix[i, j].terms[0].dead_time for j in range(2)] for i in range(2)]
    assert np.allclose(late, [[1.5, 2.5], [1.0, 2.0]])


def test_names_in_the_file_say_which_is_which(tmp_path: Path) -> None:
    said = states(delays=DELAYS, output_names=["top", "bottom"], input_names=["reflux", "steam"])
    swapped = said | {
        "C": said["C"][::-1],
        "output_names": ["bottom", "top"],
        "delays": DELAYS[::-1],
    }
    (tmp_path / "m.json").write_text(json.dumps(swapped))
    is_the_plant(project(tmp_path, lambda i, j: {"state_space": "m.json"}), 1e-9)


def test_times_in_the_unit_that_the_file_says(tmp_path: Path) -> None:
    """MATLAB's seconds in a project in minutes."""
    said = states()
    said["A"], said["B"] = (np.array(said[key]) / 60 for key in "AB")
    said["A"], said["B"] = said["A"].tolist(), said["B"].tolist()
    said |= {"TimeUnit": "seconds", "delays": (60 * np.array(DELAYS)).tolist(), "Ts": 0}
    (tmp_path / "m.json").write_text(json.dumps(said))
    is_the_plant(project(tmp_path, lambda i, j: {"state_space": "m.json"}), 1e-9)


@pytest.mark.parametrize("unit", ["min", "s"])
def test_discrete_state_space(tmp_path: Path, unit: str) -> None:
    """Sampled by scipy, with dead times of whole samples."""
    h, system = 0.5, rational()
    A, B, C, D, _ = cont2discrete((system.A, system.B, system.C, system.D), h)
    said = {"A": A.tolist(), "B": B.tolist(), "C": C.tolist(), "D": D.tolist(), "TimeUnit": unit}
    said |= {"Ts": h * (60 if unit == "s" else 1), "delays": [[2, 6], [14, 6]]}
    (tmp_path / "m.json").write_text(json.dumps(said))
    made = project(tmp_path, lambda i, j: {"state_space": "m.json"})
    exact = TransferMatrix.of([[f.replace("1.4 s)/", "1 s)/").replace("3.3", "3") for f in row] for row in FORMULAS])
    assert np.allclose(made.model_matrix()(1j * W), exact(1j * W), rtol=1e-3)
    assert made.models["top", "reflux"].measured is not None


def test_vectors_without_their_shape_as_matlab_writes_them(tmp_path: Path) -> None:
    """jsonencode makes a plain list of rows and of columns, and a number of a matrix of one."""
    for said, formula in (
        ({"A": -0.1, "B": 1, "C": 0.2, "D": 0, "Ts": 0, "InputDelay": 3}, "2 exp(-3 s)/(10 s + 1)"),
        ({"A": [[-0.1, 0], [0, -0.5]], "B": [1, 1], "C": [0.2, 1.5], "D": 0, "E": []}, "2/(10 s + 1) + 3/(2 s + 1)"),
        ({"Numerator": [2], "Denominator": [10, 1], "IODelay": 3, "Variable": "s"}, "2 exp(-3 s)/(10 s + 1)"),
        ({"Numerator": [[[0, 2]]], "Denominator": [[[10, 1]]], "IODelay": 3}, "2 exp(-3 s)/(10 s + 1)"),
    ):
        (tmp_path / "m.json").write_text(json.dumps(said | {"TimeUnit": "minutes", "InputName": [""]}))
        made = one(tmp_path, state_space="m.json").model_matrix()[0, 1]
        assert np.allclose(made(1j * W), tf(formula)(1j * W))


def test_discrete_fractions(tmp_path: Path) -> None:
    num, den, _ = cont2discrete(([2.0], [10.0, 1.0]), 0.5)
    said = {"num": [num.ravel().tolist()], "den": [den.tolist()], "sample_time": 0.5, "delays": 6}
    (tmp_path / "m.json").write_text(json.dumps(said))
    made = one(tmp_path, state_space="m.json").model_matrix()[0, 1]
    assert np.allclose(made(1j * W), tf("2 exp(-3 s)/(10 s + 1)")(1j * W), rtol=1e-3)


# -- what else a project does with them ----------------------------------------------------------------------------


def test_plant_toml_gets_the_plant_as_a_formula(tmp_path: Path) -> None:
    pl.DataFrame(coefficients(1.5, 90)).write_csv(tmp_path / "steps.csv")
    made = one(tmp_path, step="steps.csv", sample_time=1.5)
    assert made.model_matrix()[1, 0].is_zero
    (tmp_path / "out").mkdir()
    text = plant_project(made, {(0, 1): tf("-20 exp(-3 s)/(21 s + 1)")}, tmp_path / "out")
    assert "steps.csv" not in text and "sample_time" not in text
    again = Project.from_toml(text, tmp_path / "out")
    assert again.model[0].tf == "-20 exp(-3 s)/(21 s + 1)"
    kept = Project.from_toml(made.to_toml(tmp_path / "out"), tmp_path / "out")
    assert kept.model[0].step == "../steps.csv"
    assert np.allclose(kept.model_matrix()[0, 1](1j * W), made.model_matrix()[0, 1](1j * W))


def test_simulated_plants_may_be_coefficients(tmp_path: Path) -> None:
    pl.DataFrame(coefficients(1.5, 90)).write_csv(tmp_path / "steps.csv")
    text = Project(
        **SIGNALS, controller=[{"input": "reflux", "output": "top", "Kc": 0.2, "Ti": 10.0, "sample_time": 1.0}]
    ).to_toml()
    text += "\n[simulate]\nduration = 100\nsample_time = 1.0\nsetpoints = [{time = 5, output = 'top', value = 1}]\n"
    of = "\n[[simulate.plant]]\noutput = 'top'\ninput = 'reflux'\n"
    records = [
        simulate_record(Project.from_toml(text + of + said, tmp_path))
        for said in ("step = 'steps.csv'\nsample_time = 1.5\n", f"tf = '{FORMULAS[0][0]}'\n")
    ]
    assert np.allclose(records[0]["pv1"], records[1]["pv1"], atol=1e-4) and records[0]["pv1"].max() > 0.5


# -- mistakes ------------------------------------------------------------------------------------------------------

GOOD = list(MeasuredStep.of_system(tf("2 exp(-3 s)/(10 s + 1)"), 2.0, 40).values[1:])
STABLE = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]]}
MISTAKES = {
    "no form": ({}, None, "tf: is missing"),
    "two forms": ({"tf": "1", "step": "a.csv", "sample_time": 1.0}, GOOD, "step: says what tf says"),
    "no times": ({"step": "a.csv"}, GOOD, "sample_time"),
    "two times": ({"step": "a.csv", "sample_time": 1.0, "time": "t"}, GOOD, "the same in two ways"),
    "key of another form": ({"tf": "1", "ramp": True}, None, "ramp: belongs to step"),
    "no file": ({"step": "b.csv", "sample_time": 1.0}, GOOD, "b.csv does not exist"),
    "no column": ({"step": "a.csv", "sample_time": 1.0, "column": "x"}, GOOD, "no column 'x'. It has: a"),
    "empty": ({"step": "a.csv", "sample_time": 2.0}, [*GOOD[:3], None, *GOOD[4:]], "line 5 is empty"),
    "word": ({"step": "a.csv", "sample_time": 2.0}, [*map(str, GOOD[:9]), "bad"], "line 11: column 'a' holds 'bad'"),
    "few": ({"step": "a.csv", "sample_time": 2.0}, GOOD[:6], "6 coefficients"),
    "cut off": ({"step": "a.csv", "sample_time": 2.0}, GOOD[:8], "still moves at its last coefficient"),
    "no ramp": ({"step": "a.csv", "sample_time": 2.0, "ramp": True}, GOOD, "comes to rest"),
    "an impulse response": (
        {"step": "a.csv", "sample_time": 2.0},
        list(np.diff(GOOD, prepend=0.0)),
        "ends where it began: if the coefficients are those of an impulse response",
    ),
    "step coefficients as impulse response": ({"step": GOOD, "sample_time": 2.0, "kind": "fir"}, None, "still moves"),
    "list with a column": ({"step": GOOD, "sample_time": 2.0, "column": "a"}, None, "column: belongs to a file"),
    "no response": (
        {"step": "a.csv", "sample_time": 2.0},
        [1 + 0.9 * (-1.0) ** k for k in range(40)],
        "no transfer function stands for a.csv",
    ),
    "no span": (
        {"tf": "1/(s + 1)", "gain_unit": "percent of span"},
        None,
        'add span = [low, high] to the input "steam"',
    ),
    "no system": ({"state_space": "m.json"}, None, "m.json does not exist"),
    "no JSON": ({"state_space": "m.json"}, "A = 1", "m.json is not JSON"),
    "no object": ({"state_space": "m.json"}, "[1]", "one object"),
    "no matrix": ({"state_space": "m.json"}, {k: STABLE[k] for k in "ABD"}, "C is missing"),
    "shape": ({"state_space": "m.json"}, STABLE | {"B": [[1.0, 2.0, 3.0]], "D": [[0.0, 0.0]]}, "D must be 1 by 3"),
    "square": ({"state_space": "m.json"}, STABLE | {"A": [[1.0, 2.0]]}, "A must be square"),
    "A as a list": (
        {"state_space": "m.json"},
        {"A": [-1, 0, 0, -2], "B": [1, 1], "C": [1, 1], "D": 0},
        "A must be square",
    ),
    "ragged": ({"state_space": "m.json"}, STABLE | {"A": [[1.0, 2.0], [1.0]]}, "A must be numbers, in rows"),
    "not finite": ({"state_space": "m.json"}, '{"A": NaN, "B": 1, "C": 1, "D": 0}', "A holds what is no finite"),
    "unstable": ({"state_space": "m.json"}, STABLE | {"A": [[1.0]]}, "unstable in open loop"),
    "unstable, discrete": ({"state_space": "m.json"}, STABLE | {"A": 1.2, "Ts": 1}, "is unstable"),
    "slow": ({"state_space": "m.json"}, STABLE | {"A": 0.9999999, "Ts": 1}, "samples to settle"),
    "inner delay": ({"state_space": "m.json"}, STABLE | {"InternalDelay": [2]}, "InternalDelay"),
    "descriptor": ({"state_space": "m.json"}, STABLE | {"E": [[2.0]]}, "descriptor"),
    "half a sample": (
        {"state_space": "m.json"},
        {"A": 0.9, "B": 1, "C": 1, "D": 0, "Ts": 2, "InputDelay": 1.5},
        "whole samples",
    ),
    "negative delay": ({"state_space": "m.json"}, STABLE | {"InputDelay": -1}, "dead times"),
    "sample time left open": ({"state_space": "m.json"}, STABLE | {"Ts": -1}, "sample_time: -1"),
    "unit": ({"state_space": "m.json"}, STABLE | {"TimeUnit": "fortnights"}, "'fortnights' is not known"),
    "improper": ({"state_space": "m.json"}, {"num": [1, 2, 3], "den": [1, 1]}, "improper"),
    "no den": ({"state_space": "m.json"}, {"num": [1]}, "den is missing"),
    "zero den": ({"state_space": "m.json"}, {"num": [1], "den": [0]}, "division by zero"),
    "which element": ({"state_space": "m.json"}, {"num": [[1], [2], [3], [4]], "den": [[1, 1]] * 4}, "which element"),
    "too many outputs": (
        {"state_space": "m.json"},
        {"A": -1, "B": 1, "C": [[1], [1], [1]], "D": [[0], [0], [0]]},
        "3 outputs and 1 inputs",
    ),
    "names": (
        {"state_space": "m.json"},
        STABLE | {"InputName": "u", "OutputName": "top"},
        'names no "steam"',
    ),
    "names twice": ({"state_space": "m.json"}, STABLE | {"InputName": ["u", "v"]}, "input_names must be 1"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_each_mistake_is_one_message_with_line_and_key(tmp_path: Path, name: str) -> None:
    element, content, said = MISTAKES[name]
    if isinstance(content, list):
        pl.DataFrame({"a": content}).write_csv(tmp_path / "a.csv")
    elif content is not None:
        (tmp_path / "m.json").write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ProjectError) as found:
        one(tmp_path, **element)
    message = str(found.value)
    assert said in message, message
    assert "project.toml, line " in message and ": model[1]." in message and "\n" not in message, message


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (np.arange(5, 45) * 2.0, "begin at 10"),
        (np.concatenate([np.arange(20), np.arange(21, 41)]) * 2.0, "line 22: the times in 't' are not even"),
        (np.zeros(40), "not even"),
    ],
)
def test_times_of_coefficients(tmp_path: Path, times: np.ndarray, said: str) -> None:
    pl.DataFrame({"t": times, "a": GOOD}).write_csv(tmp_path / "a.csv")
    with pytest.raises(ProjectError, match=said):
        one(tmp_path, step="a.csv", time="t")


def test_several_columns_need_a_name(tmp_path: Path) -> None:
    pl.DataFrame({"a": GOOD, "b": GOOD}).write_csv(tmp_path / "a.csv")
    with pytest.raises(ProjectError, match='none is called "steam -> top": say column'):
        one(tmp_path, step="a.csv", sample_time=2.0)
