"""From a frame to verdict, figures and settings, and back from a folder."""

from __future__ import annotations

import json
from dataclasses import replace

import control
import numpy as np
import pandas as pd
import polars as pl
import pytest
from jsonschema import Draft202012Validator

import trueplant as tp
from trueplant.loop import Controller, alternating_steps, simulate
from trueplant.lti import MeasuredStep, from_control
from trueplant.notebook.loops import project_of
from trueplant.output import as_json
from trueplant.result.schema import published

PLANT = tp.TransferMatrix.of(
    [["2.6 exp(-3 s)/(9 s + 1)", "0.5 exp(-4 s)/(12 s + 1)"], ["0", "-1.2 exp(-2 s)/(6 s + 1)"]], "min"
)
MODEL = {
    ("TIC101", "TIC101"): "2 exp(-3 s)/(10 s + 1)",
    ("TIC101", "FIC7"): "0.5 exp(-4 s)/(12 s + 1)",
    ("FIC7", "FIC7"): "-1.2 exp(-2 s)/(6 s + 1)",
}
LAWS = (tp.PID(Kc=0.6, Ti=9.0, sample_time=0.5), tp.PID(Kc=-0.5, Ti=6.0, sample_time=0.5))
LOOPS = [
    tp.Loop("TIC101", pv="t.pv", sp="t.sp", op="t.op", unit="degC", op_unit="%", controller=LAWS[0]),
    tp.Loop("FIC7", pv="f.pv", sp="f.sp", op="f.op", unit="t/h", op_unit="%", controller=LAWS[1]),
]


