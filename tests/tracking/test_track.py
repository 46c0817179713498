"""Tracking from project file to track.json: windows, changes and refusals on simulated records (seeds stated)."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.stats import norm

from support import ROOT
from support.changing import PARAMETERS, PROJECT, changing_wood_berry, write_project
from support.simulated import segment_of
from trueplant import Project
from trueplant.cli import main
from trueplant.cli.track import show
from trueplant.detect.since import Shift
from trueplant.errors import DataError, UsageError
from trueplant.identify import Row, Spec, fit_row, pieces_of
from trueplant.identify.noise import whiten
from trueplant.lti import Structure
from trueplant.report.track import render
from trueplant.result import (
    Change,
    ChangeKind,
    ElementHistory,
    ElementVerdict,
    Moved,
    Parameter,
    Provenance,
    Settings,
    Track,
    TrackedElement,
    TrackedExperiment,
    Window,
    WindowElement,
)
from trueplant.result.track_words import refused_stretches
from trueplant.tracking import levels
from trueplant.tracking.changes import _change
from trueplant.tracking.track import track
from trueplant.tracking.windows import blocks_of, moves_of

N = 2600
X = np.arange(N)
DOCS = ROOT / "docs"


def followed(folder: Path, **changes: Any) -> Track:
    return track(Project.load(write_project(changing_wood_berry(std=0.15, samples=N, **changes), folder)))


def changed(found: Track) -> list[tuple[str, str, str]]:
    return [(c.input, c.output, c.kind) for c in found.changes]


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path, dict[str, Any]]:
    """Exit status, folder and track.json of a record whose gain from reflux to top rises by 25 % at 1,300 min."""
    folder = tmp_path_factory.mktemp("step")
    factor = np.where(X >= 1300, 1.25, 1.0)
    path = write_project(changing_wood_berry(3, N, (0, 0), gain=factor, std=0.15), folder)
    status = main(["track", str(path), "--out", str(folder / "out")])
    return status, folder / "out", json.loads((folder / "out" / "track.json").read_text("utf-8"))


def test_step_is_put_on_its_element_parameter_and_time(step: tuple[int, Path, dict[str, Any]]) -> None:
    status, _, body = step
    assert status == 0 and body["status"] == "ok"
    (change,) = body["changes"]
    assert (change["input"], change["output"], change["kind"]) == ("reflux", "top", "step")
    # sample 1300 is the first that the new process drives; PV shows it from the next on
    assert change["interval"][0] <= 1301 and change["interval"][1] >= 1300
    assert change["interval"][1] - change["interval"][0] < 200
    gain = change["parameters"][0]
    assert gain["name"] == "gain" and gain["changed"] and gain["ci"][0] < 0.25 * 12.8 < gain["ci"][1]
    assert [e["history"] for e in body["elements"]] == ["step", "constant", "constant", "constant"]
    assert body["headline"].startswith("reflux -> top changed in a step at ")


def test_windows_keep_clear_of_the_step_and_of_each_other(step: tuple[int, Path, dict[str, Any]]) -> None:
    _, _, body = step
    low, high = body["changes"][0]["interval"]
    for output in ("top", "bottom"):
        windows = [w for w in body["windows"] if w["output"] == output]
        assert all(a["end"] <= b["start"] + 1e-9 for a, b in pairwise(windows))
        if output == "top":
            assert all(w["end"] <= low + 1e-9 or w["start"] >= high - 1e-9 for w in windows)
    verdicts = [
        (w["end"] <= low, w["elements"][0]["verdict"])
        for w in body["windows"]
        if w["output"] == "top" and w["elements"]
    ]
    assert "changed" not in {v for before, v in verdicts if before} and (False, "changed") in verdicts


def test_a_window_is_unchanged_only_where_a_change_worth_knowing_would_have_shown_in_it(
    step: tuple[int, Path, dict[str, Any]],
) -> None:
    """Two elements an output, 4 % over both, four records of five: so many standard errors of the gain are seen."""
    _, _, body = step
    elements = [e for w in body["windows"] for e in w["elements"]]
    seen = norm.isf(0.04 / 4) + norm.ppf(0.8)
    assert sum(e["verdict"] == "unchanged" for e in elements) >= 5
    for element in elements:
        gain = element["parameters"][0]
        if element["verdict"] == "unchanged":
            assert seen * gain["std_error"] < 1.05 * 0.3 * abs(gain["plant"])  # 5 % for profiles
        assert element["p_adjusted"] is not None and gain["plant"] is not None
    assert any(e["verdict"] == "not identifiable" for e in elements)


def test_windows_know_the_plant_as_well_as_was_asked(step: tuple[int, Path, dict[str, Any]]) -> None:
    """10 % standard error was asked for and foretold; what comes out is that on average, and never far beyond twice."""
    _, _, body = step
    ratios = [
        p["std_error"] / (abs(p["plant"]) + (e["parameters"][1]["plant"] if p["name"] == "dead_time" else 0.0))
        for w in body["windows"]
        for e in w["elements"]
        for p in e["parameters"]
    ]
    assert len(ratios) >= 24 and np.median(ratios) < 0.1 and max(ratios) < 0.25


def test_files_and_page(step: tuple[int, Path, dict[str, Any]]) -> None:
    _, folder, body = step
    assert {p.name for p in folder.iterdir()} == {"track.json", "track.html"}
    page = (folder / "track.html").read_text("utf-8")
    assert body["headline"].replace("->", "→") in page
    assert page.count('class="plot"') == 4
    assert not re.search(r"<(script|img|link)[^>]* (src|href)=", page)


def test_drift_is_called_one(tmp_path: Path) -> None:
    found = followed(tmp_path, seed=0, place=(1, 1), tau=1 + 0.6 * X / N)
    assert changed(found) == [("steam", "bottom", "drift")]
    tau = next(p for p in found.changes[0].parameters if p.name == "tau1")
    assert tau.changed and tau.ci[0] < 0.6 * 14.4 < tau.ci[1]
    assert "drifted from" in found.headline


def test_nothing_is_claimed_where_nothing_moves(tmp_path: Path) -> None:
    found = followed(tmp_path, seed=1, quiet=(900, 1800))
    assert found.changes == ()
    for output in ("top", "bottom"):
        refused = [w for w in found.windows if w.output == output and w.status == "refused"]
        assert len(refused) == 1 and refused[0].reason == "no set-point moves in this stretch"
        # moves show for five lags and the dead time of the slowest element after the last of them
        assert 900 <= refused[0].start <= 900 + 150 and refused[0].end == pytest.approx(1800, abs=60)
        assert refused[0].elements == ()
    text = render(found)
    assert "no set-point moves in this stretch" in text and "top, bottom" in text


def test_a_disturbance_that_doubles_is_no_change(tmp_path: Path) -> None:
    found = followed(tmp_path, seed=3, level=np.where(X >= 1300, 2.0, 1.0))
    assert changed(found) == []
    assert {e.history for e in found.elements} == {"constant"}
    assert found.headline == "No change over time was found in any of the 4 elements, and no difference from the model."


def test_record_without_moves_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_project(changing_wood_berry(4, 800, quiet=(0, 800)), tmp_path)
    assert main(["track", str(path), "--out", str(tmp_path / "out"), "--json"]) == 3
    printed = capsys.readouterr()
    body = json.loads(printed.out)
    assert body["status"] == "refused" and body["reasons"][0]["code"] == "no-excitation"
    assert body["elements"] == [] and all(w["status"] == "refused" for w in body["windows"])
    assert body["headline"].startswith("Nothing can be followed: ")
    assert printed.err == ""


def columns_of(seed: int) -> dict[str, np.ndarray]:
    sim = changing_wood_berry(seed, 300)
    columns = {"sp1": sim.r[:, 0], "sp2": sim.r[:, 1], "op1": sim.u[:, 0], "op2": sim.u[:, 1]}
    return columns | {"pv1": sim.y[:, 0], "pv2": sim.y[:, 1]}


def two_files(folder: Path, second_time: list[float]) -> Project:
    for name, seed, t in (("a.csv", 5, range(300)), ("b.csv", 6, second_time)):
        pl.DataFrame({"t": [float(one) for one in t], **columns_of(seed)}).write_csv(folder / name)
    return Project.from_toml(PROJECT.replace('["record.csv"]', '["a.csv", "b.csv"]'), folder)


@pytest.mark.parametrize(("first", "offset"), [(400.0, 0.0), (0.0, 300.0)], ids=["follows", "own clock"])
def test_records_are_laid_one_after_the_other(tmp_path: Path, first: float, offset: float) -> None:
    from trueplant.study.data.prepare import prepare
    from trueplant.tracking.track import lay_out

    laid = lay_out(prepare(two_files(tmp_path, [first + k for k in range(300)])))
    assert [e.offset for e in laid] == [0.0, offset]
    assert laid[1].span[0] == max(first, 300.0)


def test_records_that_overlap_are_an_error(tmp_path: Path) -> None:
    from datetime import datetime, timedelta

    from trueplant.study.data.prepare import prepare
    from trueplant.tracking.track import lay_out

    for name, hours in (("a.csv", 0), ("b.csv", 2)):
        start = datetime(2024, 3, 1) + timedelta(hours=hours)
        stamps = [(start + timedelta(minutes=k)).isoformat() for k in range(300)]
        pl.DataFrame({"t": stamps, **columns_of(5 + hours)}).write_csv(tmp_path / name)
    project = Project.from_toml(PROJECT.replace('["record.csv"]', '["a.csv", "b.csv"]'), tmp_path)
    with pytest.raises(DataError, match=r"a\.csv and b\.csv overlap in time"):
        lay_out(prepare(project))


def test_blocks_hold_the_information_of_the_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the stride and the chunks: blocks end with the record, and add up to its information."""
    specs = tuple(Spec(j, Structure.parse("fopdt"), PARAMETERS[0, j]) for j in range(2))
    segment = segment_of(changing_wood_berry(6, 1501))
    theta = np.array([*PARAMETERS[0, 0], *PARAMETERS[0, 1]])
    for stride in (1, 4):
        row = Row(specs, pieces_of([segment], 0), stride)
        fit = fit_row(row, theta, np.array([-0.5]), iterations=0)
        moves = moves_of([segment])
        monkeypatch.setattr(levels, "CHUNK", 20_000)
        blocks = blocks_of(fit, row, moves)
        assert blocks.end[-1] <= segment.t[-1] + segment.h and np.all(blocks.start[1:] == blocks.end[:-1])
        assert blocks.active.all() and blocks.errors.sum() == pytest.approx(1501 / stride, abs=2)
        _, gradient = row.response_and_gradient(theta, 0)
        x = whiten(fit.ar, np.column_stack([gradient, np.ones(len(gradient))]))
        assert np.allclose(blocks.information.sum(axis=0), x.T @ x / fit.variance, rtol=1e-9)
        monkeypatch.setattr(levels, "CHUNK", 100)
        again = blocks_of(fit, row, moves)
        scale = np.sqrt(np.diag(blocks.information.sum(axis=0)))
        difference = (again.information.sum(axis=0) - blocks.information.sum(axis=0)) / np.outer(scale, scale)
        assert np.abs(difference).max() < 1e-3  # the past beyond ten lags is left out


