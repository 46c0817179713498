"""LQG, H2 and H-infinity: optimal on the Pade plant they are designed for, stable on the exact one."""

import sys

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.loop import Controller, unstable_poles
from trueplant.lti import TransferMatrix
from trueplant.robust import margins
from trueplant.tune import fastest, h2, h_infinity, lqg
from trueplant.tune.state_space import DESIGNS, StateSpace, _optimal, realised

DELAYED = TransferMatrix.of([["2 exp(-s)/(5 s + 1)"]])
LAGS = TransferMatrix.of([["2/((5 s + 1)(s + 1))"]])
WOOD_BERRY = TransferMatrix.of(
    [
        ["12.8 exp(-s)/(16.7 s + 1)", "-18.9 exp(-3 s)/(21 s + 1)"],
        ["6.6 exp(-7 s)/(10.9 s + 1)", "-19.4 exp(-3 s)/(14.4 s + 1)"],
    ],
    "min",
)


def closed_loop(plant: StateSpace, controller: Controller) -> np.ndarray:
    """Poles of the loop of a state-space plant and one transfer function, u = Q (r - y)."""
    term = controller.entries[0, 0].tf.terms[0]
    n = len(term.den) - 1
    num = np.concatenate([np.zeros(n + 1 - len(term.num)), term.num])
    a = np.vstack([-np.array(term.den[1:]), np.eye(n - 1, n)])
    b, c, d = np.eye(n, 1), (num[1:] - num[0] * np.array(term.den[1:]))[None, :], num[0]
    top = np.hstack([plant.A - plant.B * d @ plant.C, plant.B @ c])
    return np.linalg.eigvals(np.vstack([top, np.hstack([-b @ plant.C, a])]))


def test_realisation_has_the_response_of_its_pade_plant():
    found = realised(WOOD_BERRY, 3)
    s = 1j * np.geomspace(0.001, 0.1, 12)
    response = np.array([found.C @ np.linalg.solve(x * np.eye(len(found.A)) - found.A, found.B) + found.D for x in s])
    np.testing.assert_allclose(response, WOOD_BERRY(s), rtol=2e-3)


@pytest.mark.parametrize("bandwidth", [0.3, 0.9])
def test_lqg_separates_into_regulator_and_filter(bandwidth):
    """Closed-loop poles are those of the two Riccati equations, solved here on their own by eigenvectors."""
    plant = realised(LAGS, 1)
    found = lqg(LAGS, bandwidth)
    scale = abs(LAGS(np.array([1j * bandwidth]))[0, 0, 0])
    A = np.block([[plant.A, plant.B * bandwidth], [np.zeros((1, 3))]])
    B, C = np.vstack([plant.B, [[1.0]]]), np.hstack([plant.C, [[0.0]]]) / scale

    def stable(a, b, c):
        values = np.linalg.eigvals(np.block([[a, -b @ b.T], [-c.T @ c, -a.T]]))
        return values[values.real < 0]

    # both Hamiltonians have the same spectrum: every pole is there twice, found only to the root of the rounding
    expected = np.concatenate([stable(A, B, C), stable(A.T, C.T, B.T)])
    # the zero that goes with the integrator cancels nothing of the plant: its pole stays as the integrator's
    np.testing.assert_allclose(
        np.poly(closed_loop(plant, found.controller)), np.poly(expected).real, rtol=1e-5, atol=1e-9
    )


