"""All rules on one loop: what they share, and what they say where they have no answer."""

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferMatrix, tf
from trueplant.robust import margins
from trueplant.tune import METHODS, Limits, Reduced, retune, simc


def stable(g, pid):
    return unstable_poles(TransferMatrix(((g,),)), Controller.diagonal([pid])) == 0


@pytest.mark.parametrize("kind", ["PI", "PID"])
def test_every_method_answers_for_a_lag_with_dead_time(kind):
    g = tf("-2 exp(-3 s)/(8 s + 1)")
    like = PID(form="parallel", Kp=-1.0, Ki=-0.1, limits=(0.0, 100.0), setpoint_weight=0.5)
    found = retune(g, like, kind=kind)
    assert [one.method for one in found] == list(METHODS)
    for one in found:
        assert one.pid is not None, (one.method, one.note)
        assert stable(g, one.pid) and one.pid.sign == -1
        assert (one.pid.form, one.pid.limits, one.pid.setpoint_weight) == ("parallel", (0.0, 100.0), 0.5)
        # lambda tuning and the SIMC rule of a first-order model have no derivative
        assert bool(one.pid.Kd) == (kind == "PID" and one.method not in ("lambda", "simc"))


def test_half_the_scan_counts_as_dead_time():
    g = tf("exp(-s)/(8 s + 1)")
    (found,) = retune(g, PID(Kc=1.0, Ti=5.0, sample_time=1.0), ["simc"])
    expected = simc(Reduced(1.0, 8.0, 0.0, 1.5))
    assert found.pid is not None
    assert (found.pid.Kc, found.pid.Ti, found.pid.sample_time) == pytest.approx((expected.Kc, expected.Ti, 1.0))


def test_limits_hold_for_a_sampled_controller_nearly():
    # the half scan stands for the hold: exact only for fast scans
    g = tf("exp(-s)/(8 s + 1)")
    (found,) = retune(g, PID(Kc=1.0, Ti=5.0, sample_time=0.2), ["max-ki"], limits=Limits(1.5))
    at = margins(TransferMatrix(((g,),)), Controller.diagonal([found.pid]))
    assert at.Ms == pytest.approx(1.5, rel=0.01)


def test_no_answer_is_explained():
    found = {one.method: one for one in retune(tf("2/(8 s + 1)"), PID(Kc=1.0, Ti=5.0))}
    assert found["lambda"].pid is not None
    for name in ("ziegler-nichols", "cohen-coon", "simc", "max-ki", "optimal-iae", "pole-placement", "loop-shaping"):
        assert found[name].pid is None and len(found[name].note) > 20


def test_a_closed_loop_time_serves_plants_without_dead_time():
    g = tf("2/(8 s + 1)")
    for one in retune(g, PID(Kc=1.0, Ti=5.0), ["simc", "imc", "lambda"], closed_loop_time=2.0):
        assert one.pid is not None, one.note
        # Kc 2, Ti 8: a closed loop of first order with that time, exactly
        assert (one.pid.Kc, one.pid.Ti) == pytest.approx((2.0, 8.0))


def test_a_form_without_equivalent_is_kept_and_said():
    g = tf("exp(-3 s)/(8 s + 1)")
    # Ti = 4 Td with a filter has no series form
    ziegler, largest = retune(g, PID(form="series", Kc=1.0, Ti=5.0, Td=1.0), ["ziegler-nichols", "max-ki"])
    assert (ziegler.pid.form, largest.pid.form) == ("ideal", "series")
    assert "no equivalent" in ziegler.note and largest.note == ""


def test_unstable_answers_are_withheld():
    # Ziegler-Nichols' PID on two nearly undamped poles
    g = tf("exp(-0.2 s)/((s^2 + 0.04 s + 1)(0.1 s + 1))")
    answers = retune(g, PID(Kc=0.1, Ti=5.0, Td=0.1))
    assert any(one.pid is None for one in answers)
    assert all(one.pid is None or stable(g, one.pid) for one in answers)


def test_percent_of_span_and_action_are_taken_out():
    like = PID(Kc=2.0, Ti=5.0, action="direct", gain_unit="percent of span", op_span=100.0, pv_span=50.0)
    (found,) = retune(tf("-2 exp(-3 s)/(8 s + 1)"), like, ["simc"])
    assert found.pid.parallel[0] == pytest.approx(8 / (-2 * 6))
    np.testing.assert_array_equal(found.pid.action, None)


def test_unknown_methods_and_transformed_pvs_are_refused():
    with pytest.raises(LoopError, match="unknown tuning method"):
        retune(tf("1/(s + 1)"), PID(Kc=1.0), ["guess"])
    with pytest.raises(LoopError, match="linearised"):
        retune(tf("1/(s + 1)"), PID(Kc=1.0, pv_transform=np.sqrt))


def test_another_rule_is_a_line_in_the_table(monkeypatch):
    monkeypatch.setitem(METHODS, "half", lambda g, choices: PID(Kc=0.5 / g.dc_gain, Ti=20.0))
    (found,) = retune(tf("2 exp(-2 s)/(10 s + 1)"), PID(form="parallel", Kp=1.0, Ki=0.1), ["half"])
    assert found.pid is not None
    assert (found.pid.form, found.pid.Kp) == ("parallel", 0.25)
