"""Formula text to transfer functions and back, and formulas in pv."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import FormulaError
from trueplant.lti import Term, TransferFunction, TransferMatrix, parse_pv, require_proper, tf, to_formula

# Uneven, so that no pole falls on a point.
POINTS = np.array([0.31, 0.053 + 0.107j, 0.0217 + 1.031j, 1.973j, 0.511 - 3.07j])

# The same functions written by hand in Python.
BY_HAND = {
    "-0.58/(10s+1)": lambda s: -0.58 / (10 * s + 1),
    "1/s": lambda s: 1 / s,
    "0": lambda s: 0 * s,
    "-3": lambda s: -3 + 0 * s,
    "2.2 exp(-0.6s)/(6s+1)": lambda s: 2.2 * np.exp(-0.6 * s) / (6 * s + 1),
    "2.2 exp(-0.6*s)/(6*s+1)": lambda s: 2.2 * np.exp(-0.6 * s) / (6 * s + 1),
    "3.2 e^(-3s)/(18 s+1)": lambda s: 3.2 * np.exp(-3 * s) / (18 * s + 1),
    "(1+1/(8 s))": lambda s: 1 + 1 / (8 * s),
    "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))": lambda s: (
        4 * (1 - 0.9938 * np.exp(-0.47 * s)) * np.exp(-0.2 * s) / ((2 * s + 1) * (6 * s + 1))
    ),
    "2/(12s+1) exp(-3 s)": lambda s: 2 / (12 * s + 1) * np.exp(-3 * s),
    "1.5(1 + 1/(8s) + 2s/(0.2s+1))": lambda s: 1.5 * (1 + 1 / (8 * s) + 2 * s / (0.2 * s + 1)),
    "1/(1 + 1/(8 s) + 1/(2s+1))": lambda s: 1 / (1 + 1 / (8 * s) + 1 / (2 * s + 1)),
    "-s^2 + 2": lambda s: -(s**2) + 2,
    "-(s+2)^-2": lambda s: -1 / (s + 2) ** 2,
    "2^3^2 s": lambda s: 512 * s,
    "2 - -s": lambda s: 2 + s,
    "1e-3s + 2.E+1/s": lambda s: 1e-3 * s + 20 / s,
    "(1 + exp(-s/4))^3/s**2": lambda s: (1 + np.exp(-s / 4)) ** 3 / s**2,
    "6/2*s": lambda s: 3 * s,
    "6/2/s": lambda s: 3 / s,
    "\u2212 2 \u00b7 s \u00d7 3": lambda s: -6 * s,
}


@pytest.mark.parametrize("text", BY_HAND)
def test_formula_means_what_the_same_python_expression_means(text: str) -> None:
    np.testing.assert_allclose(tf(text)(POINTS), BY_HAND[text](POINTS), rtol=1e-13, atol=1e-15)


def test_terms_of_a_product_share_its_denominator() -> None:
    g = tf("4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))")
    assert g.terms == (Term((4.0,), (12.0, 8.0, 1.0), 0.2), Term((-3.9752,), (12.0, 8.0, 1.0), 0.67))


@pytest.mark.parametrize(
    ("text", "order"),
    [("1 + 1/(8 s)", 1), ("(1 + 1/(8 s))/(3 s + 1)", 2), ("1/s + 1/s^2", 2), ("s/s", 0), ("1/(1+1/s)", 1)],
)
def test_a_pi_law_and_its_kind_stay_one_small_term(text: str, order: int) -> None:
    (term,) = tf(text).terms
    assert len(term.den) - 1 == order


def test_a_sum_of_lags_stays_a_sum_of_lags() -> None:
    assert [len(t.den) for t in tf("1/(s+1) + 2/(s+2) + 3/(s+3)").terms] == [2, 2, 2]


def test_numbers_and_transfer_functions_pass_through() -> None:
    g = tf("1/s")
    assert tf(g) is g
    assert tf(2) == tf("2") == TransferFunction.rational([2.0])
    assert tf(np.float64(0.0)).is_zero
    assert tf("1/s - 1/s").is_zero


HOSTILE = {
    "__import__('os').system('ls')": "column 12",
    "__import__": "unknown name '__import__'",
    "os": "unknown name 'os'",
    "z": "unknown name 'z'",
    "1/(t + 1)": "column 4",
    "lambda: 0": "unexpected character ':'",
    "s;s": "unexpected character ';'",
    "s = 2": "unexpected character '='",
    "s\u00b2": "unknown name",
    "\x00": "unexpected character",
    "": "empty",
    " \n ": "empty",
    "1/0": "division by zero",
    "1/(s - s)": "division by zero",
    "0^-1": "division by zero",
    "1/(1 + exp(-s))": "different dead times",
    "1/exp(-s)": "future",
    "exp(-s)^-1": "future",
    "exp(s)": "future",
    "e^(0.1 s)": "future",
    "exp(-2)": "must be -theta s",
    "exp(-s^2)": "must be -theta s",
    "exp(-1/s)": "must be -theta s",
    "exp(-s - 1)": "must be -theta s",
    "exp(exp(-s))": "must be -theta s",
    "e^-2s": "must be -theta s",
    "e": "power",
    "exp": "parentheses",
    "exp -s": "parentheses",
    "0,5/(s+1)": "point",
    "1e999": "too large",
    "1e200 * 1e200": "overflow",
    "(1e300 s)^20": "overflow",
    "1e300/(1e-300 s + 1)": "overflow",
    "exp(-1e308 s) exp(-1e308 s)": "dead times add up to infinity",
    "s^21": "too high",
    "s^-21": "too high",
    "2^1e300": "too high",
    "s^0.5": "whole number",
    "s^s": "whole number",
    "s^exp(-s)": "whole number",
    "((s+1)^20)^20": "order",
    "(1 + exp(-s) + exp(-1.1s))^20": "terms",
    "(" * 900 + "s" + ")" * 900: "nested",
    "-" * 1900 + "s": "nested",
    "2^" * 900 + "2": "nested",
    "e^" * 900 + "s": "nested",
    "9" * 3000: "3000 characters",
    "s +": "too early",
    "s)": "left over",
    "(s": "never closed",
    "()": "belongs here",
    "* s": "belongs here",
    "1..2": "follows without a sign",
    "1.2.3": "follows without a sign",
    "s 2": "follows without a sign",
    "1/2 s": "still divided by",
    "4/(2s+1)(6s+1)": "still divided by",
}


@pytest.mark.parametrize("text", HOSTILE, ids=lambda t: repr(t[:24]))
def test_what_is_not_a_formula_is_refused_quickly_with_the_reason(text: str) -> None:
    start = time.perf_counter()
    with pytest.raises(FormulaError) as refusal:
        tf(text)
    assert HOSTILE[text] in str(refusal.value)
    assert len(str(refusal.value)) < 500
    assert time.perf_counter() - start < 1.0


def test_largest_accepted_input_is_read_in_a_moment() -> None:
    start = time.process_time()
    lags = "+".join(f"1/({k}s+1)" for k in range(1, 90))
    assert len(tf(lags).terms) == 89
    tf("(1+exp(-s)+exp(-1.1s))^5" + "*(s+1)" * 50)
    assert time.process_time() - start < 5.0


@given(st.text(alphabet="s0123456789.+-*/^() expv,\u2212e", max_size=60))
@settings(max_examples=300, deadline=None)
def test_any_text_is_read_or_refused_as_a_formula(text: str) -> None:
    try:
        g = tf(text)
    except FormulaError:
        return
    assert all(math.isfinite(c) for t in g.terms for c in (*t.num, *t.den, t.dead_time))


def test_the_caret_stands_under_the_character_named() -> None:
    with pytest.raises(FormulaError) as refusal:
        tf("1/(2 s + 1) + 3 q")
    first, shown, caret = str(refusal.value).split("\n")
    assert "column 17" in first
    assert shown[caret.index("^")] == "q"
    with pytest.raises(FormulaError) as refusal:
        tf("s + " * 100 + "q" + " + s" * 100)
    _, shown, caret = str(refusal.value).split("\n")
    assert shown[caret.index("^")] == "q"
    assert len(shown) < 100


@pytest.mark.parametrize("value", [True, None, [1.0], math.nan, math.inf, 1j])
def test_values_that_are_no_transfer_function_are_refused(value: object) -> None:
    with pytest.raises(FormulaError):
        tf(value)  # type: ignore[arg-type]


def test_improper_is_read_and_refused_only_where_it_matters() -> None:
    g = tf("2 s + 1")
    assert not g.is_proper
    with pytest.raises(FormulaError, match="the weight wI is improper: order 1 over order 0"):
        require_proper(g, "the weight wI")
    lag = tf("(2 s + 1)/(s + 1)")
    assert require_proper(lag, "it") is lag


@pytest.mark.parametrize(
    "text",
    [
        "-0.58 exp(-0.68 s)/(2.5 s + 1)",
        "(4 exp(-0.2 s) - 3.9752 exp(-0.67 s))/((2 s + 1)(6 s + 1))",
        "2/(5 s + 1)^4",
        "1/(3 s + 1)^20",
        "1/(s + 1e-310)",
        "3 (2 s - 1) exp(-s)/(s (4 s^2 + 0.8 s + 1))",
        "(1 - exp(-s))/s",
        "-exp(-s) + 1/(s + 1)",
        "1/s^2",
        "5/(s - 1)",
        "s/(s^2 + 1)",
        "1.5e-07/(3e+06 s + 1)",
        "0",
    ],
)
def test_text_in_the_printed_form_comes_back_unchanged(text: str) -> None:
    assert to_formula(tf(text)) == text
    assert str(tf(text)) == text


def test_digits_are_the_significant_digits() -> None:
    assert to_formula(tf("1.23456789 exp(-0.987654321 s)/(3.3333333 s + 1)"), 3) == "1.23 exp(-0.988 s)/(3.33 s + 1)"


size = st.floats(0.05, 20.0)
sign = st.sampled_from([-1.0, 1.0])
real_factor = st.builds(lambda t, w: np.array([t, w]), size, sign)
pair_factor = st.builds(lambda t, z: np.array([t * t, 2 * z * t, 1.0]), size, st.floats(-0.9, 0.9))
factor = st.one_of(real_factor, pair_factor, st.just(np.array([1.0, 0.0])))


@st.composite
def terms(draw: st.DrawFn) -> Term:
    num, den = np.array([draw(sign) * draw(size)]), np.ones(1)
    for f in draw(st.lists(factor, max_size=2)):
        num = np.convolve(num, f)
    for f in draw(st.lists(factor, max_size=4)):
        den = np.convolve(den, f)
    return Term(tuple(num), tuple(den), draw(st.sampled_from([0.0, 0.2, 0.67, 5.0])))


functions = st.lists(terms(), max_size=3).map(lambda t: TransferFunction(tuple(t)))


def magnitude(g: TransferFunction, s: np.ndarray) -> np.ndarray:
    """What the value would be if nothing cancelled, in the sums and in each polynomial."""
    total = np.zeros(len(s))
    for t in g.terms:
        den = np.abs(np.polyval(t.den, s))
        swell = np.polyval(np.abs(t.den), np.abs(s)) / den
        total += np.polyval(np.abs(t.num), np.abs(s)) / den * swell
    return total


@given(functions)
@settings(max_examples=150, deadline=None)
def test_printing_with_all_digits_and_reading_gives_the_function_back(g: TransferFunction) -> None:
    back = tf(to_formula(g, 17))
    assert np.all(np.abs(back(POINTS) - g(POINTS)) <= 1e-11 * magnitude(g, POINTS) + 1e-300)


@given(functions)
@settings(max_examples=60, deadline=None)
def test_printing_with_six_digits_keeps_six_digits(g: TransferFunction) -> None:
    back = tf(to_formula(g))
    assert np.all(np.abs(back(POINTS) - g(POINTS)) <= 1e-4 * magnitude(g, POINTS) + 1e-300)


def test_matrix_of_formulas_reads_each_cell() -> None:
    matrix = TransferMatrix.of([["1/(s+1)", 2], [tf("1/s"), "0"]], "min")
    np.testing.assert_allclose(matrix([1.0])[0], [[0.5, 2.0], [1.0, 0.0]])


THERMISTOR = "1023 * (11800*exp(3977*(1/(pv + 273.15) - 1/293.6)))/(9853 + 11800*exp(3977*(1/(pv + 273.15) - 1/293.6)))"


def test_thermistor_count_agrees_with_the_same_calculation_by_hand() -> None:
    resistance = [11800 * math.exp(3977 * (1 / (t + 273.15) - 1 / 293.6)) for t in (0.0, 20.45, 80.0)]
    np.testing.assert_allclose(
        parse_pv(THERMISTOR)([0.0, 20.45, 80.0]), [1023 * r / (9853 + r) for r in resistance], rtol=1e-14
    )
    assert resistance[1] == pytest.approx(11800.0)


@pytest.mark.parametrize(
    ("text", "pv", "expected"),
    [
        ("sqrt(pv)", 9.0, 3.0),
        ("pv^1.5", 4.0, 8.0),
        ("2 pv^2 - 1", 3.0, 17.0),
        ("-pv^2", 3.0, -9.0),
        ("abs(pv - 5)/2", 1.0, 2.0),
        ("log(exp(pv))", 2.5, 2.5),
        ("e^(pv)", 1.0, math.e),
        ("2^pv", 3.0, 8.0),
        ("sqrt(pv)", -1.0, math.nan),
        ("log(pv)", 0.0, math.nan),
        ("1/pv", 0.0, math.nan),
        ("1/(1/pv)", 0.0, math.nan),
        ("1/log(pv)", 0.0, math.nan),
        ("pv^-1", 0.0, math.nan),
        ("pv^0.5", -2.0, math.nan),
        ("exp(pv)", 1e4, math.nan),
        ("pv + 1", math.nan, math.nan),
    ],
)
def test_pv_transform_values_and_domain(text: str, pv: float, expected: float) -> None:
    np.testing.assert_allclose(parse_pv(text)(np.full((2, 3), pv)), np.full((2, 3), expected), rtol=1e-14)


@pytest.mark.parametrize(
    "text",
    ["__import__('os')", "s", "3", "", "sin(pv)", "pv.real", "pv[0]", "sqrt pv", "exp(pv", "1,5*pv", "(" * 900 + "pv"],
)
def test_pv_transform_outside_the_grammar_is_refused(text: str) -> None:
    with pytest.raises(FormulaError):
        parse_pv(text)


def test_equal_pv_transforms_compare_equal_and_show_their_text() -> None:
    assert parse_pv("sqrt(pv)") == parse_pv("sqrt(pv)")
    assert str(parse_pv("sqrt(pv)")) == "sqrt(pv)"