def simulated(seed: int = 1, samples: int = 1600) -> pl.DataFrame:
    """A simulated record of both loops, their set-points moved at different times."""
    r = alternating_steps(samples, 0.5, 70.0, [2.0, 1.0])
    r[:, 1] = np.roll(r[:, 1], samples // 7)
    done = simulate(PLANT, Controller.diagonal(LAWS), r, 0.5, noise=0.05, seed=seed)
    columns = {"t": done.t}
    for k, name in enumerate("tf"):
        columns |= {f"{name}.sp": done.r[:, k], f"{name}.op": done.u[:, k], f"{name}.pv": done.y[:, k]}
    return pl.DataFrame(columns)


@pytest.fixture(scope="module")
def analysis() -> tp.Analysis:
    return tp.run(simulated(), loops=LOOPS, model=MODEL, tuning={"methods": ["certain-share", "simc"]})


def test_the_change_is_found_by_the_names_of_the_loops(analysis):
    assert analysis.status == "ok" and analysis.mismatch
    changed = analysis.elements["TIC101", "TIC101"]
    assert changed.verdict == "changed"
    gain = changed.parameters[0]
    assert gain.plant == pytest.approx(2.6, abs=4 * gain.std_error)
    assert analysis.elements["FIC7", "FIC7 OP"].verdict == "unchanged"
    with pytest.raises(KeyError, match="no element"):
        analysis.elements["FIC7", "nowhere"]
    assert repr(analysis).startswith("Analysis(ok: The plant has changed: TIC101 OP -> TIC101")
    assert "<table>" in analysis._repr_html_()


def test_parameters_are_a_frame(analysis):
    frame = analysis.parameters
    row = frame.row(by_predicate=(pl.col("output") == "FIC7") & (pl.col("parameter") == "gain"), named=True)
    assert row["model"] == -1.2 and row["low"] < row["plant"] < row["high"] and not row["changed"]
    assert frame.height == sum(len(e.parameters) for e in analysis.elements)


def test_settings_are_those_of_the_recommended_proposals(analysis):
    frame = analysis.settings
    loop = analysis.controllers[0]
    assert loop.chosen is not None and loop.chosen.settings is not None
    row = frame.row(by_predicate=(pl.col("output") == "TIC101") & (pl.col("key") == "Kc"), named=True)
    assert row["new"] == loop.chosen.settings.Kc and row["now"] == 0.6


def test_figures_show_every_element(analysis):
    steps, bode, trends = analysis.plot_steps(), analysis.plot_bode(), analysis.plot_trends()
    titles = {note.text for note in steps.layout.annotations}
    assert {"TIC101 OP → TIC101", "FIC7 OP → FIC7"} <= titles
    drawn = next(t for t in steps.data if t.name == "plant")
    whole = analysis.result.curves.step_plant[:, 0, 0]
    np.testing.assert_allclose(drawn.y, whole[: len(drawn.y)])
    # what is not drawn is at rest
    assert np.ptp(whole[len(drawn.y) :]) < 0.02 * np.ptp(whole)
    assert sum(t.name == "model" for t in bode.data) == 6  # magnitude and phase of three elements
    assert len({t.yaxis for t in trends.data}) == 4
    retuned = analysis.plot_retuning()
    assert sum(t.name == "after" for t in retuned.data) == 8  # PV and OP, set-point and load, of two loops
    shown = [t.name for t in retuned.data if t.showlegend]
    assert len(shown) == len(set(shown))


def test_a_saved_analysis_is_drawn_and_reported_without_its_data(analysis, tmp_path):
    written = analysis.save(tmp_path / "out")
    assert set(written) == {"result.json", "curves.json", "plant.toml", "report.html"}
    again = tp.load(tmp_path / "out")
    assert again.to_dict() == analysis.to_dict()
    assert again.plant is not None and analysis.plant is not None
    np.testing.assert_allclose(again.plant.nominal(0.1j), analysis.plant.nominal(0.1j))
    for one, other in zip(again.plot_steps().data, analysis.plot_steps().data, strict=True):
        np.testing.assert_allclose(one.y, other.y)
    assert again.report().count("<figure") == analysis.report().count("<figure")


def test_only_what_was_saved_before_is_saved_over(analysis, tmp_path):
    analysis.save(tmp_path)
    assert set(analysis.save(tmp_path)) == {"result.json", "curves.json", "plant.toml", "report.html"}
    mine = tmp_path / "plant.toml"
    mine.write_text("# as agreed with operations\n")
    before = {place.name: place.read_bytes() for place in tmp_path.iterdir()}
    with pytest.raises(tp.OutputError, match=r"plant.toml is there already, and no earlier run wrote it"):
        analysis.save(tmp_path)
    assert {place.name: place.read_bytes() for place in tmp_path.iterdir()} == before
    analysis.save(tmp_path, force=True)
    assert tp.load(tmp_path).headline == analysis.headline
    again = tp.load(tmp_path)
    with pytest.raises(tp.OutputError, match=r"plant.toml is read by this run"):
        again.save(tmp_path, force=True)


def test_check_and_track_take_the_same_frames():
    found = tp.check(simulated(), loops=LOOPS, model=MODEL)
    assert found.status == "ok" and "1 record can be used" in found.headline
    assert valid(found, "check.json")
    still = simulated().with_columns(pl.lit(0.0).alias("t.sp"), pl.lit(0.0).alias("f.sp"))
    refused = tp.check(still, loops=LOOPS, model=MODEL)
    assert refused.status == "refused" and refused.reasons[0].code == "no-excitation"
    assert valid(refused, "check.json")
    followed = tp.track(simulated(samples=3000), loops=LOOPS[1:], model={("FIC7", "FIC7"): MODEL["FIC7", "FIC7"]})
    assert followed.status == "ok" and "<b>" in followed._repr_html_()
    assert valid(followed, "track.json")


def valid(found: tp.Check | tp.Track, name: str) -> bool:
    """Whether its document, as it would be written, is what the published schema says."""
    return Draft202012Validator(published(name)).is_valid(json.loads(as_json(found.to_dict())))


def test_a_model_that_is_unstable_in_the_loop_is_noted_for_every_experiment():
    """The plant may well have drifted from such a model, so it is no reason to refuse."""
    model = MODEL | {("TIC101", "TIC101"): "14 exp(-3 s)/(10 s + 1)"}
    found = tp.check([simulated(1, 800), simulated(2, 800)], loops=LOOPS, model=model)
    assert found.status == "ok"
    assert [note.where for note in found.notes if note.code == "unstable-model"] == ["frame 1", "frame 2"]
    assert not [note for note in tp.check(simulated(), loops=LOOPS, model=MODEL).notes if note.code == "unstable-model"]


def test_models_may_be_systems_of_python_control_or_a_matrix(analysis):
    own = {place: tp.tf(formula) for place, formula in MODEL.items()}
    matrix = tp.TransferMatrix.of(
        [[MODEL["TIC101", "TIC101"], MODEL["TIC101", "FIC7"]], [0.0, MODEL["FIC7", "FIC7"]]], "min"
    )
    for model in (own, matrix):
        same = tp.run(simulated(), loops=LOOPS, model=model, tuning={"methods": ["simc"]})
        assert [p.plant for e in same.elements for p in e.parameters] == pytest.approx(
            [p.plant for e in analysis.elements for p in e.parameters], rel=1e-9
        )
    lag = control.tf([2.0], [10.0, 1.0])
    found = tp.check(simulated(), loops=LOOPS[:1], model={("TIC101", "TIC101"): lag})
    assert found.status == "ok"


def test_several_frames_are_several_experiments():
    found = tp.run(
        [simulated(1, 800), pd.DataFrame(simulated(2, 800).to_dict(as_series=False))], loops=LOOPS, model=MODEL
    )
    assert [one.name for one in found.result.data] == ["frame 1", "frame 2"]


def test_what_cannot_be_meant_is_said():
    for none in ((), [{"pv": "TIC101.PV"}], {"TIC101": {"pv": "TIC101.PV"}}):
        with pytest.raises(tp.UsageError, match="name the loops as a list"):
            tp.run(simulated(), loops=none, model=MODEL)
    with pytest.raises(tp.UsageError, match="name output and input by their loops"):
        tp.run(simulated(), loops=LOOPS, model={("TIC101", "TIC102"): "1/(s + 1)"})
    with pytest.raises(tp.UsageError, match="the element 'TIC101', .*name output and input by their loops"):
        tp.run(simulated(), loops=LOOPS, model={"TIC101": "1/(s + 1)"})
    with pytest.raises(tp.UsageError, match="controller of TIC101 is a PID or the keys"):
        tp.run(simulated(), loops=[replace(LOOPS[0], controller="PI"), *LOOPS[1:]], model=MODEL)
    with pytest.raises(tp.UsageError, match="list of frames is empty"):
        tp.run([], loops=LOOPS, model=MODEL)
    with pytest.raises(tp.UsageError, match="the model is 1 by 1, and there are 2 loops"):
        tp.run(simulated(), loops=LOOPS, model=tp.TransferMatrix.of([["1/(s + 1)"]]))
    with pytest.raises(tp.UsageError, match="a project says them itself"):
        tp.run("project.toml", loops=LOOPS)
    with pytest.raises(tp.UsageError, match="nothing was retuned"):
        tp.run(simulated(), loops=LOOPS, model=MODEL).plot_retuning()
    with pytest.raises(tp.UsageError, match="holds no result.json"):
        tp.load("/nowhere")


def test_transfer_functions_have_latex_and_text():
    assert tp.tf("3.2 exp(-3 s)/(18 s + 1)")._repr_latex_() == r"$\frac{3.2}{18 s + 1} e^{-3 s}$"
    assert tp.tf("-2 (3 s + 1) exp(-s)/(s (5 s + 1)^2)")._repr_latex_() == (
        r"$-\frac{2 (3 s + 1)}{s (5 s + 1)^2} e^{-s}$"
    )
    assert tp.tf("0")._repr_latex_() == "$0$"
    matrix = tp.TransferMatrix.of([["1/(s + 1)", "0"], ["2", "1/s"]])
    assert str(matrix) == "1/(s + 1), 0\n2, 1/s"
    assert matrix._repr_latex_() == r"$\begin{bmatrix} \frac{1}{s + 1} & 0 \\ 2 & \frac{1}{s} \end{bmatrix}$"


def test_what_is_discrete_counts_as_its_step_response():
    """Sampled by python-control, from python-control and as coefficients: the model that was sampled."""
    place = ("TIC101", "TIC101")
    delayed = control.c2d(control.tf([2.0], [10.0, 1.0]), 1.0) * control.tf([1], [1, 0, 0, 0], dt=1.0)
    step = MeasuredStep.of_system(tp.tf("2 exp(-3 s)/(10 s + 1)"), 1.0, 80)
    continuous = from_control(control.tf([2.0], [10.0, 1.0]), [[3.0]])
    w = 1j * np.geomspace(0.01, 1, 20)
    for given in (
        delayed,
        control.ss(delayed),
        step,
        {"step": step.values[1:].tolist(), "sample_time": 1.0},
        continuous,
    ):
        made = project_of(["f"], LOOPS[:1], {place: given}, None, "min", {})
        assert np.allclose(made.model_matrix()[0, 0](w), tp.tf("2 exp(-3 s)/(10 s + 1)")(w), rtol=1e-3)
        assert (made.models["TIC101", "TIC101 OP"].measured is None) == (given is continuous)
    whole = project_of(["f"], LOOPS[:1], delayed, None, "min", {})
    assert np.allclose(whole.model_matrix()[0, 0](w), tp.tf("2 exp(-3 s)/(10 s + 1)")(w), rtol=1e-3)


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (control.tf([1], [1, -1.2], dt=1.0), "unstable"),
        (control.tf([1], [1, -0.5], dt=True), "left open"),
        (control.tf([1, 0], [1, -0.5], dt=1.0), "in the very sample"),
        (from_control(control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))), "is 2 by 2"),
    ],
)
def test_systems_that_are_no_element(system, said):
    with pytest.raises(tp.UsageError, match=said):
        project_of(["f"], LOOPS[:1], {("TIC101", "TIC101"): system}, None, "min", {})
