"""Set-points that repeat, in a whole analysis: the method, its response, the coherence. All records are simulated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from support.one_loop import LAG, declared, one_loop, single
from support.simulated import BLT, WOOD_BERRY, coloured
from trueplant import Project, Result, run
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.report import render

CHANGED = TransferMatrix.of([["14.5 exp(-1.4 s)/(16.7 s + 1)"]])[0, 0]
PLANT = TransferMatrix(((CHANGED, WOOD_BERRY[0, 1]), WOOD_BERRY.elements[1]), "min")
NAMES = ("top", "bottom"), ("reflux", "steam")


def binary(samples: int, clock: int, seed: int) -> np.ndarray[Any, Any]:
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], samples // clock), clock)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """Two records of seven periods of 300 min, one for each set-point; reflux -> top has a gain of 14.5, not 12.8."""
    folder: Path = tmp_path_factory.mktemp("periodic")
    for k in (0, 1):
        r = np.zeros((2100, 2))
        r[:, k] = np.tile(binary(300, 10, k), 7)
        v = coloured(np.random.default_rng(k), 2100, 2, [1, -0.8], [1], 0.2)
        sim = simulate(PLANT, BLT, r, 1.0, v=v)
        signals = {f"{name}{i}": x[:, i] for i in (0, 1) for name, x in (("sp", sim.r), ("op", sim.u), ("pv", sim.y))}
        pl.DataFrame({"t": sim.t, **signals}).write_csv(folder / f"{k}.csv")
    settings = [(0.375, 8.29), (-0.0754, 23.6)]
    made = Project(
        time_unit="min",
        data={"files": ["0.csv", "1.csv"], "time": "t"},
        output=[{"name": name, "pv": f"pv{i}", "sp": f"sp{i}"} for i, name in enumerate(NAMES[0])],
        input=[{"name": name, "op": f"op{j}"} for j, name in enumerate(NAMES[1])],
        model=[
            {"output": output, "input": input_, "tf": str(WOOD_BERRY[i, j])}
            for i, output in enumerate(NAMES[0])
            for j, input_ in enumerate(NAMES[1])
        ],
        controller=[
            {"input": NAMES[1][i], "output": NAMES[0][i], "Kc": Kc, "Ti": Ti, "sample_time": 1.0}
            for i, (Kc, Ti) in enumerate(settings)
        ],
    )
    return run(Project.from_toml(made.to_toml(), folder))


@pytest.mark.parametrize("method", ["periodic", "closed-form"])
def test_averages_over_periods_answer_all_elements_beside_the_fit(result, method):
    rows = result.to_dict()["methods"][method]
    truth = {
        ("top", "reflux"): (14.5, 16.7, 1.4),
        ("top", "steam"): (-18.9, 21.0, 3.4),
        ("bottom", "reflux"): (6.6, 10.9, 7.4),
        ("bottom", "steam"): (-19.4, 14.4, 3.4),
    }
    assert {(row["output"], row["input"]) for row in rows} == set(truth)
    apart = [
        (p["plant"] - true) / p["std_error"]
        for row in rows
        for p, true in zip(row["parameters"], truth[row["output"], row["input"]], strict=True)
    ]
    assert np.max(np.abs(apart)) < 4
    assert np.sqrt(np.mean(np.square(apart))) < 1.8
    assert (
        "closed-form and periodic agree with the fit within their uncertainties"
        in result.to_dict()["methods"]["agreement"]
    )
    assert "paper-route" not in result.to_dict()["methods"]
    assert "averages over their periods" in result.to_dict()["methods"]["not_applied"]["joint"]


def test_the_plant_is_held_against_the_averages_and_the_band_is_told(result):
    rows = result.to_dict()["methods"]["band"]
    assert len(rows) == 4
    for row in rows:
        assert row["within"]
        assert row["by"].endswith("averaged periods")
        low, high = row["speaks"]
        assert low < 0.1 < 0.2 < high
    assert result.result.curves.np_label.endswith("averaged periods")


def test_coherence_is_in_the_result_and_drawn(result):
    table = json.loads(json.dumps(result.to_dict()))["methods"]["coherence"]
    assert table["with"] == "set-points"
    assert [row["signal"] for row in table["signals"]] == ["top", "bottom", "reflux", "steam"]
    w = np.array(table["frequencies"])
    assert w.size <= 100
    for row in table["signals"]:
        values = np.array(row["multiple"])
        assert values.shape == w.shape
        assert np.all((values >= 0) & (values <= 1))
        assert [one["of"] for one in row["partial"]] == ["top", "bottom"]
    top = np.array(table["signals"][0]["multiple"])
    assert top[w < 0.1].mean() > 0.9
    assert np.mean(top[w > 2] > table["level"]) < 0.25
    page = render(result.result)
    assert "Coherence with the set-points" in page
    assert "Noise alone exceeds it at 5 % of them." in page


def test_setpoints_that_do_not_repeat_say_so_only_where_they_are_asked(tmp_path):
    usual = single(tmp_path, one_loop(0))
    assert "periodic" not in usual.to_dict()["methods"]
    assert "periodic" not in usual.to_dict()["methods"].get("not_applied", {})
    assert usual.to_dict()["methods"]["band"][0]["by"].endswith("local polynomials")
    project = declared(tmp_path, one_loop(0), "2 exp(-13.4 s)/(60 s + 1)")
    asked = run(Project.from_toml(project.to_toml() + '\n[analysis]\nmethod = "periodic"\n', tmp_path))
    assert "do not repeat, sample by sample" in asked.to_dict()["methods"]["not_applied"]["periodic"]


def test_one_loop_with_a_square_wave_is_averaged(tmp_path):
    """Up and down every 150 s, ten times."""
    law = Controller.diagonal([PID(Kc=1.0, Ti=60.0, sample_time=1.0)])
    r = np.tile(np.repeat([1.0, 0.0], 150), 10)[:, None]
    v = coloured(np.random.default_rng(2), 3000, 1, [1, -0.8], [1], 0.05)
    found = single(tmp_path, simulate(LAG, law, r, 1.0, v=v))
    (row,) = found.to_dict()["methods"]["periodic"]
    for p, true in zip(row["parameters"], (2.0, 60.0, 13.4), strict=True):
        assert abs(p["plant"] - true) < 4 * p["std_error"]