def test_impossible_precision_is_a_usage_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_project(changing_wood_berry(4, 60), tmp_path)
    assert main(["track", str(path), "--precision", "0", "--out", str(tmp_path / "out")]) == 2
    assert "a precision of 0 % cannot be asked for" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    with pytest.raises(UsageError):
        track(Project.load(path), 0.9)


def test_every_field_of_the_track_is_described(step: tuple[int, Path, dict[str, Any]]) -> None:
    text = (DOCS / "track.md").read_text("utf-8")
    parts = re.split(r"^##+ (.+)$", text, flags=re.M)
    told = {
        heading: {name for row in re.findall(r"^\|([^|]+)\|", body, flags=re.M) for name in re.findall(r"`(\w+)`", row)}
        for heading, body in zip(parts[1::2], parts[2::2], strict=True)
    }
    assert told["track.json, schema 1"] == step[2].keys()
    assert told["Each of `elements`"] == {f.name for f in fields(TrackedElement)}
    assert told["Each of `changes`"] == {f.name for f in fields(Change)}
    assert told["Each of `windows`"] == {f.name for f in fields(Window)}
    for kind in (Moved, TrackedExperiment, WindowElement):  # the last also as `standing`
        missing = {f.name for f in fields(kind)} - set(re.findall(r"`(\w+)`", text))
        assert not missing


