"""Tuning rules against the values their authors print, and against the exact plant."""

import numpy as np
import pytest
from scipy.optimize import brentq

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, sensitivity, unstable_poles
from trueplant.lti import TransferMatrix, tf
from trueplant.robust.margins import margins
from trueplant.tune import rules
from trueplant.tune.forms import series_ratio
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.reduce import Reduced, half_rule
from trueplant.tune.response import ultimate
from trueplant.tune.shaping import loop_shaping, pole_placement


def loop(g, pid):
    return TransferMatrix(((g,),)), Controller.diagonal([pid])


def peak_s(g, pid):
    """Ms on a dense grid, apart from the room robust."""
    s = 1j * np.geomspace(1e-3, 1e3, 60_000)
    plant, controller = loop(g, pid)
    return float(np.max(np.abs(sensitivity(plant, controller, s))))


@pytest.mark.parametrize(
    ("formula", "order", "settings", "ms"),
    [
        # Skogestad (2003), table 4 with its derivative unfiltered
        ("1/((s + 1)(0.2 s + 1))", 1, (5.5, 0.8, 0.0), 1.56),
        ("1/(s + 1)^4", 1, (0.3, 1.5, 0.0), 1.46),
        ("1/(s + 1)^4", 2, (0.5, 1.5, 1.0), 1.43),
        ("exp(-s)/(s + 1)^2", 1, (0.5, 1.5, 0.0), 1.61),
    ],
)
def test_simc_gives_the_published_settings_and_peaks(formula, order, settings, ms):
    g = tf(formula)
    pid = rules.simc(half_rule(g, order), kind="PID" if order == 2 else "PI", alpha=1e-3)
    assert (pid.Kc, pid.Ti, pid.Td) == pytest.approx(settings, rel=1e-6)
    assert peak_s(g, pid) == pytest.approx(ms, abs=0.006)


def test_tight_simc_has_the_published_margins():
    model = Reduced(2.0, 5.0, 0.0, 1.0)
    found = margins(*loop(model.transfer, rules.simc(model)))
    assert (found.gain_margin, found.Ms) == pytest.approx((3.14, 1.59), abs=0.006)
    assert found.phase_margin == pytest.approx(61.4, abs=0.06)
    assert found.delay_margin == pytest.approx(2.14, abs=0.01)
    ramp = Reduced(0.3, np.inf, 0.0, 1.0)
    found = margins(*loop(ramp.transfer, rules.simc(ramp)))
    assert (found.gain_margin, found.Ms) == pytest.approx((2.96, 1.70), abs=0.006)
    assert found.phase_margin == pytest.approx(46.9, abs=0.06)


def test_ziegler_nichols_of_the_textbook_process():
    # Skogestad and Postlethwaite (2005), example 2.1: Kc 1.14, Ti 12.7, Ms 3.92
    g = tf("3 (-2 s + 1)/((5 s + 1)(10 s + 1))")
    pid = rules.ziegler_nichols(*ultimate(g))
    assert (pid.Kc, pid.Ti) == pytest.approx((1.136, 12.7), rel=1e-3)
    assert peak_s(g, pid) == pytest.approx(3.914, abs=2e-3)


def test_rules_on_one_model_by_hand():
    # K 2, lag 4, dead time 1: x = 0.25
    model = Reduced(2.0, 4.0, 0.0, 1.0)

    def of(pid):
        return pid.Kc, pid.Ti, pid.Td

    assert of(rules.reaction_curve(model)) == pytest.approx((1.8, 1 / 0.3, 0))
    assert of(rules.reaction_curve(model, "PID")) == pytest.approx((2.4, 2, 0.5))
    assert of(rules.cohen_coon(model)) == pytest.approx((2 * (0.9 + 1 / 48), 30.75 / 14, 0))
    assert of(rules.cohen_coon(model, "PID")) == pytest.approx((2 * (4 / 3 + 1 / 16), 33.5 / 15, 4 / 11.5))
    assert of(rules.imc(model)) == pytest.approx((4.5 / (2 * 1.7), 4.5, 0))
    assert of(rules.imc(model, 1.0, "PID")) == pytest.approx((9 / (2 * 3), 4.5, 4 / 9))
    assert of(rules.lambda_tuning(model)) == pytest.approx((4 / (2 * 13), 4, 0))
    assert of(rules.amigo(model)) == pytest.approx(((0.15 + (0.35 - 4 / 25) * 4) / 2, 0.35 + 208 / 71, 0))
    assert of(rules.amigo(model, "PID")) == pytest.approx((1.0, 3.6 / 1.4, 2 / 4.3))
    assert of(rules.tyreus_luyben(3.2, 5.0)) == pytest.approx((1.0, 11.0, 0))
    assert of(rules.improved_simc(model)) == pytest.approx((13 / 3 / 4, 13 / 3, 0))
    assert of(rules.improved_simc(model, kind="PID")) == pytest.approx((4 / 3, 4, 1 / 3))


