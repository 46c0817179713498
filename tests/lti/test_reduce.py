"""Algebra, gain at s = 0, and lowest terms."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import FormulaError
from trueplant.lti import Term, TransferFunction, TransferMatrix, simplified, simplified_matrix, tf

# Uneven, so that no pole falls on a point.
POINTS = np.array([0.31, 0.053 + 0.107j, 0.0217 + 1.031j, 1.973j, 0.511 - 3.07j])

# Few different values, so that poles and dead times often coincide.
constant = st.sampled_from([-2.0, 0.3, 1.0, 2.5, 6.0])
lag = st.sampled_from([(1.0, 0.0), (2.0, 1.0), (2.5, 1.0), (6.0, 1.0), (1.0, -0.7), (4.0, 0.8, 1.0), (1.0, 0.0, 2.0)])


@st.composite
def terms(draw: st.DrawFn) -> Term:
    num, den = np.array([draw(constant)]), np.ones(1)
    for f in draw(st.lists(lag, max_size=2)):
        num = np.convolve(num, f)
    for f in draw(st.lists(lag, max_size=3)):
        den = np.convolve(den, f)
    return Term(tuple(num), tuple(den), draw(st.sampled_from([0.0, 0.2, 3.0])))


functions = st.lists(terms(), max_size=3).map(lambda t: TransferFunction(tuple(t)))


def magnitude(g: TransferFunction) -> np.ndarray:
    """What the values would be if nothing cancelled, in the sums and in each polynomial."""
    total = np.zeros(len(POINTS))
    for t in g.terms:
        den = np.abs(np.polyval(t.den, POINTS))
        size = np.polyval(np.abs(t.num), np.abs(POINTS))
        total += size / den * np.polyval(np.abs(t.den), np.abs(POINTS)) / den
    return total


@given(functions, functions)
@settings(max_examples=100, deadline=None)
def test_sums_products_and_negation_act_on_the_values(a: TransferFunction, b: TransferFunction) -> None:
    tolerance = 1e-12 * (magnitude(a) + magnitude(b) + magnitude(a) * magnitude(b) + magnitude(a * b)) + 1e-300
    assert np.all(np.abs((a + b)(POINTS) - (a(POINTS) + b(POINTS))) <= tolerance)
    assert np.all(np.abs((a - b)(POINTS) - (a(POINTS) - b(POINTS))) <= tolerance)
    assert np.all(np.abs((a * b)(POINTS) - a(POINTS) * b(POINTS)) <= tolerance)
    assert np.all((-a)(POINTS) == -a(POINTS))
    assert (a - a).is_zero


@given(functions)
@settings(max_examples=150, deadline=None)
def test_lowest_terms_keep_the_values(g: TransferFunction) -> None:
    r = simplified(g)
    assert np.all(np.abs(r(POINTS) - g(POINTS)) <= 1e-9 * magnitude(g) + 1e-300)
    assert len({t.dead_time for t in r.terms}) == len(r.terms)


@given(functions)
@settings(max_examples=100, deadline=None)
def test_no_pole_is_left_that_a_zero_of_the_same_term_cancels(g: TransferFunction) -> None:
    for term in simplified(g).terms:
        for pole in np.roots(term.den):
            size = np.polyval(np.abs(term.num), abs(pole))
            assert abs(np.polyval(term.num, pole)) > 1e-10 * size


@given(functions)
@settings(max_examples=60, deadline=None)
def test_a_function_less_its_lowest_terms_leaves_only_rounding(g: TransferFunction) -> None:
    assert np.all(np.abs(simplified(g - simplified(g))(POINTS)) <= 1e-9 * magnitude(g) + 1e-300)


def test_first_mill_mismatch_has_no_numerator_lag_as_exact_arithmetic_says() -> None:
    k, t = [Fraction("-0.464"), Fraction("-0.58")], [Fraction(2), Fraction("2.5")]
    lead = t[0] * t[1]
    slope = (k[0] * t[1] - k[1] * t[0]) / lead
    level = (k[0] - k[1]) / lead
    assert slope == 0
    assert level == Fraction("0.0232")
    (term,) = simplified(tf("-0.464 exp(-0.68 s)/(2 s + 1)") - tf("-0.58 exp(-0.68 s)/(2.5 s + 1)")).terms
    assert term.dead_time == 0.68
    assert len(term.num) == 1
    np.testing.assert_allclose(term.num, [float(level)], rtol=1e-14)
    np.testing.assert_allclose(term.den, [1.0, 0.9, 0.2], rtol=1e-14)


@pytest.mark.parametrize("factor", ["1.1014", "1.0137"])
def test_second_mill_mismatch_keeps_only_the_recycle_term(factor: str) -> None:
    text = "4 (1 - {} exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"
    (term,) = simplified(tf(text.format(factor)) - tf(text.format("0.9938"))).terms
    exact = -4 * (Fraction(factor) - Fraction("0.9938")) / 12
    assert term.dead_time == 0.67
    np.testing.assert_allclose(term.num, [float(exact)], rtol=1e-13)
    np.testing.assert_allclose(term.den, [1.0, 8 / 12, 1 / 12], rtol=1e-14)


def test_third_mill_mismatch_is_exactly_zero_at_rest() -> None:
    (term,) = simplified(tf("2.2 exp(-0.6 s)/(6.6 s + 1)") - tf("2.2 exp(-0.6 s)/(6 s + 1)")).terms
    assert term.num[1:] == (0.0,)
    np.testing.assert_allclose(
        term.num[0], float(Fraction("2.2") * (6 - Fraction("6.6")) / (6 * Fraction("6.6"))), rtol=1e-13
    )
    assert term.num[0] == pytest.approx(-0.03333, abs=5e-6)
    np.testing.assert_allclose(term.den, [1.0, 0.3182, 0.02525], rtol=2e-4)


def test_fourth_mill_mismatch_keeps_the_order_of_the_equal_lags() -> None:
    (term,) = simplified(tf("2.547 exp(-0.13 s)/(3.5 s + 1)") - tf("2.83 exp(-0.13 s)/(3.5 s + 1)")).terms
    np.testing.assert_allclose(term.num, [-0.283 / 3.5], rtol=1e-13)
    np.testing.assert_allclose(term.den, [1.0, 1 / 3.5], rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "num", "den"),
    [
        ("3 (5 s + 1)^2/(5 s + 1)^4", [0.12], [1, 0.4, 0.04]),
        ("1/(s (8 s + 1)) - 1/s", [-1.0], [1, 0.125]),
        ("s/(s^2 + 1) + 1/(s^2 + 1)^2 - 1/(s^2 + 1)^2", [1, 0], [1, 0, 1]),
        ("1/(s + 1) + 1/(s + 1)^2", [1, 2], [1, 2, 1]),
        ("2/(2 s + 1) + 2/(4 s + 2)", [1.5], [1, 0.5]),
        ("1/((s+1)(s+2)) + 1/((s+2)(s+3))", [2.0], [1, 4, 3]),
        ("s^3/s^5 + 1", [1, 0, 1], [1, 0, 0]),
        ("(s^2 - 1)/(s - 1)", [1, 1], [1]),
    ],
)
def test_common_roots_cancel_and_denominators_meet_in_their_least_common_multiple(
    text: str, num: list[float], den: list[float]
) -> None:
    (term,) = simplified(tf(text)).terms
    assert (len(term.num), len(term.den)) == (len(num), len(den))
    np.testing.assert_allclose(term.num, num, rtol=1e-12)
    np.testing.assert_allclose(term.den, den, rtol=1e-12)


def test_near_roots_that_are_not_rounding_stay() -> None:
    (term,) = simplified(tf("(s + 1)/(s + 1.000001)")).terms
    assert len(term.den) == 2


def test_dead_times_equal_up_to_rounding_are_one() -> None:
    assert 0.1 + 0.2 != 0.3
    g = TransferFunction.rational(1, [1, 1], 0.1 + 0.2) - TransferFunction.rational(1, [1, 1], 0.3)
    assert simplified(g).is_zero


def test_matrix_is_reduced_element_by_element() -> None:
    a = TransferMatrix.of([["1/(s+1)", "2"], ["1/s", "exp(-s)"]], "min")
    r = simplified_matrix(a - a)
    assert r.shape == (2, 2)
    assert r.time_unit == "min"
    assert all(element.is_zero for row in r.elements for element in row)


@pytest.mark.parametrize(
    ("text", "gain"),
    [
        ("2/(s+1)", 2.0),
        ("0", 0.0),
        ("1/s", np.inf),
        ("-1/s", -np.inf),
        ("1/s - exp(-2 s)/s", 2.0),
        ("(1 - exp(-s))/s", 1.0),
        ("(1 - exp(-2 s))/(s (3 s + 1))", 2.0),
        ("(1 - exp(-s))/s^2", np.inf),
        ("(2 - 2 exp(-s) - 2 s)/s^2", -1.0),
        ("(2 - 2 exp(-0.1 s) - 0.2 s exp(-0.1 s))/(s^2 (0.3 s + 1))", 0.01),
        ("1e-9/s", np.inf),
        ("1/s - 1/(s (1e6 s + 1))", 1e6),
    ],
)
def test_gain_at_rest_is_the_limit_worked_out_by_hand(text: str, gain: float) -> None:
    assert tf(text).dc_gain == pytest.approx(gain, rel=1e-12)


@given(functions)
@settings(max_examples=100, deadline=None)
def test_gain_at_rest_is_what_values_near_zero_tend_to(g: TransferFunction) -> None:
    if np.isfinite(g.dc_gain):
        # The circle of radius 1e-3 averages an analytic function to its value in the middle.
        circle = 1e-3 * np.exp(2j * np.pi * np.arange(16) / 16)
        assert abs(np.mean(g(circle)) - g.dc_gain) <= 1e-7 * max(1.0, np.max(np.abs(g(circle))))
    else:
        assert abs(g(1e-6)) > 1e3


def test_coefficients_that_overflow_are_refused() -> None:
    with pytest.raises(FormulaError, match="overflow"):
        Term((1e300,), (1e-300, 1.0))
