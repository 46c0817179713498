"""The page of a refusal: the trends that it rests on, drawn without a script."""

from __future__ import annotations

import re

import numpy as np
import polars as pl
import pytest

from trueplant import Project, run
from trueplant.errors import UsageError
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.report import levels, render

FORMULA = "0.8 exp(-2 s)/(10 s + 1)"


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    """A loop whose set-point stands still, with a stretch of bad samples and a name that is no markup."""
    folder = tmp_path_factory.mktemp("resting")
    plant, law = TransferMatrix.of([[FORMULA]], "min"), Controller.diagonal([PID(Kc=1.0, Ti=10.0, sample_time=1.0)])
    done = simulate(plant, law, np.zeros((900, 1)), 1.0, noise=0.1, seed=3)
    pv = 50 + done.y[:, 0]
    pv[300:330] = np.nan
    columns = {"t": done.t, "sp": 50 + done.r[:, 0], "op": 40 + done.u[:, 0], "pv": pv}
    pl.DataFrame(columns).with_columns(pl.col("pv").fill_nan(None)).write_csv(folder / "rest.csv")
    text = f"""
        time_unit = "min"
        data = {{files = ["rest.csv"], time = "t"}}
        output = [{{name = "a<b", pv = "pv", sp = "sp", unit = "degC"}}]
        input = [{{name = "steam", op = "op", unit = "%"}}]
        model = [{{output = "a<b", input = "steam", tf = "{FORMULA}"}}]
        controller = [{{input = "steam", output = "a<b", Kc = 1, Ti = 10, sample_time = 1}}]
    """
    return run(Project.from_toml(text, folder))


def test_a_refusal_shows_its_trend_without_a_script(resting):
    page = render(resting.result)
    assert len(page) < 300_000
    assert "<script" not in page
    assert page.count('<svg class="still"') == 2
    assert "SP does not move, 50 degC" in page
    assert "a<b" not in page and "a&lt;b" in page


def test_the_reason_is_said_once_on_page_and_terminal(resting):
    reason = resting.result.reasons[0].message
    assert render(resting.result).split("<main")[1].count(reason) == 1
    assert str(resting).count(reason) == 1


def test_missing_samples_are_a_gap_and_all_lies_within_the_frame(resting):
    drawing = render(resting.result).split('<svg class="still"')[1].split("</svg>")[0]
    lines = re.findall(r'class="measured" points="([^"]+)"', drawing)
    assert len(lines) == 2
    points = np.array([[float(x) for x in pair.split(",")] for line in lines for pair in line.split()])
    assert points.min() >= 0
    assert np.all(points.max(axis=0) <= [levels.STILL_WIDTH, levels.STILL_HEIGHT])
    # the highest and the lowest sample are among the drawn ones
    assert np.ptp(points[:, 1]) == pytest.approx(levels.STILL_HEIGHT - 2 * levels.CELL_EDGE, abs=0.2)


def test_figures_that_a_refusal_does_not_have_are_refused_in_words(resting):
    assert len(resting.plot_trends().data) > 0
    with pytest.raises(UsageError, match="nothing to draw but trends"):
        resting.plot_steps()