def test_amigo_pi_of_a_long_lag_tends_to_that_of_an_integrator():
    long, ramp = rules.amigo(Reduced(1e6, 1e6, 0.0, 1.0)), rules.amigo(Reduced(1.0, np.inf, 0.0, 1.0))
    assert (long.Kc, long.Ti) == pytest.approx((ramp.Kc, ramp.Ti), rel=5e-3)


def test_amigo_keeps_its_promise_on_lags_with_dead_time():
    for theta in (0.2, 1.0, 5.0):
        model = Reduced(-3.0, 1.0, 0.0, theta)
        assert 1.15 < peak_s(model.transfer, rules.amigo(model)) < 1.5


def test_imc_of_an_integrator_has_its_double_pole():
    # ramp with the first-order Taylor series of the dead time: (lambda s + 1)^2 in the denominator
    pid = rules.imc(Reduced(0.5, np.inf, 0.0, 1.0), 4.0)
    kc, ti = 9 / (0.5 * 25), 9.0
    assert (pid.Kc, pid.Ti) == pytest.approx((kc, ti))
    # 0.5 Kc (Ti s + 1)(1 - s) + Ti s^2
    poles = np.roots([ti - 0.5 * kc * ti, 0.5 * kc * (ti - 1), 0.5 * kc])
    np.testing.assert_allclose(poles, -0.25, rtol=1e-6)


def test_pure_dead_time_gets_integral_action():
    model = Reduced(2.0, 0.0, 0.0, 3.0)
    assert rules.simc(model).parallel == pytest.approx((0.0, 1 / 12, 0.0, 0.0))
    assert rules.improved_simc(model).Ti == pytest.approx(1.0)
    kp, ki, *_ = rules.improved_simc(model, kind="PID").parallel
    assert (kp, ki) == pytest.approx((1 / 9, 1 / 9))


@pytest.mark.parametrize("rule", [rules.cohen_coon, rules.reaction_curve, rules.amigo, rules.simc, rules.minimum_error])
def test_without_dead_time_the_rules_say_what_to_do(rule):
    with pytest.raises(LoopError, match="dead time"):
        rule(Reduced(1.0, 2.0, 0.0, 0.0))


def test_correlations_refuse_what_they_were_not_made_for():
    with pytest.raises(LoopError, match="0.1 to 1"):
        rules.minimum_error(Reduced(1.0, 1.0, 0.0, 2.0))
    with pytest.raises(LoopError, match="no correlation"):
        rules.minimum_error(Reduced(1.0, 2.0, 0.0, 1.0), "ISE", "set-point")


@pytest.mark.parametrize(("limit", "kp", "ki"), [(1.4, 0.3600, 0.3730), (1.59, 0.4588, 0.5027), (2.0, 0.6044, 0.7143)])
def test_largest_integral_gain_of_a_lag_with_dead_time(limit, kp, ki):
    pid = max_ki(tf("exp(-s)/(s + 1)"), limit)
    assert pid.Kc == pytest.approx(kp, rel=2e-3)
    assert pid.Kc / pid.Ti == pytest.approx(ki, abs=1e-4)
    assert peak_s(tf("exp(-s)/(s + 1)"), pid) == pytest.approx(limit, rel=1e-5)


def test_largest_integral_gain_is_stationary():
    # where |S| alone binds at one frequency, kp = -Re 1/G there and w (Im 1/G - 1/(Ms |G|)) is stationary
    def ki(w):
        inverse = (1 + 1j * w) * np.exp(1j * w)
        return w * (inverse.imag - np.abs(inverse) / 1.4)

    w = brentq(lambda x: (ki(x + 1e-5) - ki(x - 1e-5)) / 2e-5, 0.9, 1.15, xtol=1e-10)
    pid = max_ki(tf("exp(-s)/(s + 1)"), Limits(1.4))
    assert pid.Kc / pid.Ti == pytest.approx(ki(w), rel=1e-5)
    assert pid.Kc == pytest.approx(-((1 + 1j * w) * np.exp(1j * w)).real, rel=1e-3)


