"""Transforms of sampled signals against closed forms and direct integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from trueplant.errors import DataError
from trueplant.record import transform

T = 40.0
S = np.array([0.0, 1e-9, 1e-4j, 0.01 + 0.02j, 0.3j, 1 + 1j, 5j, 0.4, -0.02 + 0.1j])


def grid(n: int = 401, irregular: bool = False) -> np.ndarray:
    t = np.linspace(0, T, n)
    if irregular:
        t[1:-1] += 0.3 * T / n * np.sin(7.0 * np.arange(1, n - 1))
    return t


def exponential(s: np.ndarray, a: complex) -> np.ndarray:
    """Transform of exp(-a t) over 0 .. T."""
    p = np.asarray(s + a)
    return np.where(p == 0, T, -np.expm1(-p * T) / np.where(p == 0, 1, p))


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("hold", ["zoh", "linear", "spline"])
def test_constant(hold: str, irregular: bool) -> None:
    t = 3.0 + grid(irregular=irregular)
    np.testing.assert_allclose(transform(t, np.full(t.size, 2.5), S, hold), 2.5 * exponential(S, 0), rtol=1e-12)


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("hold", ["linear", "spline"])
def test_ramp(hold: str, irregular: bool) -> None:
    t = grid(irregular=irregular)
    s = S[4:]
    exact = (1 - np.exp(-s * T) * (1 + s * T)) / s**2
    np.testing.assert_allclose(transform(t, t, s, hold), exact, rtol=1e-11)
    assert transform(t, t, 0.0, hold)[0] == pytest.approx(T**2 / 2)


def test_cubic_is_exact_for_the_spline() -> None:
    t = grid(60, irregular=True)
    x = 1 - 2 * t + 0.3 * t**2 - 0.01 * t**3
    ours = transform(t, x, S, "spline")
    for value, s in zip(ours, S, strict=True):

        def integrand(tau: float, part: str, s: complex = s) -> float:
            return getattr((1 - 2 * tau + 0.3 * tau**2 - 0.01 * tau**3) * np.exp(-s * tau), part)

        exact = sum(
            f * quad(integrand, 0, T, args=(p,), limit=400, epsabs=1e-9)[0] for f, p in ((1, "real"), (1j, "imag"))
        )
        assert value == pytest.approx(exact, rel=1e-8, abs=1e-6)


@pytest.mark.parametrize("a", [0.2, 0.05 + 0.7j])
def test_smooth_signals_converge_as_splines_do(a: complex) -> None:
    s = S[2:6]
    error = []
    for n in (201, 401, 801):
        t = grid(n)
        both = np.column_stack([np.exp(-a * t).real, np.exp(-a * t).imag])
        value = transform(t, both, s, "spline") @ np.array([1, 1j])
        error.append(np.max(np.abs(value - exponential(s, a))))
    assert error[0] < 1e-5
    assert error[1] < error[0] / 8
    assert error[2] < error[1] / 8


@settings(max_examples=50, deadline=None)
@given(
    x=st.lists(st.floats(-100, 100), min_size=3, max_size=60),
    s=st.complex_numbers(max_magnitude=20, min_magnitude=1e-3),
    irregular=st.booleans(),
)
def test_a_held_signal_is_its_exact_sum(x: list[float], s: complex, irregular: bool) -> None:
    t = np.linspace(0, 1, len(x))
    if irregular:
        t = t**1.5
    exact = sum(v * (np.exp(-s * a) - np.exp(-s * b)) / s for v, a, b in zip(x, t[:-1], t[1:], strict=False))
    scale = max(1.0, np.exp(-s.real)) * (1 + np.max(np.abs(x)))
    assert transform(t, np.array(x), s, "zoh")[0] == pytest.approx(exact, rel=1e-9, abs=1e-11 * scale)


@settings(max_examples=30, deadline=None)
@given(x=st.lists(st.floats(-100, 100), min_size=4, max_size=40), w=st.floats(0, 30))
def test_even_and_uneven_paths_agree(x: list[float], w: float) -> None:
    t = np.arange(len(x)) * 0.1
    uneven = np.append(t, t[-1] + 0.05)
    values = np.append(x, x[-1])
    for hold in ("zoh", "linear"):
        rest = transform(np.array([0, 0.05]), values[-2:], 1j * w, hold)[0] * np.exp(-1j * w * t[-1])
        whole = transform(t, np.array(x), 1j * w, hold)[0] + rest
        assert transform(uneven, values, 1j * w, hold)[0] == pytest.approx(whole, rel=1e-9, abs=1e-9)


def test_resting_tail() -> None:
    t = grid(1001)
    s = np.array([0.01 + 0.1j, 0.3 + 0.2j, 2j])
    step_response = 1 - np.exp(-t)
    value = transform(t, step_response, s, "spline", tail="hold")
    # exact of 1/(s + 1)/s, but for what is left of exp(-t) after 40 time constants
    np.testing.assert_allclose(value, 1 / (s * (s + 1)), rtol=1e-6)


def test_shapes() -> None:
    t = grid(50)
    assert transform(t, np.zeros((50, 2, 3)), 1j * np.ones(7), "zoh").shape == (7, 2, 3)
    assert transform(t, np.zeros(50), 1j * np.ones((4, 5)), "linear").shape == (4, 5)
    assert transform(t, np.zeros(50), 1j, "linear").shape == (1,)


def test_missing_samples_give_nan_in_their_column_only() -> None:
    t = grid(50)
    x = np.column_stack([np.sin(t), np.cos(t)])
    x[20, 0] = np.nan
    for hold in ("zoh", "linear", "spline"):
        value = transform(t, x, 1j, hold)
        assert np.isnan(value[0, 0])
        assert value[0, 1] == pytest.approx(transform(t, x[:, 1], 1j, hold)[0])


def test_wrong_use() -> None:
    t = grid(50)
    for arguments in (
        (t[::-1], t, 1j, "zoh"),
        (t, t[:-1], 1j, "zoh"),
        (t, t, 1j, "cubic"),
        (t, t, 1j, "zoh", "forever"),
    ):
        with pytest.raises(DataError):
            transform(*arguments)
