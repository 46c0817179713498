"""Reduced models: Skogestad's published examples, and exact matches."""

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.lti import tf
from trueplant.tune.reduce import Reduced, half_rule, matched, reduced
from trueplant.tune.response import ultimate

E2 = "(-0.3 s + 1)(0.08 s + 1)/((2 s + 1)(s + 1)(0.4 s + 1)(0.2 s + 1)(0.05 s + 1)^3)"
E3 = "2 (15 s + 1)/((20 s + 1)(s + 1)(0.1 s + 1)^2)"


@pytest.mark.parametrize(
    ("formula", "order", "expected"),
    [
        # Skogestad (2003): table 4 and the examples of section 2
        ("1/((s + 1)(0.2 s + 1))", 1, (1, 1.1, 0, 0.1)),
        ("1/((s + 1)(0.2 s + 1))", 2, (1, 1, 0.2, 0)),
        (E2, 1, (1, 2.5, 0, 1.47)),
        (E2, 2, (1, 2, 1.2, 0.77)),
        (E3, 1, (1.5, 1.05, 0, 0.15)),
        (E3, 2, (1.5, 1, 0.15, 0.05)),
        ("1/(s + 1)^4", 1, (1, 1.5, 0, 2.5)),
        ("1/(s + 1)^4", 2, (1, 1.5, 1, 1.5)),
        ("exp(-s)/(s + 1)^2", 1, (1, 1.5, 0, 1.5)),
        ("exp(-s)/(s + 1)^2", 2, (1, 1, 1, 1)),
        ("-0.5 exp(-s)/(s (2 s + 1)(0.4 s + 1))", 1, (-0.5, np.inf, 0, 1 + 1 + 0.4)),
        ("-0.5 exp(-s)/(s (2 s + 1)(0.4 s + 1))", 2, (-0.5, np.inf, 2.2, 1.2)),
    ],
)
def test_half_rule_gives_the_published_models(formula, order, expected):
    model = half_rule(tf(formula), order)
    assert (model.gain, model.tau1, model.tau2, model.dead_time) == pytest.approx(expected, rel=1e-6)


def test_half_the_scan_is_dead_time():
    assert half_rule(tf("exp(-s)/(3 s + 1)"), scan=0.5) == Reduced(1.0, 3.0, 0.0, 1.25)


@pytest.mark.parametrize("formula", ["1/(s^2 + 0.4 s + 1)", "(exp(-s) + exp(-2 s))/(s + 1)", "1/s^2", "1/(s - 1)"])
def test_half_rule_refuses_what_it_does_not_cover(formula):
    with pytest.raises(LoopError, match="half rule"):
        half_rule(tf(formula))


@pytest.mark.parametrize(
    "formula",
    [
        "-2 exp(-s)/(3 s + 1)^3",
        "4 (1 - 0.9 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))",
        "0.3 exp(-s)/(s (4 s + 1)^2)",
    ],
)
def test_matched_model_has_the_same_gain_at_rest_and_ultimate_point(formula):
    g = tf(formula)
    model = matched(g)
    assert ultimate(model.transfer) == pytest.approx(ultimate(g), rel=1e-9)
    if model.integrating:
        assert (1e-7 * g(np.array(1e-7))).real == pytest.approx(model.slope, rel=1e-5)
    else:
        assert model.gain == pytest.approx(g.dc_gain)


def test_a_first_order_with_dead_time_is_matched_by_itself():
    model = matched(tf("3 exp(-2 s)/(5 s + 1)"))
    assert (model.gain, model.tau1, model.dead_time) == pytest.approx((3.0, 5.0, 2.0), rel=1e-9)


def test_reduced_falls_back_on_matching():
    g = tf("exp(-s)/(s^2 + s + 1)")
    assert ultimate(reduced(g).transfer) == pytest.approx(ultimate(g), rel=1e-9)
    assert reduced(tf("exp(-s)/(3 s + 1)")) == Reduced(1.0, 3.0, 0.0, 1.0)


def test_ultimate_point_in_closed_form():
    # 3(-2s+1)/((5s+1)(10s+1)): Routh gives Ku 2.5 and 15.24 (Skogestad and Postlethwaite 2005, example 2.1)
    ku, pu = ultimate(tf("3 (-2 s + 1)/((5 s + 1)(10 s + 1))"))
    assert (ku, pu) == pytest.approx((2.5, 2 * np.pi / np.sqrt(8.5 / 50)), rel=1e-9)
    assert ultimate(tf("-1/(s + 1)^3")) == pytest.approx((-8.0, 2 * np.pi / np.sqrt(3)), rel=1e-9)
    ku, pu = ultimate(tf("exp(-2 s)/s"))
    assert (ku, pu) == pytest.approx((np.pi / 4, 8.0), rel=1e-9)
    with pytest.raises(LoopError, match="never reaches"):
        ultimate(tf("1/(s + 1)"))
