"""To and from python-control; frequency responses compared with it."""

from __future__ import annotations

import control
import numpy as np
import pytest

from trueplant.errors import FormulaError
from trueplant.lti import TransferMatrix, from_control, tf, to_control

OMEGA = np.geomspace(1e-3, 1e2, 60)


def response(system: control.TransferFunction | control.StateSpace) -> np.ndarray:
    """python-control's response (n_w, n_y, n_u)."""
    value = system(1j * OMEGA, squeeze=False)
    return np.moveaxis(value, -1, 0)


RATIONAL = [
    "2/(3 s + 1)",
    "-1.5 (1 - 2 s)/((10 s + 1)(s^2 + 0.4 s + 1))",
    "1/(5 s + 1)^4",
    "1 + 1/(8 s) + 2 s/(0.2 s + 1)",
    "1/(s + 1) - 3/(s + 2) + 5/(7 s - 1)",
    "0",
]


@pytest.mark.parametrize("text", RATIONAL)
def test_rational_response_equals_that_of_python_control(text: str) -> None:
    g = tf(text)
    np.testing.assert_allclose(response(to_control(g))[:, 0, 0], g(1j * OMEGA), rtol=1e-11, atol=1e-14)


def test_formula_equals_python_controls_own_algebra() -> None:
    s = control.tf("s")
    theirs = 3 * (1 + 1 / (8 * s)) * (2 * s + 1) / ((6 * s + 1) ** 2)
    ours = tf("3 (1 + 1/(8 s))(2 s + 1)/(6 s + 1)^2")
    np.testing.assert_allclose(ours(1j * OMEGA), response(theirs)[:, 0, 0], rtol=1e-12)


def test_matrix_goes_to_python_control_and_back() -> None:
    g = TransferMatrix.of([RATIONAL[:3], RATIONAL[3:]], "min")
    system = to_control(g)
    np.testing.assert_allclose(response(system), g(1j * OMEGA), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(from_control(system)(1j * OMEGA), g(1j * OMEGA), rtol=1e-11, atol=1e-14)


def test_state_space_system_keeps_its_response() -> None:
    rng = np.random.default_rng(7)
    a = rng.normal(size=(5, 5)) - 3 * np.eye(5)
    b, c, d = rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), rng.normal(size=(3, 2))
    system = control.ss(a, b, c, d)
    np.testing.assert_allclose(from_control(system)(1j * OMEGA), response(system), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("gain", [1e-8, 1.0, 1e8])
def test_small_and_large_gains_keep_their_digits_from_state_space(gain: float) -> None:
    system = control.ss([[-1.0, 2.0], [0.0, -3.0]], [[0.0], [gain]], [[1.0, 0.0]], [[0.0]])
    (term,) = from_control(system)[0, 0].terms
    np.testing.assert_allclose(term.num, [2 * gain], rtol=1e-10)
    np.testing.assert_allclose(term.den, [1.0, 4.0, 3.0], rtol=1e-10)


def test_states_that_an_element_does_not_see_cancel() -> None:
    system = control.ss(np.diag([-1.0, -3.0]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    g = from_control(system)
    assert g[0, 1].is_zero
    assert g[1, 0].is_zero
    assert [len(g[i, i].terms[0].den) for i in range(2)] == [2, 2]


def test_a_pure_gain_is_a_system_without_states() -> None:
    g = from_control(control.ss([], [], [], [[2.0, 0.0]]))
    assert g.shape == (1, 2)
    np.testing.assert_allclose(g.dc_gain, [[2.0, 0.0]])


def test_dead_times_delay_the_elements() -> None:
    system = control.tf([[[1.0], [2.0]]], [[[1.0, 1.0], [3.0, 1.0]]])
    g = from_control(system, [[0.5, 4.0]])
    expected = response(system) * np.exp(-1j * OMEGA[:, None, None] * np.array([[0.5, 4.0]]))
    np.testing.assert_allclose(g(1j * OMEGA), expected, rtol=1e-12)


def test_pade_approximates_the_dead_time_where_its_order_suffices() -> None:
    g = tf("2 exp(-0.5 s)/(3 s + 1) - exp(-s)/(s + 1)")
    low = OMEGA < 2
    np.testing.assert_allclose(response(to_control(g, 6))[low, 0, 0], g(1j * OMEGA[low]), atol=1e-8)
    assert len(control.poles(to_control(tf("exp(-s)/(s + 1)"), 3))) == 4


def test_dead_time_without_an_order_is_refused() -> None:
    with pytest.raises(FormulaError, match="give pade_order"):
        to_control(tf("exp(-s)/(s + 1)"))


@pytest.mark.parametrize("order", [0, -1, 2.5, "3"])
def test_an_order_that_is_no_positive_whole_number_is_refused(order: object) -> None:
    with pytest.raises(FormulaError, match="pade_order"):
        to_control(tf("exp(-s)/(s + 1)"), order)  # type: ignore[arg-type]


def test_discrete_and_foreign_systems_and_wrong_dead_times_are_refused() -> None:
    with pytest.raises(FormulaError, match="discrete"):
        from_control(control.tf([1.0], [1.0, 0.5], 0.1))
    with pytest.raises(FormulaError, match="FrequencyResponseData cannot be converted"):
        from_control(control.frd(control.tf([1.0], [1.0, 1.0]), OMEGA))
    with pytest.raises(FormulaError, match=r"the system needs \(1, 1\)"):
        from_control(control.tf([1.0], [1.0, 1.0]), [1.0, 2.0])
    with pytest.raises(FormulaError, match="dead time must be 0 or more"):
        from_control(control.tf([1.0], [1.0, 1.0]), [[-1.0]])
