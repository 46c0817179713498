"""Records with OP at its limits for long, and records of which a fifth can be used: answered, and answered rightly.

All are simulated. `benchmarks/bench_limits.py` measures refusals and coverage over many of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.chance import most
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from trueplant import Loop, run
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix, to_formula
from trueplant.record import Segment
from trueplant.study import levels
from trueplant.study.data.excitation import excited

LAG = TransferMatrix.of([["2 exp(-3.4 s)/(12 s + 1)"]], "min")
TRUTH = (2.0, 12.0, 3.4)
SAMPLES = 6000


def one_loop(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    v = coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.15)
    law = Controller.diagonal([PID(Kc=0.8, Ti=12.0, sample_time=1.0)])
    s = simulate(LAG, law, random_switching(rng, SAMPLES, 1, 60.0), 1.0, v=v)
    return {"time": s.t, "sp": s.r[:, 0] + 50, "op": s.u[:, 0] + 40, "pv": s.y[:, 0] + 50}


def bursts(rng: np.random.Generator, good: int) -> np.ndarray:
    """(SAMPLES,) True in stretches of that mean length, four times as far apart."""
    length = rng.geometric(1 / good, 600), rng.geometric(1 / (4 * good), 600)
    return np.repeat(np.tile([True, False], 600), np.column_stack(length).ravel())[:SAMPLES]


def left_over(kind: str, seed: int) -> dict[str, Any]:
    record, rng = one_loop(seed), np.random.default_rng([1, seed])
    if kind == "rows":
        rows = bursts(rng, 60)
        return {name: x[rows] for name, x in record.items()}
    if kind == "OP":
        return record | {"op": np.where(bursts(np.random.default_rng([2, seed]), 60), record["op"], np.nan)}
    good = rng.random(SAMPLES) < 0.2 if kind == "scattered" else bursts(rng, 15)
    return record | {"pv": np.where(good, record["pv"], np.nan)}


@pytest.mark.parametrize("kind", ["PV", "scattered", "OP", "rows"])
def test_a_record_of_which_a_fifth_is_usable_is_used(kind: str) -> None:
    record = left_over(kind, 3)
    result = run(
        record,
        loops=[Loop("T", pv="pv", sp="sp", op="op")],
        model={("T", "T"): to_formula(LAG[0, 0], digits=12)},
        time_unit="min",
    )
    assert result.status == "ok"
    (element,) = result.elements
    assert element.verdict != "changed"
    for p, true in zip(element.parameters, TRUTH, strict=True):
        assert p.plant is not None and p.std_error is not None
        assert abs(p.plant - true) < 4 * p.std_error
        # nothing is known better than all of the record would tell, and the gain is known at all
        assert p.std_error > 0.002 * true
    assert element.parameters[0].std_error < 0.6


@pytest.mark.parametrize(("missing", "level"), [(0.0, 0.05), (0.4, 0.1)])
def test_setpoints_that_nothing_follows_pass_for_excitation_no_more_often_than_chance(
    missing: float, level: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """200 records of 20 pieces, an AR(1) output that no set-point reaches, at the 5 % level.

    Where 40 % of the samples are missing here and there, few have a past: then up to twice as often.
    """
    monkeypatch.setattr(levels, "EXCITED", 0.05)
    alarms = 0
    for seed in range(200):
        rng = np.random.default_rng([7, seed])
        y = coloured(rng, 2000, 1, [1, -0.9], [1], 1.0)
        y[rng.random((2000, 1)) < missing] = np.nan
        r = random_switching(rng, 2000, 1, 20.0)
        pieces = [_piece(r[a : a + 100], y[a : a + 100], float(a)) for a in range(0, 2000, 100)]
        alarms += excited(pieces, [np.zeros(1, dtype=bool)] * len(pieces))
    assert 2 <= alarms <= most(200, level)


def _piece(r: np.ndarray, y: np.ndarray, start: float) -> Segment:
    n = len(r)
    free = np.ones((n, 1), dtype=bool)
    return Segment(0, 1.0, start + np.arange(n), r, np.zeros((n, 1)), y, np.zeros((n, 0)), free, ("zoh",))


def test_pieces_tell_together_what_no_piece_tells_alone() -> None:
    """Set-points show as a fifth of the noise: hidden in a hundred samples, clear in two hundred times as many."""
    rng = np.random.default_rng(8)
    r = random_switching(rng, 20_000, 1, 20.0)
    y = 0.2 * np.concatenate([np.zeros((3, 1)), r[:-3]]) + rng.standard_normal((20_000, 1))
    pieces = [_piece(r[a : a + 100], y[a : a + 100], float(a)) for a in range(0, 20_000, 100)]
    none = [np.zeros(1, dtype=bool)]
    assert np.mean([excited([piece], none) for piece in pieces]) < 0.05
    assert excited(pieces, none * len(pieces))


@pytest.mark.slow
def test_two_loops_at_their_limits_for_long_are_answered_rightly() -> None:
    """Wood-Berry, each OP at a limit in 30 to 40 % of the samples; 20 records, of which none is refused.

    240 intervals of 95 %: with the correlation within a record, 90 % is four standard errors below.
    """
    hits, total = 0, 0
    for seed in range(20):
        rng = np.random.default_rng([9, seed])
        r = random_switching(rng, 1500, 2, 40.0)
        v = coloured(rng, 1500, 2, [1, -0.8], [1], 0.1)
        free = simulate(WOOD_BERRY, BLT, r, 1.0, v=v)
        limits = np.quantile(free.u, [0.2, 0.8], axis=0).T
        s = simulate(WOOD_BERRY, BLT, r, 1.0, v=v, limits=limits)
        at = (s.u <= limits[:, 0]) | (s.u >= limits[:, 1])
        assert np.all(at.mean(axis=0) > 0.25) and at.any(axis=1).mean() > 0.5
        names = ("top", "bottom")
        frame = {"time": s.t}
        for k, name in enumerate(names):
            frame |= {f"sp_{name}": s.r[:, k], f"op_{name}": s.u[:, k], f"pv_{name}": s.y[:, k]}
        loops = [
            Loop(n, pv=f"pv_{n}", sp=f"sp_{n}", op=f"op_{n}", op_limits=tuple(map(float, limits[k])))
            for k, n in enumerate(names)
        ]
        model = {(a, b): to_formula(WOOD_BERRY[i, j], 12) for i, a in enumerate(names) for j, b in enumerate(names)}
        result = run(frame, loops=loops, model=model, time_unit="min", analysis={"method": "direct"})
        assert result.status == "ok"
        for element in result.elements:
            for p in element.parameters:
                if p.plant is not None and p.ci is not None:
                    total += 1
                    hits += p.ci[0] <= p.model <= p.ci[1]
    assert total > 200
    assert hits >= 0.9 * total
