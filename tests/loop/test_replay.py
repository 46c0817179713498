"""The declared laws of real rigs write what the rigs recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, replay, simulate
from trueplant.lti import TransferMatrix, tf


def columns(path: Path) -> dict[str, np.ndarray]:
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


@pytest.mark.real
@pytest.mark.parametrize("run", ["pid_short_01", "pid_short_02"])
def test_continuous_pid_of_the_heater_rig_writes_its_recorded_op(real_data, run):
    data = columns(real_data / "tclab_pid" / f"{run}.csv")
    settings = [
        (1.4348704739, 0.016388661803, -9.1190933222, 46.284766102),
        (2.1822880755, 0.0111806588364, -30.919076861, 103.18428318),
    ]
    controller = Controller.diagonal(
        [PID(form="parallel", Kp=p, Ki=i, Kd=d, Tf=f, limits=(0, 100)) for p, i, d, f in settings]
    )
    r, y, op = (np.column_stack([data[f"{name}{k}"] for k in (1, 2)]) for name in ("sp", "pv", "op"))
    rms = np.sqrt(np.mean((replay(controller, r, y, 0.25) - op) ** 2, axis=0))
    assert np.all(rms < 0.003)


def oven_counts(temperature: np.ndarray) -> np.ndarray:
    resistance = 11800 * np.exp(3977 * (1 / (temperature + 273.15) - 1 / (20.45 + 273.15)))
    return 1023 * resistance / (9853 + resistance)


@pytest.mark.real
@pytest.mark.parametrize(
    ("run", "p", "i", "d"),
    [(2, 7, 0, 0), (3, 5, 0, 0), (4, 4, 0, 0), (5, 4, 0.1, 0), (6, 4, 0.2, 0), (7, 4, 0.4, 0), (8, 4, 0.4, 0.1)],
)
def test_oven_law_on_counts_writes_its_recorded_op(real_data, run, p, i, d):
    data = columns(real_data / "pid_oven" / f"20180205-pid-oven-tuning_run{run}.csv")
    law = PID(
        form="parallel",
        Kp=p,
        Ki=i,
        Kd=d,
        action="direct",
        derivative_on="pv",
        anti_windup="clamp",
        limits=(0, 65),
        sample_time=1.0,
        pv_transform=oven_counts,
    )
    op = replay(Controller.diagonal([law]), data["sp"][:, None], data["pv"][:, None], 1.0)[:, 0]
    # PV is recorded to 0.001 degC, which is 0.0114 counts: that rounding times Kp bounds what can be reached
    assert np.sqrt(np.mean((op - data["op"]) ** 2)) < 0.025
    assert np.max(np.abs(op - data["op"])) < 0.05


PLANT = TransferMatrix.of([["1.5 exp(-0.33 s)/(3 s + 1)"]])


@pytest.mark.parametrize(
    "entry",
    [
        PID(Kc=0.8, Ti=4.0, Td=0.7, sample_time=0.1, limits=(-0.2, 0.9), anti_windup="back-calculation"),
        PID(Kc=0.8, Ti=4.0, Td=0.7, sample_time=0.5, limits=(-0.2, 0.9), anti_windup="clamp", derivative_on="pv"),
        PID(form="series", Kc=0.8, Ti=4.0, Td=0.7, sample_time=0.1, setpoint_filter=tf("1/(s + 1)")),
    ],
)
def test_replay_of_a_simulated_sampled_loop_is_exact(entry):
    controller = Controller.diagonal([entry])
    r = np.concatenate([np.zeros(10), np.ones(200), np.zeros(190)])[:, None]
    noise = 0.01 * np.random.default_rng(1).standard_normal(r.shape)
    noise[0] = 0.0  # the loop is at rest when the record begins
    sim = simulate(PLANT, controller, r, 0.1, noise=noise)
    assert np.max(np.abs(replay(controller, r, sim.y, 0.1, first=0.0) - sim.u)) < 1e-12


def test_replay_takes_over_the_first_op_without_a_bump():
    controller = Controller.diagonal([PID(Kc=0.8, Ti=4.0, Td=0.7)])
    r, y = np.full((20, 1), 3.0), np.full((20, 1), 2.0)
    op = replay(controller, r, y, 0.5, first=[42.0])
    assert np.allclose(op[:, 0], 42 + 0.8 / 4 * 0.5 * np.arange(20), atol=1e-12)


def test_linear_hold_replays_a_smooth_continuous_pv_with_second_order():
    # PV a sine, law PI: the integral is known
    law = Controller.diagonal([PID(Kc=2.0, Ti=1.5)])

    def error(h: float) -> float:
        t = np.arange(round(10 / h)) * h
        y = np.sin(t)
        op = replay(law, np.zeros((t.size, 1)), y[:, None], h, hold="linear")[:, 0]
        return float(np.max(np.abs(op + 2 * y + 2 / 1.5 * (1 - np.cos(t)))))

    assert error(0.1) < 3e-3
    assert np.log2(error(0.1) / error(0.05)) == pytest.approx(2, abs=0.1)


def test_transform_without_a_value_is_named():
    law = PID(Kc=1.0, pv_transform=lambda pv: np.where(np.asarray(pv) > 0, np.sqrt(np.abs(pv)), np.nan))
    with pytest.raises(LoopError, match="no finite value"):
        replay(Controller.diagonal([law]), np.ones((5, 1)), np.full((5, 1), -1.0), 1.0)