@pytest.mark.parametrize("formula", ["-3 exp(-s)/(s (2 s + 1))", "2/(s + 1)^4", "exp(-s)/(s^2 + s + 1)"])
@pytest.mark.parametrize("kind", ["PI", "PID"])
def test_largest_integral_gain_holds_both_limits(formula, kind):
    g = tf(formula)
    pid = max_ki(g, 1.6, kind)
    found = margins(*loop(g, pid))
    assert max(found.Ms, found.Mt) == pytest.approx(1.6, rel=2e-3)
    assert not pid.Td or pid.Ti >= series_ratio(0.1) * pid.Td * (1 - 1e-9)


def test_no_settings_nearby_hold_the_limits_with_a_larger_integral_gain():
    g = tf("exp(-0.7 s)/((2 s + 1)(s + 1))")
    pid = max_ki(g, 1.5)
    ki = 1.002 * pid.Kc / pid.Ti
    for kp in pid.Kc * np.linspace(0.7, 1.3, 25):
        found = margins(*loop(g, PID(Kc=kp, Ti=kp / ki)))
        assert max(found.Ms, found.Mt) > 1.5


def test_a_light_resonance_is_not_overlooked():
    g = tf("exp(-0.5 s)/((s^2 + 0.01 s + 1)(3 s + 1))")
    assert margins(*loop(g, max_ki(g, 1.6))).Ms == pytest.approx(1.6, rel=2e-3)


def test_an_unstable_plant_is_refused():
    with pytest.raises(LoopError, match="unstable in open loop"):
        max_ki(tf("exp(-0.1 s)/(s - 1)"))


def test_unbounded_gain_is_refused():
    with pytest.raises(LoopError, match="bound no gain"):
        max_ki(tf("1/(s + 1)"), 2.0)


@pytest.mark.parametrize("third", [None, 1.5])
def test_placed_poles_solve_the_characteristic_equation(third):
    g = tf("-2 exp(-s)/((5 s + 1)(s + 1))")
    pid = pole_placement(g, 0.3, 0.7, third, tf=0.05)
    places = np.array([0.3 * complex(-0.7, np.sqrt(0.51))] + ([complex(-third)] if third else []))
    np.testing.assert_allclose(g(places) * pid.feedback(places), -1, rtol=1e-9)


def test_pole_placement_of_a_lag_is_the_textbook_formula():
    pid = pole_placement(tf("2/(5 s + 1)"), 0.4, 0.8)
    assert pid.parallel[:2] == pytest.approx(((2 * 0.8 * 0.4 * 5 - 1) / 2, 0.4**2 * 5 / 2))


def test_placing_poles_too_fast_is_refused():
    with pytest.raises(LoopError, match="unstable"):
        pole_placement(tf("exp(-s)/(s + 1)^2"), 4.0)


@pytest.mark.parametrize("kind", ["PI", "PID"])
@pytest.mark.parametrize("crossover", [None, 0.25])
def test_shaped_loop_crosses_where_asked(kind, crossover):
    g = tf("-2 exp(-s)/((5 s + 1)(s + 1))")
    pid = loop_shaping(g, 50.0, crossover, kind)
    found = margins(*loop(g, pid))
    assert found.phase_margin == pytest.approx(50.0, abs=1e-3)
    assert crossover is None or found.phase_margin_frequency == pytest.approx(crossover, rel=1e-6)
    if kind == "PID":
        assert pid.Ti == pytest.approx(series_ratio(0.1) * pid.Td)


def test_impossible_phase_is_refused():
    with pytest.raises(LoopError, match="phase"):
        loop_shaping(tf("exp(-s)/(s + 1)"), 60.0, 3.0)


def test_every_rule_stabilises_what_it_is_for():
    model = Reduced(-1.5, 6.0, 0.0, 2.0)
    point = ultimate(model.transfer)
    for kind in ("PI", "PID"):
        settings = [rules.ziegler_nichols(*point, kind), rules.tyreus_luyben(*point, kind)]
        for rule in (rules.reaction_curve, rules.cohen_coon, rules.imc, rules.simc, rules.improved_simc, rules.amigo):
            settings.append(rule(model, kind=kind))
        settings += [rules.minimum_error(model, c, kind=kind) for c in ("IAE", "ISE", "ITAE")]
        settings += [rules.minimum_error(model, c, "set-point", kind) for c in ("IAE", "ITAE")]
        for pid in (*settings, rules.lambda_tuning(model)):
            assert pid.sign == -1 and unstable_poles(*loop(model.transfer, pid)) == 0
