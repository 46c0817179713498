"""Step measures against closed forms and Parseval's integral; optimal settings against both and the correlations."""

import numpy as np
import pytest

from trueplant.errors import LoopError, UnstableLoop
from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix, tf
from trueplant.plants import wood_berry
from trueplant.robust import margins
from trueplant.tune.compare import compare, loop_metrics, step_metrics
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.optimal import optimal
from trueplant.tune.reduce import Reduced
from trueplant.tune.rules import minimum_error, simc


def parseval(g, pid, step):
    """ISE of the step response by the integral of |S/s|^2 or |S G/s|^2 over frequency."""
    w = np.concatenate([np.geomspace(1e-6, 1e-2, 4000), np.linspace(1e-2, 400, 2_000_000)[1:]])
    s = 1j * w
    error = 1 / (1 + g(s) * pid.feedback(s)) / s * (1 if step == "set-point" else g(s))
    # beyond the top |S/s|^2 is about 1/w^2
    return (np.trapezoid(np.abs(error) ** 2, w) + (1 / w[-1] if step == "set-point" else 0)) / np.pi


@pytest.mark.parametrize("step", ["set-point", "load"])
def test_squared_error_is_that_of_the_frequency_response(step):
    g, pid = tf("2 exp(-0.7 s)/((3 s + 1)(s + 1))"), PID(Kc=1.2, Ti=3.0, Td=0.4, alpha=0.1)
    assert step_metrics(g, pid, step).ise == pytest.approx(parseval(g, pid, step), rel=2e-3)


def test_load_error_without_overshoot_is_the_integral_time_over_the_gain():
    pid = PID(Kc=0.8, Ti=6.0)
    found = step_metrics(tf("exp(-s)/(5 s + 1)"), pid, "load")
    assert found.iae == pytest.approx(6.0 / 0.8, rel=2e-3)
    assert found.total_variation == pytest.approx(1.0, rel=2e-3)


def test_first_order_closed_loop_in_closed_form():
    # Kc = tau/lambda, Ti = tau without dead time: e = exp(-t/lambda)
    found = loop_metrics(tf("1/(10 s + 1)"), PID(Kc=20.0, Ti=10.0))
    step, lam = found.setpoint, 0.5
    assert (step.iae, step.itae, step.ise) == pytest.approx((lam, lam**2, lam / 2), rel=1e-2)
    assert step.settling == pytest.approx(lam * np.log(50), rel=2e-2)
    assert step.peak == pytest.approx(0.0, abs=1e-5)
    assert step.total_variation == pytest.approx(20 + 19, rel=1e-2)
    assert found.margins.Ms == pytest.approx(1.0, abs=1e-3)


def test_overshoot_of_a_second_order_loop():
    # PI on an integrator with the set-point off P: w0^2/(s^2 + 2 zeta w0 s + w0^2)
    zeta = 0.4
    pid = PID(form="parallel", Kp=2 * zeta, Ki=1.0, setpoint_weight=0.0)
    found = step_metrics(tf("1/s"), pid, "set-point")
    assert found.peak == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), abs=2e-3)


def test_sampled_controllers_are_measured_at_their_scan():
    g, pid = tf("exp(-s)/(5 s + 1)"), PID(Kc=0.8, Ti=6.0)
    coarse = PID(Kc=0.8, Ti=6.0, sample_time=0.7)
    fine = PID(Kc=0.8, Ti=6.0, sample_time=0.01)
    assert step_metrics(g, fine, "load").peak == pytest.approx(step_metrics(g, pid, "load").peak, rel=5e-3)
    assert step_metrics(g, coarse, "load").peak > 1.01 * step_metrics(g, pid, "load").peak


def test_one_loop_of_several_feels_the_others():
    case = wood_berry()
    both = loop_metrics(case.model, case.controller, output=1, input=1)
    alone = loop_metrics(TransferMatrix(((case.model[1, 1],),)), Controller.diagonal([case.controller.entries[1, 1]]))
    assert both.margins.Ms == margins(case.model, case.controller, 1).Ms
    assert both.setpoint.iae > 1.1 * alone.setpoint.iae


def test_an_unstable_side_of_a_comparison_is_none():
    g = tf("exp(-s)/(s + 1)")
    found = compare(g, PID(Kc=5.0, Ti=1.0), max_ki(g))
    assert found.before is None
    assert found.after is not None and found.after.margins.Ms == pytest.approx(1.59, rel=1e-4)
    with pytest.raises(UnstableLoop):
        step_metrics(g, PID(Kc=5.0, Ti=1.0), "load")


def test_a_loop_without_integral_action_does_not_settle():
    with pytest.raises(LoopError, match="settle"):
        step_metrics(tf("exp(-s)/(s + 1)"), PID(Kc=0.5), "load")
    assert step_metrics(tf("exp(-s)/(s + 1)"), PID(Kc=0.5), "load", horizon=30.0).peak == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("theta", [0.2, 0.6])
@pytest.mark.parametrize(
    ("criterion", "step", "kind"),
    [(c, "load", k) for c in ("IAE", "ISE", "ITAE") for k in ("PI", "PID")]
    + [("IAE", "set-point", "PI"), ("ITAE", "set-point", "PI")],
)
def test_optimum_beats_the_published_correlation_by_little(theta, criterion, step, kind):
    model = Reduced(-2.0, 1.0, 0.0, theta)
    g = model.transfer
    best = getattr(step_metrics(g, optimal(g, criterion, step, kind), step), criterion.lower())
    rule = getattr(step_metrics(g, minimum_error(model, criterion, step, kind), step), criterion.lower())
    assert best <= 1.002 * rule <= 1.13 * best


def test_optimum_is_least_by_parseval_too():
    g = tf("exp(-0.7 s)/((3 s + 1)(s + 1))")
    pid = optimal(g, "ISE", "load")
    best = parseval(g, pid, "load")
    for kc, ti in ((1.08, 1), (0.92, 1), (1, 1.12), (1, 0.88)):
        assert parseval(g, PID(Kc=pid.Kc * kc, Ti=pid.Ti * ti), "load") > best


@pytest.mark.parametrize("formula", ["exp(-s)/(s + 1)", "0.4 exp(-s)/s", "exp(-s)", "1/(s + 1)^4"])
def test_optimum_within_limits_holds_them_and_beats_simc(formula):
    g = tf(formula)
    pid = optimal(g, limits=Limits(1.59, 1.59))
    found = loop_metrics(g, pid)
    assert max(found.margins.Ms, found.margins.Mt) <= 1.59 * 1.002
    model = {"exp(-s)/(s + 1)": (1.0, 1.0, 1.0), "exp(-s)": (1.0, 0.0, 1.0)}.get(formula)
    if model:
        assert found.load.iae < step_metrics(g, simc(Reduced(model[0], model[1], 0.0, model[2])), "load").iae


def test_no_optimum_without_dead_time():
    with pytest.raises(LoopError, match="no optimum"):
        optimal(tf("1/(s + 1)"))
