"""Results on disk are whole, or not there."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import trueplant as tp
from support.report_sample import sample
from trueplant import output
from trueplant.lti import KnownRow, Structure, TransferMatrix, UncertainPlant
from trueplant.result import Curves, Provenance, Result, Settings, Trend, Uncertainty

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
PROVENANCE = Provenance("0", "project", "", {}, {}, "s", 0, Settings("auto", 0.95, 0.0))
REFUSED = Result("refused", (), PROVENANCE, (), ())
FOPDT = Structure.parse("fopdt")


def answered(gain: float = 2.0) -> Result:
    """One element that was estimated."""
    theta = np.array([gain, 1.0, 0.5])
    nominal = TransferMatrix(((FOPDT.transfer(theta),),), "s")
    plant = UncertainPlant(nominal, {0: KnownRow((0,), (FOPDT,), theta, 0.01 * np.eye(3))})
    return Result(
        "ok",
        (),
        PROVENANCE,
        (),
        (),
        plant=plant,
        uncertainty=Uncertainty.of(plant, ("y",), ("u",)),
        curves=curves(gain),
    )


@cache
def curves(gain: float) -> Curves:
    found = sample(experiments=1).curves
    assert found is not None
    return replace(found, step_plant=gain * found.step_plant)


def project(folder: Path) -> tp.Project:
    return tp.Project.from_toml(PLANT, folder)


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
    written = output.write_results(answered(), project(tmp_path), tmp_path, "<html>")
    assert list(written) == ["curves.json", "plant.toml", "report.html", "result.json"]
    assert set(output.write_results(REFUSED, project(tmp_path), tmp_path)) == {"result.json"}
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_result_names_the_sums_of_its_files(tmp_path):
    output.write_results(answered(), project(tmp_path), tmp_path, "<html>")
    sums = json.loads((tmp_path / "result.json").read_text())["files"]
    assert sums.keys() == {"curves.json", "plant.toml", "report.html"}
    for name, digest in sums.items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest


def test_paths_of_the_plant_hold_where_it_lies(tmp_path):
    written = output.write_results(answered(), project(tmp_path / "project"), tmp_path / "a" / "b")
    plant = tp.Project.load(written["plant.toml"])
    assert plant.experiments[0].path.resolve() == (tmp_path / "project" / "record.csv").resolve()
    assert plant.simulate is not None
    assert plant.simulate.plant == "../../project/other.toml"


def test_comments_of_the_project_stand_in_the_plant(tmp_path):
    commented = tp.Project.from_toml(PLANT.replace('"record.csv"]', '"record.csv"] # of March'), tmp_path)
    written = output.write_results(answered(), commented, tmp_path / "out")
    assert 'files = ["../record.csv"] # of March\n' in written["plant.toml"].read_text()
    assert tp.Project.load(written["plant.toml"]).model_matrix().dc_gain.tolist() == [[2]]


def test_refusal_has_no_plant(tmp_path):
    refused = replace(answered(), status="refused")
    assert set(output.write_results(refused, project(tmp_path), tmp_path)) == {"result.json", "curves.json"}


def test_a_saved_result_is_read_as_it_was(tmp_path):
    result = answered()
    output.write_results(result, project(tmp_path), tmp_path)
    again = output.read_results(tmp_path)
    assert again.to_dict() == result.to_dict()
    assert again.plant is not None and result.plant is not None
    s = 1j * np.geomspace(0.01, 10, 7)
    np.testing.assert_allclose(again.plant.nominal(s), result.plant.nominal(s), rtol=1e-12)
    np.testing.assert_array_equal(again.plant.rows[0].covariance, result.plant.rows[0].covariance)
    assert again.curves is not None and result.curves is not None
    for name in ("step_low", "bode_plant", "np_value", "condition"):
        np.testing.assert_allclose(getattr(again.curves, name), getattr(result.curves, name))


def test_long_trends_are_thinned_without_losing_an_extreme():
    n = 100_000
    y = np.random.default_rng(0).standard_normal((n, 1))
    trend = Trend("r", np.arange(n, dtype=float), y * np.nan, y, y**2, y, y, ())
    short = trend.decimated(4000)
    assert 1000 < short.t.size <= 4100
    assert (short.y.max(), short.y.min(), short.u.max()) == (y.max(), y.min(), (y**2).max())
    assert (short.t[0], short.t[-1]) == (0, n - 1)
    assert trend.decimated(n) is trend


@pytest.mark.parametrize(
    ("folder", "said"),
    [
        ({}, "holds no result.json"),
        ({"result.json": "{"}, "cannot be read"),
        ({"result.json": "{}"}, "is not a result of this version"),
    ],
)
def test_what_is_no_result_is_said(tmp_path, folder, said):
    for name, text in folder.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(tp.UsageError, match=said):
        output.read_results(tmp_path)


def test_files_of_two_analyses_are_recognised(tmp_path):
    output.write_results(answered(2.0), project(tmp_path), tmp_path)
    (tmp_path / "curves.json").write_text("{}")
    with pytest.raises(tp.UsageError, match="curves.json and result.json are not of one analysis"):
        output.read_results(tmp_path)


# -- kills ---------------------------------------------------------------------------------------------------------


def killed(write: Callable[[], object], moment: float | int) -> bool:
    """Run `write` in a process of its own that ends without a word after so many seconds, or before its so many-th
    opening, moving or removing of a file; True if it ended before it was done."""
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        if isinstance(moment, int):
            left = [moment]

            def count(event: str, _: object) -> None:
                if event in ("open", "os.rename", "os.remove"):
                    left[0] -= 1
                    if left[0] < 0:
                        os.kill(os.getpid(), signal.SIGKILL)

            sys.addaudithook(count)
        else:
            signal.setitimer(signal.ITIMER_REAL, max(moment, 1e-6))
        write()
        os._exit(0)
    return os.waitpid(child, 0)[1] != 0


def gain_of(folder: Path) -> float:
    """The gain in result.json, after a look that all that lies beside it says the same."""
    found = output.read_results(folder)
    assert found.uncertainty is not None and found.curves is not None
    gain = found.uncertainty.rows[0].parameters[0].value
    assert tp.Project.load(folder / "plant.toml").model_matrix().dc_gain[0, 0] == pytest.approx(gain)
    assert (folder / "report.html").read_text() == f"gain {gain:g}"
    np.testing.assert_allclose(found.curves.step_plant, curves(gain).step_plant)
    sums = json.loads((folder / "result.json").read_text())["files"]
    assert {p.name for p in folder.iterdir()} == {"result.json", *sums}
    return gain


@pytest.mark.slow
def test_200_kills_leave_the_old_files_the_new_ones_or_what_is_mended(tmp_path):
    """Old and new are whole results; a process is killed while it writes the new over the old."""
    old, new, rng = answered(2.0), answered(3.0), np.random.default_rng(0)
    folder = tmp_path / "out"

    def write(result: Result) -> None:
        gain = 2.0 if result is old else 3.0
        output.write_results(result, project(tmp_path), folder, f"gain {gain:g}")

    write(old)
    began = time.perf_counter()
    write(new)
    took = time.perf_counter() - began
    outcomes, mixed = Counter(), 0
    for k in range(200):
        write(old)
        cut = killed(lambda: write(new), k if k < 30 else float(rng.uniform(0, 1.2 * took)))
        waiting = list(folder.glob(".*.part"))
        mixed += bool(waiting) and (folder / "report.html").read_text() == "gain 3"
        outcomes[cut, gain_of(folder)] += 1
    assert outcomes[True, 2.0] >= 20 and outcomes[False, 3.0] >= 1
    assert mixed >= 1  # some were caught half moved, and were mended
    assert outcomes[False, 2.0] == 0


def test_the_next_run_mends_what_a_kill_has_left(tmp_path):
    output.write_results(answered(2.0), project(tmp_path), tmp_path, "old")
    orphan = tmp_path / ".report.html.999999999-0123abcd.part"
    orphan.write_text("half")
    mine = tmp_path / f".curves.json.{os.getpid()}-0123abcd.part"
    mine.write_text("being written now")
    output.write_results(answered(3.0), project(tmp_path), tmp_path, "new")
    assert not orphan.exists() and mine.exists()  # what a living process writes is left alone


def test_failure_leaves_the_old_files(tmp_path, monkeypatch):
    output.write_files(tmp_path, {"a": "old", "b": "old"})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(output.os, "fsync", full)
    with pytest.raises(tp.OutputError, match="No space left"):
        output.write_files(tmp_path, {"a": "new", "b": "new"})
    assert sorted((p.name, p.read_text()) for p in tmp_path.iterdir()) == [("a", "old"), ("b", "old")]
