"""Loads at the plant's input and output and measured disturbances: closed forms, other libraries, superposition."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from trueplant.errors import LoopError
from trueplant.loop import PID, Coloured, Controller, Filtered, Ramp, RandomWalk, Step, Valve, simulate
from trueplant.lti import TransferMatrix

MILL = TransferMatrix.of(
    [
        ["-0.58 exp(-0.68 s)/(2.5 s + 1)", "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"],
        ["2.2 exp(-0.6 s)/(6 s + 1)", "2.83 exp(-0.13 s)/(3.5 s + 1)"],
    ]
)
GD = TransferMatrix.of([["1.2 exp(-0.37 s)/(4 s + 1)"], ["-0.4 exp(-1.03 s)/(2 s + 1)"]])
STEADY = np.array([[-0.58, 4 * (1 - 0.9938)], [2.2, 2.83]])
H = 0.1


def law(scan: float | None = H) -> Controller:
    return Controller.diagonal([PID(Kc=-2.0, Ti=3.3, sample_time=scan), PID(Kc=0.42, Ti=5.2, sample_time=scan)])


# K/(T s + 1) under PI with Ti = T: the loop is b/s, with b = Kc K/T
GAIN, LAG, KC = 2.0, 5.0, 1.5
RATE = KC * GAIN / LAG
ONE, ONE_LAW = TransferMatrix.of([[f"{GAIN}/({LAG} s + 1)"]]), Controller.diagonal([PID(Kc=KC, Ti=LAG)])


def after(t: np.ndarray, start: float) -> np.ndarray:
    return np.maximum(t - start, 0.0)


def input_step(t: np.ndarray) -> np.ndarray:
    return GAIN / LAG * (np.exp(-t / LAG) - np.exp(-RATE * t)) / (RATE - 1 / LAG)


def output_ramp(t: np.ndarray) -> np.ndarray:
    """For a slope of 1."""
    return (1 - np.exp(-RATE * t)) / RATE


@pytest.mark.parametrize(
    ("load", "truth"),
    [
        ({"input_disturbance": Step(2.0, 0.7)}, lambda t: 0.7 * input_step(after(t, 2.0))),
        (
            {"v": Ramp(2.0, 8.0, 3.0)},
            lambda t: 0.5 * (output_ramp(after(t, 2.0)) - output_ramp(after(t, 8.0))),
        ),
        (
            {"d": Step(2.0, 0.7), "Gd": ONE},
            lambda t: 0.7 * input_step(after(t, 2.0)),
        ),
        (
            {"v": Filtered(ONE, Step(2.0, 0.7))},
            lambda t: 0.7 * input_step(after(t, 2.0)),
        ),
    ],
    ids=["step at the input", "ramp at the output", "measured step", "step through a model"],
)
def test_closed_forms_under_a_continuous_controller_with_second_order_error(load, truth):
    errors = []
    for h in (0.1, 0.05, 0.025):
        sim = simulate(ONE, ONE_LAW, np.zeros((round(20 / h), 1)), h, **load)
        errors.append(np.max(np.abs(sim.y[:, 0] - truth(sim.t))))
    assert errors[0] < 2e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)


def test_a_load_moves_a_loop_at_its_limit_as_if_it_were_open():
    pid = PID(Kc=KC, Ti=LAG, limits=(-0.1, 0.1), sample_time=H)
    sim = simulate(ONE, Controller.diagonal([pid]), np.zeros((800, 1)), H, input_disturbance=Step(1.0, 0.5))
    late = sim.t > 30
    assert np.allclose(sim.u[late], -0.1)
    assert np.allclose(sim.y[late, 0], 0.4 * GAIN, atol=1e-2)
    assert sim.y[-1, 0] == pytest.approx(0.4 * GAIN, abs=1e-6)
    assert np.array_equal(sim.w[:, 0], np.where(sim.t >= 1.0 - 1e-9, 0.5, 0.0))


def test_rational_2x2_plant_under_loads_agrees_with_scipy_and_python_control():
    num, den = [[[1.5], [0.4, 0.3]], [[-0.6], [2.0]]], [[[4.0, 1.0], [2.0, 3.0, 1.0]], [[3.0, 1.0], [5.0, 1.0]]]
    plant = TransferMatrix.of([["1.5/(4 s + 1)", "(0.4 s + 0.3)/(2 s^2 + 3 s + 1)"], ["-0.6/(3 s + 1)", "2/(5 s + 1)"]])
    q = Controller.diagonal([PID(Kc=0.8, Ti=4.0, sample_time=H), PID(Kc=0.7, Ti=5.0, sample_time=H)])
    r = np.zeros((600, 2))
    r[100:, 0] = 1.0
    loads = [Step(7.0, (0.3, -0.2)), Coloured((0.1, 0.2), 3.0, correlation=0.6)]
    slow = Ramp(10.0, 40.0, (0.5, -1.0))
    sim = simulate(plant, q, r, H, input_disturbance=[*loads, slow], v=Step(20.0, (0.4, 0.0)), seed=3)
    ramp = np.interp(sim.t, [10.0, 40.0], [0.0, 1.0])[:, None] * [0.5, -1.0]
    held = sim.u + sim.w - ramp
    expected = np.where((sim.t >= 20 - 1e-9)[:, None], [0.4, 0.0], 0.0)
    for i in range(2):
        for j in range(2):
            b, a, _ = cont2discrete((num[i][j], den[i][j]), H)
            expected[:, i] += lfilter(b.ravel(), a, held[:, j])
            system = control.tf(num[i][j], den[i][j])
            expected[:, i] += control.forced_response(system, sim.t, ramp[:, j]).outputs
    assert np.max(np.abs(sim.y - expected)) < 1e-9
    assert np.max(np.abs(sim.u)) > 0.5


@pytest.mark.parametrize("scan", [H, 3 * H], ids=["every step", "every third step"])
def test_loads_superpose_with_dead_times_off_the_grid(scan):
    r = np.zeros((900, 2))
    r[50:, 1] = 1.0
    given = {
        "input_disturbance": [Step(12.0, (0.2, -0.1)), Ramp(20.0, 60.0, (0.0, 0.5))],
        "v": [Coloured((0.1, 0.3), 4.0, correlation=-0.5, seed=1), Ramp(5.0, 30.0, 1.0)],
    }
    measured = {"d": [RandomWalk(0.2, seed=2), Step(33.0, 1.0)], "Gd": GD, "d_hold": "linear"}
    together = simulate(MILL, law(scan), r, H, **given, **measured)
    still = np.zeros_like(r)
    alone = [simulate(MILL, law(scan), r, H)]
    alone += [simulate(MILL, law(scan), still, H, **{place: one}) for place, many in given.items() for one in many]
    alone += [simulate(MILL, law(scan), still, H, **(measured | {"d": one})) for one in measured["d"]]
    for name in ("u", "y", "w", "v"):
        assert np.max(np.abs(getattr(together, name) - sum(getattr(one, name) for one in alone))) < 1e-10
    assert np.max(np.abs(together.d - alone[-1].d - alone[-2].d)) < 1e-12


def test_a_step_at_the_input_is_the_same_step_through_the_plant_at_the_output():
    r = np.zeros((900, 2))
    step = Step(11.0, (0.3, -0.4))
    one = simulate(MILL, law(), r, H, input_disturbance=step)
    other = simulate(MILL, law(), r, H, v=Filtered(MILL, step))
    assert np.max(np.abs(one.y - other.y)) < 1e-12
    assert np.max(np.abs(one.u - other.u)) < 1e-11
    assert np.max(np.abs(one.y)) > 0.1


def test_loads_act_behind_valve_and_limits():
    r = np.zeros((900, 2))
    r[50:] = 1.0
    given = {
        "limits": [(-1.0, 0.5), (-0.1, 0.3)],
        "valves": [Valve(backlash=0.05), Valve(stick=0.08)],
        "input_disturbance": [Step(30.0, (0.2, 0.1)), Ramp(40.0, 80.0, (0.1, -0.1)), Coloured(0.02, seed=4)],
        "v": Coloured(0.05, 2.0),
    }
    sim = simulate(MILL, law(), r, H, **given)
    assert sim.u[:, 0].min() == -1.0 and sim.u[:, 1].max() == 0.3
    at = np.column_stack([valve.positions(sim.u[:, i], 0.0) for i, valve in enumerate(given["valves"])])
    ramp = np.interp(sim.t, [40.0, 80.0], [0.0, 1.0])[:, None] * [0.1, -0.1]
    # on a grid ten times as fine, where held signals hold and the ramp is a ramp
    fine = np.repeat(at + sim.w - ramp, 10, axis=0), np.interp(np.arange(9000) / 10, np.arange(900), ramp[:, 0])
    bent = np.column_stack([fine[1], -fine[1]])
    held = simulate(MILL, None, np.zeros((9000, 2)), H / 10, u=fine[0], record_every=10)
    sloped = simulate(MILL, None, np.zeros((9000, 2)), H / 10, u=bent, record_every=10)
    assert np.max(np.abs(sim.y - sim.v - held.y - sloped.y)) < 1e-3
    exact = simulate(MILL, None, np.zeros((900, 2)), H, u=at + sim.w - ramp).y
    exact = (
        exact
        + simulate(
            MILL, None, np.zeros((900, 2)), H, u=np.zeros((900, 2)), input_disturbance=given["input_disturbance"][1]
        ).y
    )
    assert np.max(np.abs(sim.y - sim.v - exact)) < 1e-10


@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_measured_disturbance_in_closed_form(hold):
    """A straight line from t = 2 on, recorded every time unit: held, it is a staircase."""
    t = np.arange(60.0)
    d = after(t, 2.0)[:, None]
    gd = TransferMatrix.of([["3 exp(-1.4 s)/(6 s + 1)"]])
    sim = simulate(ONE, None, np.zeros((60, 1)), 1.0, u=np.zeros((60, 1)), d=d, Gd=gd, d_hold=hold)
    if hold == "linear":
        x = after(t, 3.4)
        expected = 3 * (x - 6 * (1 - np.exp(-x / 6)))
    else:
        expected = sum(3 * (1 - np.exp(-after(t, k + 1.4) / 6)) for k in range(3, 60))
    assert np.max(np.abs(sim.y[:, 0] - expected)) < 1e-10
    assert np.array_equal(sim.d, d)


@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_the_record_does_not_depend_on_the_steps_between_its_instants(hold):
    """Sampled controllers: what acts is the same function of time, however finely it is simulated."""
    r = np.ones((300, 2))
    given = {
        "d": [Coloured(0.5, 6.0), Step(40.0, 1.0)],
        "Gd": GD,
        "d_hold": hold,
        "input_disturbance": [Coloured((0.1, 0.2), 2.0, correlation=0.4), Step(50.0, 0.3), Ramp(20.0, 60.0, 0.5)],
        "v": [RandomWalk(0.05), Coloured(0.1, c=(1.0, 0.5), a=(1.0, -0.7))],
        "seed": 5,
    }
    q = law(0.5)
    coarse = simulate(MILL, q, r, 0.5, **given)
    fine = simulate(MILL, q, np.repeat(r, 4, axis=0), 0.125, record_every=4, **given)
    for name in ("u", "y", "d", "v", "w"):
        assert np.max(np.abs(getattr(coarse, name) - getattr(fine, name))) < 1e-9, name


def test_figure_1_whole():
    """r, Q, G, Ghat, a load through its own model and noise: e = (G - Ghat) u + v + noise, and (19) at rest."""
    model = TransferMatrix(
        tuple(tuple(g * (1.2 if i == j else 0.8) for j, g in enumerate(row)) for i, row in enumerate(MILL.elements))
    )
    r = np.tile([1.0, -0.5], (6000, 1))
    own = Filtered(TransferMatrix.of([["1/(8 s + 1)"], ["0.5/(3 s + 1)"]]), Coloured(0.4, 5.0))
    sim = simulate(MILL, law(), r, H, v=own, model=model, noise=(0.02, 0.01), seed=2)
    difference = TransferMatrix(
        tuple(
            tuple(g - m for g, m in zip(a, b, strict=True)) for a, b in zip(MILL.elements, model.elements, strict=True)
        )
    )
    gap = simulate(difference, None, np.zeros_like(r), H, u=sim.u).y
    assert np.max(np.abs(sim.e - gap - sim.v - (sim.y - sim.y_true))) < 1e-9
    assert 0.05 < np.std(sim.v[:, 0]) < 1.0
    still = simulate(MILL, law(), r, H, model=model)
    wanted = (np.eye(2) - STEADY * [[1.2, 0.8], [0.8, 1.2]] @ np.linalg.inv(STEADY)) @ [1.0, -0.5]
    assert np.allclose(still.e[-1], wanted, atol=1e-6)
    with pytest.raises(LoopError, match="no model"):
        _ = simulate(MILL, law(), r[:10], H).e


def test_a_model_may_have_measured_disturbances():
    both = TransferMatrix(tuple((*a, *b) for a, b in zip(MILL.elements, GD.elements, strict=True)))
    given = {"d": Coloured(0.5, 6.0), "Gd": GD, "d_hold": "linear", "u0": (3.0, 4.0), "y0": (50.0, 60.0)}
    r = np.tile([51.0, 60.0], (400, 1))
    assert np.max(np.abs(simulate(MILL, law(), r, H, model=both, **given).e)) < 1e-10
    blind = simulate(MILL, law(), r, H, model=MILL, **given)
    assert np.max(np.abs(blind.e - blind.v)) < 1e-10


def test_noise_has_its_colour_and_correlation():
    n = 200_000
    flat = np.zeros((n, 2))
    v = simulate(MILL, None, flat, 0.5, u=flat, v=Coloured((0.7, 2.0), 3.0, correlation=0.8), seed=1).v
    assert np.allclose(np.std(v, axis=0), (0.7, 2.0), rtol=0.02)
    assert np.corrcoef(v.T)[0, 1] == pytest.approx(0.8, abs=0.02)
    assert np.corrcoef(v[6:, 0], v[:-6, 0])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.02)
    moves = np.diff(simulate(MILL, None, flat, 0.5, u=flat, v=RandomWalk((0.1, 0.3), -0.5)).v, axis=0)
    assert np.allclose(np.std(moves, axis=0), np.array([0.1, 0.3]) * np.sqrt(0.5), rtol=0.01)
    assert np.corrcoef(moves.T)[0, 1] == pytest.approx(-0.5, abs=0.01)
    # held white noise through a lag: variance (1 - a)/(1 + a)
    shaped = Filtered(TransferMatrix.of([["1/(4 s + 1)", "0"], ["0", "1/(s + 1)"]]), Coloured(1.0))
    v = simulate(MILL, None, flat, 0.5, u=flat, v=shaped, seed=2).v
    a = np.exp([-0.5 / 4, -0.5])
    assert np.allclose(np.var(v, axis=0), (1 - a) / (1 + a), rtol=0.03)


def test_each_load_has_random_numbers_of_its_own():
    r = np.zeros((200, 2))

    def run(**more):
        return simulate(MILL, law(), r, H, noise=0.1, **more)

    noise = run(seed=7).y - run(seed=7).y_true
    loaded = run(seed=7, v=Coloured(0.3), input_disturbance=Coloured(0.2))
    assert np.allclose(loaded.y - loaded.y_true, noise, atol=1e-12)
    assert np.array_equal(loaded.v, run(seed=7, v=Coloured(0.3)).v)
    assert not np.array_equal(loaded.v, run(seed=8, v=Coloured(0.3)).v)
    assert np.array_equal(run(seed=1, v=Coloured(0.3, seed=5)).v, run(seed=2, v=Coloured(0.3, seed=5)).v)
    twice = run(seed=7, v=[Coloured(0.3), Coloured(0.3)]).v
    assert np.std(twice) < 0.3 * 1.7


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"v": Step(1.0, (1.0, 2.0, 3.0))}, "size must be a finite number, or 2"),
        ({"v": [Step(1.0, 1.0), np.zeros((10, 2))]}, "not a list of both"),
        ({"v": Coloured(1.0, correlation=((1.0, 0.5), (0.4, 1.0)))}, "symmetric"),
        ({"v": Coloured(1.0, correlation=1.5)}, "eigenvalue below 0"),
        ({"v": Filtered(GD.columns(0), Step(1.0, (1.0, 1.0)))}, "size must be"),
        ({"v": Filtered(TransferMatrix.of([["1/(s + 1)"]]), Step(1.0, 1.0))}, "1 outputs and must have 2"),
        ({"d": Step(1.0, 1.0)}, "both d and Gd"),
        ({"d": Step(1.0, 1.0), "Gd": GD, "d_hold": "spline"}, "d_hold must be"),
        ({"model": TransferMatrix.of([["1/(s + 1)"], ["1/(s + 1)"]])}, "model has 1 inputs"),
    ],
)
def test_loads_that_cannot_be_are_named(given, said):
    with pytest.raises(LoopError, match=said):
        simulate(MILL, law(), np.zeros((10, 2)), H, **given)


def test_settings_that_cannot_be_are_named():
    with pytest.raises(LoopError, match="end after it starts"):
        Ramp(3.0, 3.0, 1.0)
    with pytest.raises(LoopError, match="not by both"):
        Coloured(1.0, time_constant=2.0, a=(1.0, -0.5))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"record_every": 0}, "record_every must be a whole number from 1 on"),
        ({"record_every": 1.5}, "record_every must be"),
        ({"seed": "a"}, "seed must be a whole number from 0 on"),
        ({"noise": -1.0}, "noise must not be below 0"),
        ({"quantisation": -0.1}, "quantum must not be below 0"),
    ],
)
def test_numbers_that_cannot_be_are_refused(given, said):
    with pytest.raises(LoopError, match=said):
        simulate(TransferMatrix.of([["1/(s + 1)"]]), None, np.zeros((9, 1)), 1.0, u=np.zeros((9, 1)), **given)
    with pytest.raises(LoopError, match="time of a step"):
        Step(np.nan, 1.0)
