"""A set-point that a computer makes of the PVs does not move the loop from outside, and is no excitation.

All records are simulated: one loop of 2 exp(-3 s)/(10 s + 1) under PI, or a slave below a PI master.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from support.simulated import coloured, random_switching, segment_of, wood_berry
from trueplant import Loop, Project, Result, run
from trueplant.record import Segment
from trueplant.study.data.setpoints import computed_setpoints
from trueplant.tracking.track import track

Array = NDArray[np.float64]
SAMPLES = 1500
KINDS = ["filtered", "proportional", "mean", "tracking"]


def inside(kind: str, seed: int, operator: Array | None = None) -> dict[str, Array]:
    """A loop whose set-point is a function of its PV, to which an operator may add his own moves."""
    v = coloured(np.random.default_rng(seed), SAMPLES, 1, [1, -0.97], [1], 1.0)[:, 0]
    r, u, y = np.zeros((3, SAMPLES))
    x = integral = f = 0.0
    pole = np.exp(-0.1)
    for t in range(SAMPLES):
        y[t] = x + v[t]
        if kind == "filtered":
            f = 0.8 * f - 0.1 * (y[t - 1] if t else 0.0)
        elif kind == "proportional":
            f = -0.3 * y[t]
        elif kind == "mean" and t % 30 == 0 and t:
            f = -np.mean(y[t - 30 : t])
        elif kind == "tracking" and t % 50 == 0:
            f = y[t]
        r[t] = f + (0.0 if operator is None else operator[t])
        integral += 0.08 * (r[t] - y[t])
        u[t] = 0.8 * (r[t] - y[t]) + integral
        x = pole * x + 2 * (1 - pole) * (u[t - 3] if t >= 3 else 0.0)
    return {"t": np.arange(SAMPLES, dtype=float), "sp": r, "op": u, "pv": y}


def segment(r: Array, u: Array, y: Array) -> Segment:
    n, t = len(r), np.arange(len(r), dtype=float)
    return Segment(0, 1.0, t, r, u, y, np.zeros((n, 0)), np.ones(u.shape, dtype=bool), ("zoh",) * u.shape[1])


def is_computed(columns: dict[str, Array], digits: int = 15) -> bool:
    r, u, y = (np.round(columns[name][:, None], digits) for name in ("sp", "op", "pv"))
    return bool(computed_setpoints([segment(r, u, y)])[0])


def project(folder: Path, columns: dict[str, Array]) -> Project:
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    made = Project(
        time_unit="min",
        data={"files": ["record.csv"], "time": "t"},
        output=[{"name": "flow", "pv": "pv", "sp": "sp"}],
        input=[{"name": "valve", "op": "op"}],
        model=[{"output": "flow", "input": "valve", "tf": "2 exp(-3 s)/(10 s + 1)"}],
    )
    return Project.from_toml(made.to_toml(), folder)


def analysed(folder: Path, columns: dict[str, Array]) -> Result:
    return run(project(folder, columns))


def cascade(seed: int, size: float, every: int) -> Segment:
    """Slave 1/(5 s + 1), master PV 2/(30 s + 1) of slave PV; the master, PI, runs every so many samples.

    Its own set-point switches by `size`.
    """
    rng = np.random.default_rng(seed)
    w, v = (coloured(rng, SAMPLES, 1, [1, -a], [1], std)[:, 0] for a, std in ((0.95, 1.0), (0.9, 0.5)))
    asked = size * random_switching(rng, SAMPLES, 1, 100.0)[:, 0]
    r, y = np.zeros((2, SAMPLES, 2))
    u = np.zeros((SAMPLES, 1))
    x = z = outer = inner = demand = 0.0
    for t in range(SAMPLES):
        y[t] = x + v[t], z + w[t]
        if t % every == 0:
            outer += 0.4 * every / 30 * (asked[t] - y[t, 1])
            demand = 0.4 * (asked[t] - y[t, 1]) + outer
        r[t] = demand, asked[t]
        inner += 0.16 * (demand - y[t, 0])
        u[t] = 0.8 * (demand - y[t, 0]) + inner
        x += (1 - np.exp(-1 / 5)) * ((u[t - 1, 0] if t else 0.0) - x)
        z += (1 - np.exp(-1 / 30)) * (2 * y[t, 0] - z)
    return segment(r, u, y)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_a_function_of_pv_is_known_for_one(kind, seed):
    assert is_computed(inside(kind, seed))


@pytest.mark.parametrize(("kind", "digits"), [("mean", 2), ("tracking", 2), ("proportional", 3), ("filtered", 4)])
def test_it_is_known_in_rounded_records(kind, digits):
    assert is_computed(inside(kind, 1), digits)


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_refused_with_its_own_sentence(tmp_path, kind):
    result = analysed(tmp_path, inside(kind, 2))
    assert result.status == "refused"
    (reason,) = result.reasons
    assert reason.code == "no-excitation"
    assert reason.message.startswith("the set-point of flow follows PV: it is computed from it")
    assert "nothing moves the loop from outside" in reason.message


def test_none_of_twelve_filtered_records_is_answered(tmp_path):
    """Of thirty such records seventeen were once answered, eight of them with intervals that miss the truth."""
    assert {analysed(tmp_path, inside("filtered", seed)).status for seed in range(12)} == {"refused"}


def test_it_is_not_followed_over_time_either(tmp_path):
    followed = track(project(tmp_path, inside("filtered", 4)))
    assert followed.status == "refused"
    assert any("follows PV" in reason.message for reason in followed.reasons)


def test_an_operator_who_moves_it_too_is_answered(tmp_path):
    """Steps of +-1 now and then on top of what PV makes of it: part of its moves comes from outside."""
    operator = random_switching(np.random.default_rng(5), SAMPLES, 1, 60.0)[:, 0] - 1
    columns = inside("filtered", 5, operator)
    assert not is_computed(columns)
    result = analysed(tmp_path, columns)
    assert result.status == "ok"
    for parameter, true in zip(result.elements[0].parameters, [2.0, 10.0, 3.0], strict=True):
        assert abs(parameter.plant - true) < 4 * parameter.std_error


@pytest.mark.parametrize("every", [1, 10])
@pytest.mark.parametrize("seed", range(3))
def test_a_slave_counts_as_moved_where_its_master_is(seed, every):
    """Steps of the master's set-point a fifth as large as the disturbance's standard deviation are enough."""
    assert computed_setpoints([cascade(seed, 0.0, every)]).tolist() == [True, False]
    assert computed_setpoints([cascade(seed, 0.1, every)]).tolist() == [False, False]


def honest(kind: str, rng: np.random.Generator) -> Array:
    n, t = SAMPLES, np.arange(SAMPLES)
    levels = rng.standard_normal(n // 25).repeat(25)
    signals = {
        "steps": random_switching(rng, n, 1, 100.0)[:, 0],
        "levels": levels,
        "ramps": np.cumsum(levels) / 25,
        "binary": random_switching(rng, n, 1, 4.0)[:, 0],
        "periodic": np.tile(rng.standard_normal(30), n // 30),
        "sines": sum(np.sin(2 * np.pi * t / p) for p in (17, 40, 111, 200)),
        "walk": np.cumsum(rng.standard_normal(n)) / 10,
        "held": np.zeros(n),
    }
    return np.asarray(signals[kind], dtype=float)


@pytest.mark.parametrize("kind", ["steps", "levels", "ramps", "binary", "periodic", "sines", "walk", "held"])
@pytest.mark.parametrize("noise", [1.0, 0.1, 0.0])
@pytest.mark.parametrize("fast", [False, True])
def test_what_comes_from_outside_is_not_struck(kind, noise, fast):
    """Also where PV tells all about the set-point: without noise, or settled within the sample."""
    rng = np.random.default_rng(7)
    r = honest(kind, rng)
    v = noise * coloured(rng, SAMPLES, 1, [1, -0.9], [1], 1.0)[:, 0]
    y, u = np.zeros((2, SAMPLES))
    x = 0.0
    for t in range(SAMPLES):
        x = r[t] if fast else 0.9 * x + 0.1 * (r[t - 3] if t >= 3 else 0.0)
        y[t] = x + v[t]
        u[t] = r[t] - y[t]
    assert not is_computed({"sp": r, "op": u, "pv": y})


@pytest.mark.parametrize("std", [0.0, 0.3])
def test_two_loops_moved_by_operators_are_not_struck(std):
    assert computed_setpoints([segment_of(wood_berry(3, samples=2000, std=std))]).tolist() == [False, False]


def test_samples_of_pv_that_are_missing_do_not_hide_it():
    columns = inside("filtered", 6)
    columns["pv"][200:210] = np.nan
    columns["pv"][700] = np.nan
    assert is_computed(columns)


def test_one_of_two_is_said_and_the_other_answers(tmp_path):
    """Loops that do not touch each other: one moved by an operator, one by a function of its PV."""
    operator = random_switching(np.random.default_rng(8), SAMPLES, 1, 60.0)[:, 0] - 1
    moved, computed = inside("none", 8, operator), inside("filtered", 9)
    columns = moved | {f"{name}2": computed[name] for name in ("sp", "op", "pv")}
    pl.DataFrame(columns).write_csv(tmp_path / "record.csv")
    names = ["", "2"]
    made = Project(
        time_unit="min",
        data={"files": ["record.csv"], "time": "t"},
        output=[{"name": f"flow{k}", "pv": f"pv{k}", "sp": f"sp{k}"} for k in names],
        input=[{"name": f"valve{k}", "op": f"op{k}"} for k in names],
        model=[{"output": f"flow{k}", "input": f"valve{k}", "tf": "2 exp(-3 s)/(10 s + 1)"} for k in names],
        analysis={"worth_knowing_percent": 100},
    )
    result = run(Project.from_toml(made.to_toml(), tmp_path))
    assert result.status == "ok"
    (said,) = (note.message for note in result.notes if note.code == "setpoint-computed")
    assert said.startswith("the set-point of flow2 follows PV: it is computed from it")
    verdicts = {(e.output, e.input): e.verdict for e in result.elements}
    assert verdicts == {("flow", "valve"): "unchanged", ("flow2", "valve2"): "not identifiable"}
    assert "no set-point or measured disturbance that moves shows in" in result.elements[-1].reason


@pytest.mark.parametrize("seed", range(8))
def test_a_setpoint_that_is_a_copy_of_pv_moves_nothing(seed: int) -> None:
    """Under another tag, with the disturbance alone to move the loop; as one that moves, and with a sample missing."""
    v = coloured(np.random.default_rng(seed), SAMPLES, 1, [1, -0.9], [1], 1.0)
    record = inside("filtered", seed)
    y = record["pv"] + v[:, 0]
    columns = {
        "time": np.arange(SAMPLES),
        "sp": y,
        "op": record["op"],
        "pv": np.where(np.arange(SAMPLES) == 99, np.nan, y),
    }
    result = run(columns, loops=[Loop("T", pv="pv", sp="sp", op="op")], model={("T", "T"): "2 exp(-3 s)/(10 s + 1)"})
    assert result.status == "refused" and "follows PV" in result.reasons[0].message
