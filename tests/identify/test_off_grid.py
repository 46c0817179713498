"""Samples at odd instants. All records are simulated, on a grid ten times as fine as what is recorded of them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from support.simulated import coloured, random_switching
from trueplant import Project, run
from trueplant.identify import Spec, as_if_sampled_on_the_grid, held_or_straight, identify_output
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix, sampled_response
from trueplant.lti.irregular import response_at
from trueplant.lti.structure import structure_of
from trueplant.result.budget import Source
from trueplant.study.data.prepare import prepare

PLANT = TransferMatrix.of([["2 exp(-3.4 s)/(12 s + 1)", "3 exp(-1.2 s)/(4 s + 1)"]], "min")
FINE = 0.1
TABLES = """
time_unit = "min"
data = {time = "t"}
experiment = [{file = "record.csv", loop = "open"}]
output = [{name = "y", pv = "pv"}]
input = [{name = "u", op = "op", actuator = "other"}]
"""


def odd(rng: np.random.Generator, samples: int) -> np.ndarray:
    """Samples of a fine record that are kept: steps of 0.4 to 1.6 min."""
    at = np.concatenate([[0], np.cumsum(rng.integers(4, 17, samples))])
    return at[at < samples]


def recorded(folder: Path, seed: int, std: float, hold: str | None, runs: str = "zoh", samples: int = 12000) -> Project:
    """OP of moves at odd instants in open loop, and a feed that moves at each; OP is held."""
    rng = np.random.default_rng([8, seed])
    at = odd(rng, samples)
    since = np.searchsorted(at, np.arange(samples), side="right") - 1
    u = random_switching(rng, at.size, 1, 30.0)[since]
    values = coloured(rng, at.size, 1, [1, -0.7], [1], 1.0)[:, 0]
    values -= values[0]
    d = values[since] if runs == "zoh" else np.interp(np.arange(samples), at, values)
    v = np.repeat(coloured(rng, samples // 10, 1, [1, -0.8], [1], std), 10, axis=0)
    s = simulate(
        PLANT.columns(0, 1),
        None,
        np.zeros((samples, 1)),
        FINE,
        u=u,
        d=d[:, None],
        Gd=PLANT.columns(1),
        d_hold=runs,
        v=v,
    )
    pl.DataFrame({"t": s.t[at], "op": s.u[at, 0], "pv": s.y[at, 0], "feed": d[at]}).write_csv(folder / "record.csv")
    declared = "" if hold is None else f', hold = "{hold}"'
    text = f"""
        disturbance = [{{name = "feed", column = "feed"{declared}}}]
        [[model]]
        output = "y"
        input = "u"
        tf = "2 exp(-3.4 s)/(12 s + 1)"
        [[model]]
        output = "y"
        input = "feed"
        tf = "3 exp(-1.2 s)/(4 s + 1)"
    """
    return Project.from_toml(TABLES + text, folder)


@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_the_response_at_odd_instants_is_that_of_a_grid_on_which_they_all_lie(hold):
    rng = np.random.default_rng(0)
    at = odd(rng, 3000)
    moves = np.append(0.0, rng.standard_normal(at.size - 1))
    since = np.searchsorted(at, np.arange(3000), side="right") - 1
    fine = moves[since] if hold == "zoh" else np.interp(np.arange(3000), at, moves)
    for system in PLANT.elements[0]:
        y = sampled_response(system, fine, FINE, hold)[at]
        assert np.allclose(response_at(system, moves, FINE * at, hold), y, atol=1e-11)


@pytest.mark.parametrize("runs", ["zoh", "linear"])
def test_for_the_true_plant_all_that_the_grid_does_is_taken_off(tmp_path, runs):
    """Free of noise: what is left of PV is the plant's response to the moves on the grid."""
    study = prepare(recorded(tmp_path, 0, 0.0, runs, runs, samples=3000))
    (segment,), (exact,) = study.segments, as_if_sampled_on_the_grid(study.segments, PLANT)
    moves = np.hstack([segment.u, segment.d]) - np.hstack([segment.stamps.u, segment.stamps.d])[0]
    y = sampled_response(PLANT, moves, segment.h, ("zoh", runs))[:, 0]
    apart = [one.y[:, 0] - y - (one.y[:, 0] - y)[0] for one in (segment, exact)]
    assert np.nanmax(np.abs(apart[0])) > 0.05
    assert np.nanmax(np.abs(apart[1])) < 1e-9
    assert exact.stamps is None and np.array_equal(np.isnan(exact.y), np.isnan(segment.y))


def test_a_quiet_record_at_odd_instants_is_no_other_plant(tmp_path):
    """The grid's own error is several times the noise: taken for dynamics, it made another plant of half of them."""
    values = []
    for seed in range(3):
        result = run(recorded(tmp_path, seed, 0.02, "zoh"))
        assert [str(e.verdict) for e in result.elements] == ["unchanged"] * 2
        assert all(e.rejected_structure is None for e in result.elements)
        values.append([p.plant for e in result.elements for p in e.parameters])
    assert np.allclose(np.mean(values, axis=0)[[2, 5]], [3.4, 1.2], atol=0.02)


