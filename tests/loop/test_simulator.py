"""The loop in time against closed forms, other libraries and independent recursions."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from trueplant.errors import FormulaError, LoopError, UnstableLoop
from trueplant.loop import PID, Controller, Linear, simulate, step_disturbance
from trueplant.lti import TransferMatrix, tf

MILL = TransferMatrix.of(
    [
        ["-0.58 exp(-0.68 s)/(2.5 s + 1)", "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"],
        ["2.2 exp(-0.6 s)/(6 s + 1)", "2.83 exp(-0.13 s)/(3.5 s + 1)"],
    ]
)
MILL_PI = (PID(Kc=-2.0, Ti=3.3), PID(Kc=0.42, Ti=5.2))


def unit_steps(steps: int, n: int = 1) -> np.ndarray:
    r = np.zeros((steps, n))
    r[:, 0] = 1.0
    return r


def test_pi_that_cancels_the_lag_gives_a_first_order_loop_with_second_order_error():
    plant, controller = TransferMatrix.of([["2/(5 s + 1)"]]), Controller.diagonal([PID(Kc=1.5, Ti=5.0)])
    errors = []
    for h in (0.1, 0.05, 0.025):
        sim = simulate(plant, controller, unit_steps(round(20 / h)), h)
        errors.append(np.max(np.abs(sim.y[:, 0] - (1 - np.exp(-2 * 1.5 / 5 * sim.t)))))
    assert errors[0] < 2e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    "entries",
    [
        MILL_PI,
        (
            PID(Kc=-2.0, Ti=3.3, Td=0.3, setpoint_weight=0.3, derivative_on="pv", setpoint_filter=tf("1/(0.5 s + 1)")),
            Linear(tf("0.42 (5.2 s + 1)/(5.2 s (0.05 s + 1))")),
        ),
    ],
    ids=["PI", "two degrees of freedom"],
)
def test_continuous_controllers_converge_with_second_order(entries):
    def response(h: float) -> np.ndarray:
        sim = simulate(MILL, Controller.diagonal(entries), unit_steps(round(12 / h), 2), h)
        return sim.y[:: round(0.02 / h)]

    exact = response(0.00125)
    fine, coarse = (np.max(np.abs(response(h) - exact)) for h in (0.01, 0.02))
    assert coarse < 2e-3
    assert 1.7 < np.log2(coarse / fine) < 2.4


def test_step_disturbance_under_a_continuous_controller_converges_with_second_order():
    plant, controller = TransferMatrix.of([["2/(5 s + 1)"]]), Controller.diagonal([PID(Kc=1.5, Ti=5.0)])
    errors = []
    for h in (0.1, 0.05):
        steps = round(20 / h)
        sim = simulate(plant, controller, np.zeros((steps, 1)), h, v=step_disturbance(steps, h, 1.0, 1.0))
        truth = np.where(sim.t >= 1 - 1e-9, np.exp(-0.6 * np.maximum(sim.t - 1, 0)), 0.0)
        errors.append(np.max(np.abs(sim.y[:, 0] - truth)))
    assert errors[0] < 2e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_rational_loop_agrees_with_python_control():
    g = control.tf([3.0, 1.0], np.polymul([4.0, 1.0, 1.0], [2.0, 1.0]))
    q = control.tf([1.2 * 3, 1.2], [3.0, 0.0]) + control.tf([0.8, 0.0], [0.1, 1.0])
    h = 0.005
    t = np.arange(4000) * h
    expected = control.forced_response(control.feedback(g * q), t, np.ones(t.size)).outputs
    plant = TransferMatrix.of([["(3 s + 1)/((4 s^2 + s + 1)(2 s + 1))"]])
    law = PID(form="parallel", Kp=1.2, Ki=0.4, Kd=0.8, Tf=0.1)
    sim = simulate(plant, Controller.diagonal([law]), unit_steps(t.size), h)
    assert np.max(np.abs(sim.y[:, 0] - expected)) < 1e-4


@pytest.mark.parametrize("dead_time", [0.0, 0.3])
def test_output_is_the_plant_applied_to_the_recorded_op(dead_time):
    h, num, den = 0.1, [1.0, 2.0], [3.0, 1.0, 0.5]
    plant = TransferMatrix.of([[f"(s + 2) exp(-{dead_time} s)/(3 s^2 + s + 0.5)"]])
    sim = simulate(plant, Controller.diagonal([PID(Kc=0.1, Ti=3.0, sample_time=0.1)]), unit_steps(400), h)
    b, a, _ = cont2discrete((num, den), h)
    delayed = np.concatenate([np.zeros(round(dead_time / h)), sim.u[:, 0]])[: sim.t.size]
    assert np.max(np.abs(sim.y[:, 0] - lfilter(b.ravel(), a, delayed))) < 1e-11


@pytest.mark.parametrize(("dead_time", "samples"), [(0.0, 1), (0.1, 2), (0.25, 3), (0.3, 4)])
def test_pv_is_read_before_op_is_written_whatever_the_dead_time(dead_time, samples):
    """A gain: what was written at the instant itself, or a whole dead time before, is seen in the next sample."""
    plant = TransferMatrix.of([[f"2 exp(-{dead_time} s)"]])
    sim = simulate(plant, Controller.diagonal([PID(Kc=0.02, Ti=0.2, sample_time=0.1)]), unit_steps(200), 0.1)
    np.testing.assert_allclose(sim.y[samples:, 0], 2 * sim.u[:-samples, 0], atol=1e-12)
    assert np.all(sim.y[:samples] == 0)


def test_fractional_dead_time_of_an_integrator_in_closed_form():
    # one step of OP: slope K after the dead time, at instants that do not meet it
    plant = TransferMatrix.of([["0.5 exp(-0.77 s)/s"]])
    controller = Controller.diagonal([PID(Kc=2.0, sample_time=10.0)])
    sim = simulate(plant, controller, unit_steps(90), 0.1)
    assert np.allclose(sim.u[:, 0], 2.0)
    assert np.max(np.abs(sim.y[:, 0] - np.maximum(sim.t - 0.77, 0.0))) < 1e-12


def test_sampled_pid_is_the_documented_recursion():
    kc, ti, td, alpha, scan, h = 0.8, 4.0, 0.7, 0.1, 0.5, 0.1
    entry = PID(Kc=kc, Ti=ti, Td=td, alpha=alpha, sample_time=scan, derivative_on="pv", setpoint_weight=0.6)
    sim = simulate(
        TransferMatrix.of([["1.5 exp(-0.33 s)/(3 s + 1)"]]), Controller.diagonal([entry]), unit_steps(200), h
    )
    r, y, u = sim.r[::5, 0], sim.y[::5, 0], sim.u[:, 0]
    integral = np.cumsum(kc / ti * scan * (r - y))
    lag = alpha * td
    derivative = lfilter([kc * td / (lag + scan), -kc * td / (lag + scan)], [1.0, -lag / (lag + scan)], -y)
    assert np.max(np.abs(u[::5] - (kc * (0.6 * r - y) + integral + derivative))) < 1e-12
    assert np.array_equal(u, np.repeat(u[::5], 5))


def test_sampled_linear_law_equals_the_pid_it_writes_out():
    plant = TransferMatrix.of([["1.5 exp(-0.33 s)/(3 s + 1)"]])
    pid = PID(Kc=0.8, Ti=4.0, Td=0.7, form="series", sample_time=0.2)
    linear = Linear(tf("0.8 (4 s + 1)(0.7 s + 1)/(4 s (0.07 s + 1))"), sample_time=0.2)
    one, other = (simulate(plant, Controller.diagonal([q]), unit_steps(300), 0.1) for q in (pid, linear))
    assert np.max(np.abs(one.u - other.u)) < 1e-10


def test_operating_point_shifts_signals_and_nothing_else():
    controller = Controller.diagonal(
        [PID(Kc=-2.0, Ti=3.3, setpoint_weight=0.2), PID(Kc=0.42, Ti=5.2, Td=0.1, derivative_on="pv")]
    )
    deviation = simulate(MILL, controller, unit_steps(500, 2), 0.02)
    u0, y0 = np.array([65.0, 45.0]), np.array([70.0, 150.0])
    absolute = simulate(MILL, controller, y0 + unit_steps(500, 2), 0.02, u0=u0, y0=y0)
    assert np.allclose(absolute.y - y0, deviation.y, atol=1e-10)
    assert np.allclose(absolute.u - u0, deviation.u, atol=1e-10)


def test_anti_windup_bounds_the_integral_and_shortens_the_overshoot():
    plant = TransferMatrix.of([["exp(-s)/(10 s + 1)"]])

    def overshoot(kind: str) -> float:
        entry = PID(Kc=5.0, Ti=5.0, limits=(-1.2, 1.2), anti_windup=kind, sample_time=0.1)
        sim = simulate(plant, Controller.diagonal([entry]), unit_steps(800), 0.1)
        assert sim.u.max() <= 1.2
        assert sim.u.min() >= -1.2
        return float(sim.y.max() - 1)

    assert overshoot("clamp") < 0.8 * overshoot("none")
    assert overshoot("back-calculation") < 0.8 * overshoot("none")


def test_noise_quantum_and_disturbances_enter_where_they_are_declared():
    controller = Controller.diagonal([PID(Kc=-2.0, Ti=3.3, sample_time=0.1), PID(Kc=0.42, Ti=5.2, sample_time=0.1)])
    steps = 3000
    gd = TransferMatrix.of([["1.2/(4 s + 1)"], ["0"]])
    d = step_disturbance(steps, 0.1, 50.0, 1.0)
    arguments = {"Gd": gd, "d": d, "quantisation": 0.05, "spikes": (0.01, 3.0), "seed": 4}
    sim = simulate(MILL, controller, unit_steps(steps, 2), 0.1, noise=(0.2, 0.1), **arguments)
    again = simulate(MILL, controller, unit_steps(steps, 2), 0.1, noise=(0.2, 0.1), **arguments)
    assert np.array_equal(sim.y, again.y)
    added = sim.y - sim.y_true
    usual = np.abs(added) < 1.0
    assert np.all(np.abs(np.std(np.where(usual, added, 0), axis=0) - [0.2, 0.1]) < 0.02)
    assert 0.004 < np.mean(np.abs(added) > 1.0) < 0.01
    assert np.median(np.abs(sim.y / 0.05 - np.round(sim.y / 0.05))) < 1e-9
    assert sim.v[-1, 0] == pytest.approx(1.2)
    unforced = sim.y_true - sim.v
    open_loop = simulate(MILL, None, np.zeros((steps, 2)), 0.1, u=sim.u)
    assert np.max(np.abs(unforced - open_loop.y)) < 1e-10


def test_right_half_plane_zero_answers_the_wrong_way_first():
    sim = simulate(TransferMatrix.of([["(1 - 4 s)/(2 s + 1)^2"]]), None, np.zeros((200, 1)), 0.1, u=np.ones((200, 1)))
    t = sim.t
    truth = 1 - np.exp(-t / 2) * (1 + 1.5 * t)
    assert np.max(np.abs(sim.y[:, 0] - truth)) < 1e-10


def test_unusable_requests_are_named():
    controller = Controller.diagonal(MILL_PI)
    with pytest.raises(LoopError, match="r must have shape"):
        simulate(MILL, controller, np.zeros(10), 0.1)
    with pytest.raises(LoopError, match="whole multiple of the step"):
        simulate(
            TransferMatrix.of([["1/(s + 1)"]]), Controller.diagonal([PID(Kc=1, sample_time=0.25)]), unit_steps(9), 0.1
        )
    with pytest.raises(LoopError, match="derivative without a filter"):
        simulate(
            TransferMatrix.of([["1/(s + 1)"]]),
            Controller.diagonal([PID(form="parallel", Kp=1, Kd=1)]),
            unit_steps(9),
            0.1,
        )
    with pytest.raises(FormulaError, match=r"element \(1, 1\)"):
        simulate(TransferMatrix.of([["s"]]), Controller.diagonal([PID(Kc=1)]), unit_steps(9), 0.1)
    with pytest.raises(UnstableLoop, match="runs away"):
        simulate(TransferMatrix.of([["1/(s + 1)"]]), Controller.diagonal([PID(Kc=-90, Ti=1)]), unit_steps(9000), 0.1)