def test_stretches_refused_alike_are_said_together() -> None:
    """A line a reason and record; when is said output by output where outputs differ."""
    still, short = "no set-point moves in this stretch", "this stretch is shorter than a window can be"
    windows = [
        Window(output, "march.csv", start, end, "refused", why)
        for output, start, end, why in [
            ("top", 0.0, 60.0, still),
            ("bottom", 0.0, 60.0, still),
            ("top", 300.0, 340.0, short),
            ("top", 500.0, 560.0, still),
            ("bottom", 500.0, 560.0, still),
            ("bottom", 700.0, 800.0, short),
        ]
    ]
    windows.append(Window("top", "march.csv", 60.0, 300.0, "ok"))
    found = Track("ok", (), (), {}, "min", (), windows=tuple(windows))
    assert refused_stretches(found) == [
        ("top, bottom", "march.csv", "0 to 60 min, 500 to 560 min", still),
        ("top, bottom", "march.csv", "top 300 to 340 min; bottom 700 to 800 min", short),
    ]


AS_A_WHOLE = "as a whole, though no single parameter did for certain"


def jointly(rise: float) -> Change:
    """A step of two delayed gains that move by so much against each other; their errors are correlated by 0.99."""
    structure = Structure.parse("fopdt+delayed")
    study = SimpleNamespace(project=SimpleNamespace(output_names=("y",)), columns=("u",))
    spec = SimpleNamespace(column=0, structure=structure)
    row = SimpleNamespace(study=study, specs=(spec,), output=0, units=lambda _: ("",) * len(structure.names))
    one: Any = SimpleNamespace(row=row, kept=lambda _: [0, 1])
    before = np.array([2.0, -2.0])
    shift = Shift(before, before + np.array([rise, -rise]), np.array([[1.0, 0.99], [0.99, 1.0]]))
    assert shift.p_value < 1e-6
    return _change(one, 0, ChangeKind.STEP, (5.0, (4.0, 6.0)), 1e-6, shift, 0.05)


