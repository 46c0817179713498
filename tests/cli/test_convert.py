"""`trueplant convert`: models from one form to another and back, with what that costs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import control
import numpy as np
import polars as pl
import pytest

from support.command import PROJECT, refused
from trueplant.cli import main
from trueplant.lti import sampled_response, tf
from trueplant.project import levels

PLANT = [["12.8 exp(-s)/(16.7 s + 1)", "-18.9 exp(-3.4 s)/(21 s + 1)"], ["0", "0.04 exp(-2 s)/(s (3 s + 1))"]]
NAMES = (("top", "level"), ("reflux", "steam"))
HEAD = """\
time_unit = "min"
output = [{name = "top", pv = "pv1"}, {name = "level", pv = "pv2"}]
input = [{name = "reflux", op = "op1"}, {name = "steam", op = "op2"}]
"""
ELEMENTS = [(i, j) for i in range(2) for j in range(2) if PLANT[i][j] != "0"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    model = "".join(
        f'[[model]]\noutput = "{NAMES[0][i]}"\ninput = "{NAMES[1][j]}"\ntf = "{PLANT[i][j]}"\n' for i, j in ELEMENTS
    )
    (tmp_path / "plant.toml").write_text(HEAD + model)
    return tmp_path


def converted(line: str, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    status = main(["convert", *line.split()])
    out, err = capsys.readouterr()
    assert (status, err) == (0, ""), err
    return out


def column(i: int, j: int) -> str:
    return f"{NAMES[1][j]} -> {NAMES[0][i]}"


def said(out: str) -> dict[str, float]:
    """Element to error, in percent."""
    lines = re.findall(r"^(.+): (?:no difference|step responses differ by at most ([\d.e+-]+) %)", out, flags=re.M)
    return {name: float(error or 0) for name, error in lines}


@pytest.mark.parametrize(("kind", "ending"), [("step", "csv"), ("fir", "parquet")])
def test_there_and_back(folder: Path, capsys: pytest.CaptureFixture[str], kind: str, ending: str) -> None:
    out = converted(f"plant.toml --to {kind} --out there.{ending}", capsys)
    assert "level: step" in out and out.count("it integrates (ramp)") == 1
    frame = pl.read_csv("there.csv") if ending == "csv" else pl.read_parquet("there.parquet")
    assert frame.columns == ["t", *(column(i, j) for i, j in ELEMENTS)]
    assert frame["t"][-1] >= 7 * 21 + 3.4
    ramp = f"{column(1, 1)}"
    assert main(["convert", f"there.{ending}", "--to", "tf", "--kind", kind, "--ramp", ramp, "--out", "back.toml"]) == 0
    back = (folder / "back.toml").read_text()
    formulas = re.findall(r'output = "(\w+)"\ninput = "(\w+)"\ntf = "(.+)"', back)
    w = 1j * np.geomspace(0.01, 0.5, 20)
    for output, source, formula in formulas:
        exact = tf(PLANT[NAMES[0].index(output)][NAMES[1].index(source)])
        assert np.allclose(tf(formula)(w), exact(w), rtol=2e-3)
    assert len(formulas) == 3
    # and what was written is a model: the project takes it
    (folder / "again.toml").write_text(HEAD + back)
    assert converted("again.toml --to tf --out same.toml", capsys).count("no difference") == 3


SHORT = '[[model]]\noutput = "top"\ninput = "reflux"\ntf = "3.8 exp(-0.5 s)/(2.8 s + 1)"\n'
SLOW = '[[model]]\noutput = "level"\ninput = "steam"\ntf = "3.2 exp(-3 s)/(18 s + 1)"\n'


def test_a_short_dead_time_beside_a_slow_element_comes_through(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "both.toml").write_text(HEAD + SHORT + SLOW)
    out = converted("both.toml --to step", capsys)
    assert max(said(out).values()) < 100 * levels.CLOSE_CONVERSION and "--sample-time" not in out
    assert levels.COEFFICIENTS < pl.read_csv("both-step.csv").height <= levels.MOST_COEFFICIENTS
    converted("both-step.csv --to tf", capsys)
    assert re.findall('tf = "(.+)"', (folder / "both-step-tf.toml").read_text()) == [
        "3.8 exp(-0.5 s)/(2.8 s + 1)",
        "3.2 exp(-3 s)/(18 s + 1)",
    ]


def test_what_the_coefficients_are_too_far_apart_for_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "one.toml").write_text(HEAD + SHORT)
    out = converted("one.toml --to step --sample-time 2", capsys)
    assert said(out)[column(0, 0)] > 100 * levels.CLOSE_CONVERSION and re.search(r"at t = [\d.]+ min\n", out)
    assert out.endswith(
        "one-step.csv: 1 element; more coefficients come closer to the model: say a shorter --sample-time\n"
    )
    back = converted("one-step.csv --to tf", capsys)
    assert "min" not in back and back.endswith("one-step-tf.toml: 1 element\n")
    assert "e-" not in (folder / "one-step-tf.toml").read_text()  # no dead time that is rounding


def test_an_element_that_jumps_ends_the_search_for_a_sample_time(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "jump.toml").write_text(HEAD + SHORT.replace("exp(-0.5 s)/(", "exp(-0.513 s)(20 s + 1)/("))
    out = converted("jump.toml --to step", capsys)
    assert "say a shorter --sample-time" in out
    assert pl.read_csv("jump-step.csv").height <= levels.MOST_COEFFICIENTS + 1


def test_coefficients_and_errors_are_those_of_the_element(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    errors = said(converted("plant.toml --to step --sample-time 4 --out rough.csv", capsys))
    frame = pl.read_csv("rough.csv")
    for i, j in ELEMENTS:
        values = frame[column(i, j)].to_numpy()
        exact = sampled_response(tf(PLANT[i][j]), np.ones(values.size), 4.0)
        assert np.allclose(values, exact, atol=1e-12)
        fine = sampled_response(tf(PLANT[i][j]), np.ones(values.size * 80), 0.05)
        t = 0.05 * np.arange(fine.size)
        inside = t <= frame["t"][-1]
        apart = np.abs(fine - np.interp(t, frame["t"].to_numpy(), values))[inside]
        assert errors[column(i, j)] == pytest.approx(100 * apart.max() / np.abs(values).max(), rel=0.05)


def test_state_space_to_step_is_that_of_python_control(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    system = control.StateSpace([[-0.2, 0.1], [0, -0.05]], [[1.0], [0.5]], [[1.0, -2.0]], [[0.0]])
    matrices = {key: np.asarray(getattr(system, key)).tolist() for key in "ABCD"}
    (folder / "m.json").write_text(json.dumps(matrices | {"TimeUnit": "seconds", "InputName": "u", "OutputName": "y"}))
    assert " s\n" in converted("m.json --to step --sample-time 2", capsys)
    frame = pl.read_csv("m-step.csv")
    _, y = control.step_response(system, frame["t"].to_numpy())
    assert frame.columns == ["t", "u -> y"]
    assert np.allclose(frame["u -> y"].to_numpy(), y, atol=1e-6)


def test_coefficients_without_times_and_names(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = sampled_response(tf("2 exp(-3 s)/(10 s + 1)"), np.ones(41), 2.0)[1:]
    pl.DataFrame({"A": values}).write_csv("a.csv")
    out = converted("a.csv --to tf --sample-time 2 --structure sopdt", capsys)
    text = (folder / "a-tf.toml").read_text()
    assert 'output = "A"\ninput = "input"' in text and "input -> A: " in out


def test_a_model_that_no_formula_stands_for_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pl.DataFrame({"t": np.arange(40.0), "A": 1 + 0.9 * np.cos(np.pi * np.arange(40))}).write_csv("a.csv")
    out = converted("a.csv --to tf", capsys)
    assert said(out)["input -> A"] > 20 and "too much to stand for the model" in out


def test_what_was_read_and_what_others_wrote_stays(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    converted("plant.toml --to step --out s.csv", capsys)
    converted("plant.toml --to step --out s.csv", capsys)
    refused(["convert", "plant.toml", "--to", "step", "--sample-time", "3", "--out", "s.csv"], capsys, "--force")
    converted("plant.toml --to step --sample-time 3 --out s.csv --force", capsys)
    refused(["convert", "plant.toml", "--to", "tf", "--out", "plant.toml", "--force"], capsys, "is read by this run")
    (folder / "of.toml").write_text(HEAD + '[[model]]\noutput = "top"\ninput = "reflux"\nstep = "s.csv"\ntime = "t"\n')
    refused(["convert", "of.toml", "--to", "step", "--out", "s.csv", "--force"], capsys, "is read by this run")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing.csv", "--to", "tf"], ["nothing.csv does not exist"]),
        (["a.csv", "--to", "tf"], ["a.csv", "--sample-time"]),
        (["plant.toml", "--to", "tf", "--out", "x.csv"], ["must end in .toml"]),
        (["plant.toml", "--to", "step", "--out", "x.toml"], [".csv or .parquet"]),
        (["plant.toml", "--to", "what"], ["'what' is not one of"]),
        (["plant.toml"], ["--to"]),
        (["a.csv", "--to", "tf", "--sample-time", "1", "--ramp", "b"], ["no column 'b'"]),
        (["a.csv", "--to", "tf", "--sample-time", "1"], ["still moves", "--ramp"]),
        (["a.csv", "--to", "tf", "--sample-time", "1", "--ramp", "a", "--structure", "what"], ["unknown structure"]),
        (["plant.toml", "--to", "step", "--sample-time", "1e-8"], ["longer --sample-time"]),
        (["zero.toml", "--to", "step"], ["other than zero"]),
        (["unstable.toml", "--to", "step"], ["unstable"]),
    ],
)
def test_mistakes(folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]) -> None:
    pl.DataFrame({"a": np.arange(1.0, 30.0)}).write_csv("a.csv")
    (folder / "zero.toml").write_text(HEAD)
    (folder / "unstable.toml").write_text(
        HEAD + '[[model]]\noutput = "top"\ninput = "reflux"\ntf = "1/(s - 1)"\nestimate = false\n'
    )
    refused(["convert", *arguments], capsys, *words)


def test_the_project_of_a_record_is_converted_without_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "loop.toml").write_text(PROJECT)
    assert said(converted("loop.toml --to fir", capsys)).keys() == {"u -> y"}
    assert (folder / "loop-fir.csv").is_file()
