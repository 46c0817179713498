"""Whether loops are stable: dead times, integrators, unstable plants, scans; against roots found otherwise."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from trueplant.errors import IllPosedLoop, LoopError, SignConflict, UnstableLoop
from trueplant.loop import PID, Controller, Linear, check_loop, simulate, unstable_poles
from trueplant.lti import TransferMatrix, tf

MILL = TransferMatrix.of(
    [
        ["-0.58 exp(-0.68 s)/(2.5 s + 1)", "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"],
        ["2.2 exp(-0.6 s)/(6 s + 1)", "2.83 exp(-0.13 s)/(3.5 s + 1)"],
    ]
)
MILL_PI = Controller.diagonal([PID(Kc=-2.0, Ti=3.3), PID(Kc=0.42, Ti=5.2)])


def one(plant: str, *entries) -> tuple[TransferMatrix, Controller]:
    return TransferMatrix.of([[plant]]), Controller.diagonal(entries)


def test_published_mill_loop_is_stable():
    assert unstable_poles(MILL, MILL_PI) == 0
    check_loop(MILL, MILL_PI)


def test_splitter_top_temperature_needs_direct_action():
    plant = "-0.464/(12 s + 1)"
    assert unstable_poles(*one(plant, PID(Kc=1.0, Ti=8.0, Td=0.5))) == 1
    assert unstable_poles(*one(plant, PID(Kc=-1.0, Ti=8.0, Td=0.5))) == 0
    with pytest.raises(SignConflict, match=r"output 1 to input 1.*positive.*negative.*action = \"direct\""):
        check_loop(*one(plant, PID(Kc=1.0, Ti=8.0, Td=0.5)))
    check_loop(*one(plant, PID(Kc=1.0, Ti=8.0, Td=0.5, action="direct")))


def ultimate_gain(tau: float, theta: float) -> float:
    """Gain at which exp(-theta s)/(tau s + 1) under P control has poles on the imaginary axis."""
    w = brentq(lambda w: np.pi - np.arctan(w * tau) - w * theta, 1e-9, np.pi / theta)
    return float(np.hypot(1.0, w * tau))


@pytest.mark.parametrize(("tau", "theta"), [(1.0, 1.0), (10.0, 0.05), (0.3, 20.0)])
def test_ultimate_gain_of_a_first_order_plant_with_dead_time(tau, theta):
    gain = ultimate_gain(tau, theta)
    plant = f"exp(-{theta} s)/({tau} s + 1)"
    assert unstable_poles(*one(plant, PID(Kc=0.999 * gain))) == 0
    assert unstable_poles(*one(plant, PID(Kc=1.001 * gain))) == 2


def test_ultimate_gain_of_an_integrator_with_dead_time():
    assert unstable_poles(*one("exp(-2 s)/s", PID(Kc=0.999 * np.pi / 4))) == 0
    assert unstable_poles(*one("exp(-2 s)/s", PID(Kc=1.001 * np.pi / 4))) == 2


def test_sampled_ultimate_gain_is_that_of_the_discrete_polynomial():
    # 1/s held over 1: y[k+1] = y[k] + u[k], u = K (r - y), pole at 1 - K
    assert unstable_poles(*one("1/s", PID(Kc=1.999, sample_time=1.0))) == 0
    assert unstable_poles(*one("1/s", PID(Kc=2.001, sample_time=1.0))) == 1
    # one more sample of dead time: z^2 - z + K, on the circle at K = 1
    assert unstable_poles(*one("exp(-s)/s", PID(Kc=0.999, sample_time=1.0))) == 0
    assert unstable_poles(*one("exp(-s)/s", PID(Kc=1.001, sample_time=1.0))) == 2


def test_a_slow_scan_destabilises_what_a_fast_one_holds():
    plant = "2 exp(-0.5 s)/(3 s + 1)"
    fast, slow = (PID(Kc=2.2, Ti=3.0, sample_time=h) for h in (0.05, 2.0))
    assert unstable_poles(*one(plant, fast)) == 0
    assert unstable_poles(*one(plant, slow)) > 0


@pytest.mark.parametrize("seed", range(12))
def test_count_equals_the_closed_loop_eigenvalues_of_random_rational_loops(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    rows, system = [], []
    for _ in range(n):
        rows.append([])
        for _ in range(n):
            num, den = rng.normal(size=2), np.poly(-rng.uniform(-0.3, 2.0, size=2))
            rows[-1].append((num, den))
            system.append((num, den))
    plant = TransferMatrix(tuple(tuple(tf(0) + _rational(*cell) for cell in row) for row in rows))
    gains = rng.normal(size=n) * 2
    law = [PID(Kc=float(k), Ti=2.0) for k in gains]
    g = control.append(*(control.ss(control.tf(*cell)) for cell in system))
    inputs, outputs = np.kron(np.ones((n, 1)), np.eye(n)), np.kron(np.eye(n), np.ones((1, n)))
    loop = outputs * (g * (inputs * control.append(*(control.ss(control.tf([k, k / 2.0], [1.0, 0.0])) for k in gains))))
    a = loop.A - loop.B @ loop.C
    assert unstable_poles(plant, Controller.diagonal(law)) == int(np.sum(np.linalg.eigvals(a).real > 0))


def _rational(num, den):
    from trueplant.lti import TransferFunction

    return TransferFunction.rational(num, den)


@pytest.mark.parametrize("seed", range(10))
def test_verdict_on_sampled_loops_with_dead_time_is_that_of_the_simulation(seed):
    rng = np.random.default_rng(100 + seed)
    theta = rng.uniform(0.0, 1.5, (2, 2))
    tau = rng.uniform(0.5, 4.0, (2, 2))
    gain = np.array([[1.0, 0.4], [-0.5, 1.2]])
    plant = TransferMatrix.of(
        [[f"{gain[i, j]} exp(-{theta[i, j]} s)/({tau[i, j]} s + 1)" for j in range(2)] for i in range(2)]
    )
    law = Controller.diagonal([PID(Kc=float(k), Ti=2.0, sample_time=0.2) for k in rng.uniform(0.3, 4.0, 2)])
    r = np.zeros((6000, 2))
    r[0] = 1.0
    sim = simulate(plant, law, r, 0.2)
    early, late = (np.max(np.abs(sim.y[a:b])) for a, b in ((2000, 3000), (5000, 6000)))
    assert (unstable_poles(plant, law) > 0) == (late > early > 1e-200)


def test_unstable_plant_needs_enough_gain_and_not_too_much():
    # exp(-0.2 s)/(s - 1) under P control is stable from K = 1 up to the gain where the phase is -180 degrees
    w = brentq(lambda w: np.arctan(w) - 0.2 * w, 0.5, 20.0)
    high = float(np.hypot(1.0, w))
    counts = [
        unstable_poles(*one("exp(-0.2 s)/(s - 1)", PID(Kc=k))) for k in (0.999, 1.001, 0.999 * high, 1.001 * high)
    ]
    assert counts == [1, 0, 0, 2]


def test_hidden_cancellation_of_an_unstable_pole_is_not_stable():
    assert unstable_poles(*one("1/(s - 1)", Linear(tf("3 (s - 1)/((s + 1)(0.1 s + 1))")))) == 1


def test_integrator_that_cannot_see_its_output_is_not_stable():
    assert unstable_poles(*one("s/(s + 1)^2", PID(Kc=0.5, Ti=1.0))) == 1


def test_terms_that_cancel_the_integrator_count_no_pole():
    # (1 - exp(-s))/s is a moving mean: gain 1, no pole; under integral control stable up to a known gain
    def count(ki: float) -> int:
        return unstable_poles(*one("(1 - exp(-s))/s", PID(form="parallel", Kp=0.0, Ki=ki)))

    # phase of the mean is -w/2, of the integral -90 deg: -180 deg at w = pi, magnitude 2 ki/pi^2
    assert count(0.999 * np.pi**2 / 2) == 0
    assert count(1.001 * np.pi**2 / 2) == 2


def test_pure_dead_time_under_p_control_is_stable_below_a_gain_of_one():
    assert unstable_poles(*one("exp(-s)", PID(Kc=0.95))) == 0
    with pytest.raises(UnstableLoop, match="high frequency"):
        unstable_poles(*one("exp(-s)", PID(Kc=1.05)))


def test_algebraic_loop_without_solution_is_named():
    with pytest.raises(IllPosedLoop, match="without lag"):
        check_loop(*one("2 (s + 3)/(s + 1)", PID(Kc=-0.5)))


def test_negative_pairing_of_a_stable_multivariable_loop_is_not_refused():
    # paired on elements of negative relative gain: wrong sign alone, right with the other loop closed
    plant = TransferMatrix.of([["1/(10 s + 1)", "4/(2 s + 1)"], ["4/(2 s + 1)", "1/(10 s + 1)"]])
    law = Controller(
        {(0, 0): PID(form="parallel", Kp=0.0, Ki=-0.002), (1, 1): PID(form="parallel", Kp=0.0, Ki=0.2)}, 2, 2
    )
    assert unstable_poles(plant, law) == 0
    check_loop(plant, law)


def test_unstable_loop_says_what_to_check():
    with pytest.raises(UnstableLoop, match=r"2 poles.*dead times"):
        check_loop(*one("exp(-2 s)/s", PID(Kc=1.0)))
    with pytest.raises(LoopError, match="must agree"):
        check_loop(MILL, Controller.diagonal([PID(Kc=1.0)]))


@pytest.mark.parametrize(("scale", "unstable"), [(0.85, False), (1.2, True)])
def test_loops_with_different_scans_are_judged_by_their_frequency_functions(scale, unstable):
    # one loop scanned at 0.05, one continuous; the limit found by simulation lies between the two scales
    plant = TransferMatrix.of(
        [["exp(-s)/(3 s + 1)", "0.5 exp(-s)/(2 s + 1)"], ["0.5 exp(-s)/(2 s + 1)", "exp(-s)/(3 s + 1)"]]
    )
    law = Controller.diagonal([PID(Kc=3.2 * scale, Ti=5.0, sample_time=0.05), PID(Kc=3.2 * scale, Ti=5.0)])
    r = np.ones((40_000, 2))
    r[:, 1] = -1.0
    error = np.abs(simulate(plant, law, r, 0.01).y - r).max(axis=1)
    assert (error[-5000:].max() > error[15_000:20_000].max()) == unstable
    assert (unstable_poles(plant, law) > 0) == unstable


def test_full_matrix_controller_is_counted_as_a_whole():
    # an inverting controller turns the plant into two equal loops 1/s exp(-0.5 s) k: limit k = pi
    plant = TransferMatrix.of([["exp(-0.5 s)", "0.5 exp(-0.5 s)"], ["0.5 exp(-0.5 s)", "exp(-0.5 s)"]])
    inverse = np.linalg.inv([[1.0, 0.5], [0.5, 1.0]])

    def count(k: float) -> int:
        cells = {(i, j): PID(form="parallel", Kp=0.0, Ki=k * inverse[i, j]) for i in range(2) for j in range(2)}
        return unstable_poles(plant, Controller(cells, 2, 2))

    assert count(0.999 * np.pi) == 0
    assert count(1.001 * np.pi) == 4