def test_a_parameter_is_starred_by_its_own_test_alone() -> None:
    """The difference of both gains is known ten times as well as each: it has moved, and neither gain for certain."""
    change = jointly(0.85)
    assert all(p.ci[0] < 0 < p.ci[1] and p.p_adjusted > 0.5 for p in change.parameters)
    assert not any(p.changed for p in change.parameters)
    assert all(p.changed for p in jointly(8.5).parameters)


def test_what_changed_or_is_off_as_a_whole_is_said_as_that(capsys: pytest.CaptureFixture[str]) -> None:
    """In the headline, on the terminal and in the report: nowhere is a place for parameters left empty."""
    off = Parameter("gain", "", 2.0, 2.2, 0.3, (1.6, 2.8), 10.0, 0.5, 0.5, False)
    standing = WindowElement("v", ElementVerdict.CHANGED, 1e-4, (off,))
    elements = (
        TrackedElement("y", "u", ElementHistory.STEP, 1e-6, 3, 1.0),
        TrackedElement("y", "v", ElementHistory.CONSTANT, 0.5, 3, 1.0, standing=standing),
    )
    experiment = TrackedExperiment("march.csv", 0.0, None, (0.0, 10.0))
    windows = (Window("y", "march.csv", 0.0, 4.0, "ok"), Window("y", "march.csv", 6.0, 10.0, "ok"))
    settings = Settings("auto", 0.95, 0.0, precision_percent=10.0)
    provenance = Provenance("0.1.0", "project", "0" * 64, {}, {}, "min", 0, settings)
    found = Track("ok", (), (), provenance, "min", (experiment,), elements, (jointly(0.85),), windows)
    assert f"u -> y changed in a step at 5 min (4 to 6 min): {AS_A_WHOLE}." in found.headline
    always = f"off the model {AS_A_WHOLE.replace('did', 'is')}"
    assert f"v -> y is constant, but {always}." in found.headline
    show(found)
    printed = " ".join(capsys.readouterr().out.split())
    table = printed.removeprefix(found.headline)
    assert AS_A_WHOLE in table and f"all the time {always}" in table
    assert f'<td class="said">{AS_A_WHOLE}</td>' in render(found)
