"""The parts of a law add up to its OP, however they are summed up, and what came before only leaves a free response."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from trueplant.loop import PID, Controller, Kind, Linear, Sum, law_parts, replay
from trueplant.lti import tf

H = 0.5
LAWS = [
    PID(Kc=2.0),
    PID(Kc=0.8, Ti=4.0, sample_time=H),
    PID(Kc=0.8, Ti=4.0, Td=0.7, sample_time=H, derivative_on="pv", setpoint_weight=0.3),
    PID(form="series", Kc=0.8, Ti=4.0, Td=0.7, action="direct", sample_time=H),
    PID(form="parallel", Kp=0.8, Ki=0.2, Kd=0.4, sample_time=H, setpoint_filter=tf("1/(3 s + 1)")),
    Linear(tf("(2 s + 1)/(s (0.3 s + 1))"), sample_time=H),
    Linear(tf("3 (2 s + 1)/(7 s + 1) + 0.1/s"), sample_time=H),
]


def signals(n: int = 300, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return 5 + np.repeat(rng.normal(size=n // 20), 20)[:, None], 5 + np.cumsum(rng.normal(size=(n, 1)), axis=0)


def added(entry, how: Sum, r, y) -> np.ndarray:
    parts = law_parts(Controller.diagonal([entry]), 0, r, y, H, how, how, 1)
    return np.sum([p.values for p in parts], axis=0)


@pytest.mark.parametrize("entry", LAWS)
def test_backward_sums_are_the_sampled_law(entry):
    r, y = signals()
    op = replay(Controller.diagonal([entry]), r, y, H, first=[7.0])[:, 0]
    values = added(entry, Sum.BACKWARD, r, y)
    basis = remembered(entry, Sum.BACKWARD, r, y)
    assert left((op - values)[:, None], basis) < 1e-9 * np.std(op)


@pytest.mark.parametrize("entry", [PID(Kc=0.8, Ti=4.0), PID(Kc=0.8, Ti=4.0, Td=0.7), Linear(tf("(2 s + 1)/(9 s + 1)"))])
def test_forward_sums_are_the_continuous_law_on_held_signals(entry):
    r, y = signals()
    op = replay(Controller.diagonal([entry]), r, y, H)[:, 0]
    gap = (op - added(entry, Sum.FORWARD, r, y))[:, None]
    assert left(gap, remembered(entry, Sum.FORWARD, r, y)) < 1e-9 * np.std(op)


@pytest.mark.parametrize(("num", "den"), [([2.0, 1.0], [0.6, 2.0, 0.0]), ([0.9, 0.2], [3.0, 1.0]), ([1.0], [4.0, 0.0])])
def test_trapezoidal_sums_are_tustins(num, den):
    r, y = signals()
    n, d, _ = cont2discrete((num, den), H, method="bilinear")
    expected = lfilter(n.ravel(), d, (r - y)[:, 0])
    formula = f"({' + '.join(f'{c!r} s^{len(num) - 1 - k}' for k, c in enumerate(num))})/("
    formula += f"{' + '.join(f'{c!r} s^{len(den) - 1 - k}' for k, c in enumerate(den))})"
    np.testing.assert_allclose(added(Linear(tf(formula)), Sum.TRAPEZOIDAL, r, y), expected, atol=1e-8)


@pytest.mark.parametrize("how", list(Sum))
@pytest.mark.parametrize("entry", [e for e in LAWS if isinstance(e, Linear) or e.setpoint_filter is None])
def test_what_came_before_leaves_a_free_response_only(entry, how):
    """But for a set-point filter, which runs on from the start of the record."""
    r, y = signals()
    whole, tail = added(entry, how, r, y)[120:], added(entry, how, r[120:], y[120:])
    gap = (whole - tail)[:, None]
    assert left(gap, remembered(entry, how, r[120:], y[120:])) < 1e-9 * np.std(whole)


def test_parts_carry_their_gains_and_places():
    controller = Controller({(0, 0): PID(Kc=2.0, Ti=5.0, Td=1.0), (0, 1): PID(Kc=-1.0), (1, 1): PID(Kc=9.0)}, 2, 2)
    r, y = np.tile(signals()[0], 2), np.tile(signals()[1], 2)
    parts = law_parts(controller, 0, r, y, H, Sum.BACKWARD, Sum.BACKWARD, 4)
    assert [(p.place, p.kind) for p in parts] == [
        ((0, 0), Kind.GAIN),
        ((0, 0), Kind.INTEGRAL),
        ((0, 0), Kind.DERIVATIVE),
        ((0, 1), Kind.GAIN),
    ]
    np.testing.assert_allclose(np.diff(parts[0].values), 2.0 * np.diff((r - y)[:, 0]), atol=1e-12)
    np.testing.assert_allclose(np.diff(parts[1].values), 2.0 / 5.0 * H * (r - y)[1:, 0], atol=1e-12)
    np.testing.assert_allclose(parts[1].memory, 2.0 / 5.0 * np.ones((4, 1)))
    np.testing.assert_allclose(np.diff(parts[3].values), -np.diff((r - y)[:, 1]), atol=1e-12)


def remembered(entry, how: Sum, r, y) -> np.ndarray:
    parts = law_parts(Controller.diagonal([entry]), 0, r, y, H, how, how, len(y))
    return np.hstack([np.ones((len(y), 1)), *(p.memory for p in parts)])


def left(gap: np.ndarray, basis: np.ndarray) -> float:
    """What the basis leaves of a signal (N, 1), root mean square."""
    found = np.linalg.lstsq(basis, gap, rcond=1e-13)[0]
    return float(np.std(gap - basis @ found))
