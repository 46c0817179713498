"""A loop whose set-point stands still is told only by what reaches it from elsewhere. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

import trueplant as tp
from trueplant.loop import PID, Controller, simulate
from trueplant.result import Element

H, N = 0.5, 3000
LAWS = [PID(Kc=0.8, Ti=5.0, sample_time=H), PID(Kc=-2.0, Ti=40.0, sample_time=H)]
LOOPS = [tp.Loop("F", pv="pv0", sp="sp0", op="op0"), tp.Loop("L", pv="pv1", sp="sp1", op="op1", kind="level")]


def verdicts(between: str, load: np.ndarray) -> dict[tuple[str, str], Element]:
    """Of a flow whose set-point moves and a level whose does not; `between` leads from the flow's OP to it."""
    rng = np.random.default_rng(1)
    plant = tp.TransferMatrix.of([["1.2 exp(-1 s)/(5 s + 1)", "0"], [between, "-0.02 exp(-0.2 s)/s"]], "min")
    r = np.column_stack([50 + 2 * (1 - (-1.0) ** np.cumsum(rng.random(N) < 1 / 120)), np.full(N, 55.0)])
    done = simulate(
        plant,
        Controller.diagonal(LAWS),
        r,
        H,
        noise=[0.1, 0.1],
        u0=[40.0, 50.0],
        y0=[50.0, 55.0],
        input_disturbance=np.column_stack([0 * load, load]),
        seed=4,
    )
    frame = {"time": done.t}
    for k in range(2):
        frame |= {f"sp{k}": done.r[:, k], f"pv{k}": done.y[:, k].round(3), f"op{k}": done.u[:, k].round(3)}
    result = tp.run(frame, loops=LOOPS, time_unit="min")
    return {(e.output, e.input[0]): e for e in result.elements}


@pytest.mark.parametrize("hours", [4, 24])
def test_a_periodic_load_makes_no_model_of_a_loop_that_nobody_moved(hours: int) -> None:
    """It was a grade A, ten times too slow."""
    found = verdicts("0", 0.4 * np.sin(2 * np.pi * np.arange(N) * H / (60 * hours)))
    assert found["F", "F"].verdict == "found"
    assert found["L", "L"].verdict == "not identifiable"
    assert "no set-point or measured disturbance that moves shows" in found["L", "L"].reason
    assert found["L", "L"].tf_plant is None


def test_what_reaches_a_loop_from_another_tells_its_elements() -> None:
    found = verdicts("0.02 exp(-0.5 s)/s", np.zeros(N))
    for place, truth in {("L", "L"): -0.02, ("L", "F"): 0.02}.items():
        assert found[place].verdict == "found"
        (slope,) = (p for p in found[place].parameters if p.name == "slope")
        assert slope.ci[0] < truth < slope.ci[1]
        assert slope.ci[1] - slope.ci[0] < 0.01