@pytest.mark.parametrize("runs", ["zoh", "linear"])
def test_how_a_feed_runs_between_odd_instants_is_found(tmp_path, runs):
    """Held it is half a sample later, which a dead time would show: 1.7 min for 1.2 min."""
    (_, feed) = run(recorded(tmp_path, 0, 0.05, None, runs)).elements
    assert str(feed.verdict) == "unchanged"
    assert abs(feed.parameters[2].plant - 1.2) < 0.02


def test_ways_are_compared_by_the_size_of_their_errors_and_not_by_their_number():
    """A shorter noise model leaves more of them where PV is missing now and then."""

    def ended(variance: float, left: int) -> Any:
        fit = SimpleNamespace(deviance=left * np.log(variance), left=left)
        return {0: SimpleNamespace(fit=fit, ratio_factor=np.ones(1))}

    assert held_or_straight(ended(0.005, 640), ended(0.0006, 360)) is False
    assert held_or_straight(ended(0.0006, 460), ended(0.006, 580)) is True
    assert held_or_straight(ended(0.005, 640), ended(0.00501, 360)) is None


def test_an_instant_that_stays_open_is_half_a_sample_wide(tmp_path):
    study = prepare(recorded(tmp_path, 0, 0.05, None))
    row = [Spec(column, structure_of(PLANT[0, column])[0], structure_of(PLANT[0, column])[1]) for column in range(2)]
    estimate = identify_output(study.segments, 0, row)
    assert estimate.row.is_dead_time.tolist() == [False, False, True] * 2
    late = np.sqrt(np.diag(estimate.uncounted[Source.ROUNDING]))
    assert late[5] == pytest.approx(study.segments[0].h / 2, rel=1e-6) and late[2] < 1e-3


TWO_FEEDS = TransferMatrix.of(
    [["2 exp(-3.4 s)/(12 s + 1)", "3 exp(-1.2 s)/(4 s + 1)", "1.5 exp(-2 s)/(6 s + 1)"]], "min"
)


def with_two_feeds(folder: Path, seed: int, declared: str) -> Project:
    """OP of moves at odd instants in open loop, a feed that runs in straight lines and one that is held."""
    rng = np.random.default_rng([9, seed])
    at = odd(rng, 12000)
    since = np.searchsorted(at, np.arange(12000), side="right") - 1
    u = random_switching(rng, at.size, 1, 30.0)[since]
    straight, held = coloured(rng, at.size, 2, [1, -0.7], [1], 1.0).T
    runs = np.interp(np.arange(12000), at, straight), held[since]
    moves = [u[:, 0], *(one - one[0] for one in runs)]
    pairs = zip(TWO_FEEDS.elements[0], moves, ("zoh", "linear", "zoh"), strict=True)
    y = sum(sampled_response(system, signal, FINE, hold) for system, signal, hold in pairs)
    y = y + np.repeat(coloured(rng, 1200, 1, [1, -0.8], [1], 0.05), 10, axis=0)[:, 0]
    columns = {"t": FINE * at, "op": u[at, 0], "pv": y[at], "f1": runs[0][at], "f2": runs[1][at]}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    names = ("u", "f1", "f2")
    formulas = zip(names, TWO_FEEDS.elements[0], strict=True)
    models = "".join(f'[[model]]\noutput = "y"\ninput = "{name}"\ntf = "{tf}"\n' for name, tf in formulas)
    return Project.from_toml(f"{TABLES}disturbance = [{declared}]\n{models}", folder)


OPEN = '{name = "f1", column = "f1"}, {name = "f2", column = "f2"}'
DECLARED = '{name = "f1", column = "f1", hold = "linear"}, {name = "f2", column = "f2", hold = "zoh"}'


def test_each_of_two_feeds_runs_its_own_way_between_odd_instants(tmp_path):
    """Taken to run alike, one of them was half a sample off, by up to 24 standard errors."""
    (_, straight, held) = run(with_two_feeds(tmp_path, 0, OPEN)).elements
    assert (str(straight.verdict), str(held.verdict)) == ("unchanged", "unchanged")
    assert abs(straight.parameters[2].plant - 1.2) < 0.02 and abs(held.parameters[2].plant - 2.0) < 0.03


def test_the_grid_is_taken_off_until_nothing_moves(tmp_path):
    """Each correction leaves up to six tenths of the error, to the other side: three of them left 3 standard errors."""
    for seed in range(4):
        result = run(with_two_feeds(tmp_path, seed, DECLARED))
        assert [str(e.verdict) for e in result.elements] == ["unchanged"] * 3
        held = result.elements[2].parameters[2]
        assert abs(held.plant - 2.0) < 3 * held.std_error