def test_h2_cost_is_that_of_the_loop_and_the_least():
    """The formula's cost against the norm of the closed loop by a Lyapunov equation, for the optimum and beside it."""
    from scipy.linalg import solve_continuous_lyapunov

    rng = np.random.default_rng(4)
    n = 3
    A, B1, B2 = rng.normal(size=(n, n)), rng.normal(size=(n, 2)), rng.normal(size=(n, 1))
    C1, C2 = rng.normal(size=(2, n)), rng.normal(size=(1, n))
    B1, C1 = np.hstack([B1, np.zeros((n, 1))]), np.vstack([C1, np.zeros((1, n))])
    D12, D21, D22 = np.array([[0.0], [0.0], [1.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([[0.3]])
    law, cost = _optimal(A, B1, B2, C1, C2, D12, D21, D22)

    def norm(k: StateSpace) -> float:
        inner = np.vstack([np.hstack([A, B2 @ k.C]), np.hstack([k.B @ C2, k.A + k.B @ D22 @ k.C])])
        b, c = np.vstack([B1, k.B @ D21]), np.hstack([C1, D12 @ k.C])
        assert np.all(np.linalg.eigvals(inner).real < 0)
        return float(np.trace(c @ solve_continuous_lyapunov(inner, -b @ b.T) @ c.T))

    assert cost == pytest.approx(norm(law), rel=1e-8)
    for _ in range(6):
        step = 1e-3
        other = StateSpace(
            law.A + step * rng.normal(size=(n, n)),
            law.B + step * rng.normal(size=(n, 1)),
            law.C + step * rng.normal(size=(1, n)),
            law.D,
        )
        assert norm(other) > cost


@pytest.mark.parametrize("method", ["lqg", "h2"])
def test_without_steady_error_and_stable_with_the_exact_dead_time(method):
    found = DESIGNS[method](DELAYED, 0.3, 2)
    assert unstable_poles(DELAYED, found.controller) == 0
    at_rest = np.abs(1 / (1 + DELAYED(np.array([1e-6j])) @ found.controller(np.array([1e-6j]))))
    assert at_rest[0, 0, 0] < 1e-4
    finer = DESIGNS[method](DELAYED, 0.3, 4)
    assert margins(DELAYED, found.controller).Ms == pytest.approx(margins(DELAYED, finer.controller).Ms, rel=0.02)


def test_the_fastest_keeps_the_limits_in_both_loops():
    found = fastest(WOOD_BERRY, "lqg", [0.3, 0.15], 1.59)
    for i, crossover in enumerate((0.3, 0.15)):
        reached = margins(WOOD_BERRY, found.controller, i)
        assert reached.Ms <= 1.59
        assert not reached.phase_margin_frequency > crossover * 1.001
    assert len(found.controller.entries) == 4


def test_the_fastest_counts_the_scan():
    sampled, continuous = (fastest(DELAYED, "lqg", [0.5], 1.4, scans) for scans in ([1.0], None))
    assert {entry.sample_time for entry in sampled.controller.entries.values()} == {1.0}
    assert margins(DELAYED, sampled.controller).Ms <= 1.4
    assert sampled.bandwidth < continuous.bandwidth


def test_units_do_not_matter():
    """Time in seconds, PV in thousandths: the same controller in other units."""
    minutes = lqg(DELAYED, 0.4)
    seconds = lqg(TransferMatrix.of([["2000 exp(-60 s)/(300 s + 1)"]], "s"), 0.4 / 60)
    s = 1j * np.geomspace(0.01, 3, 20)
    np.testing.assert_allclose(seconds.controller(s / 60) * 1000, minutes.controller(s), rtol=1e-6)


def test_what_cannot_be_designed_is_refused():
    with pytest.raises(LoopError, match="as many inputs as outputs"):
        lqg(TransferMatrix.of([["1/(s + 1)", "1/(s + 2)"]]), 1.0)
    with pytest.raises(LoopError, match="gains at rest"):
        h2(TransferMatrix.of([["1/s"]]), 1.0)
    with pytest.raises(LoopError, match="above 0"):
        lqg(DELAYED, -1.0)


def test_h_infinity_without_slycot_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "slycot", None)
    with pytest.raises(LoopError, match=r"trueplant\[hinf\]"):
        h_infinity(LAGS, 0.5)


def test_the_peak_that_slycot_reports_is_that_of_the_loop():
    pytest.importorskip(
        "slycot", reason="slycot is GPL, so a user's own choice: install trueplant[hinf] for H-infinity design"
    )
    found = h_infinity(LAGS, 0.5)
    assert unstable_poles(LAGS, found.controller) == 0
    w = np.geomspace(1e-4, 1e3, 3000)
    s = 1j * w
    loop = LAGS(s)[:, 0, 0] * found.controller(s)[:, 0, 0]
    weight = (s / 1.5 + 0.5) / (s + 0.05)
    scale = abs(LAGS(np.array([0.5j]))[0, 0, 0])
    inner = found.controller(s)[:, 0, 0] * s / (s + 0.5) * scale
    peak = np.sqrt(np.abs(weight / (1 + loop)) ** 2 + np.abs(inner / (1 + loop)) ** 2)
    assert np.max(peak) <= found.cost * 1.01
