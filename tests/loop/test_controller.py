"""Controllers: forms, units, actions, two degrees of freedom and scans, in frequency."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Linear, replay
from trueplant.lti import tf

S = 1j * np.geomspace(1e-3, 1e2, 60)
positive = st.floats(0.05, 20)


def response(entry) -> np.ndarray:
    return Controller.diagonal([entry])(S)[:, 0, 0]


@given(kc=st.floats(-5, 5), ti=positive, td=positive, alpha=st.floats(0.02, 1))
@settings(max_examples=30, deadline=None)
def test_each_form_is_its_formula(kc, ti, td, alpha):
    ideal = response(PID(Kc=kc, Ti=ti, Td=td, alpha=alpha))
    assert np.allclose(ideal, kc * (1 + 1 / (ti * S) + td * S / (alpha * td * S + 1)), atol=1e-12)
    series = response(PID(form="series", Kc=kc, Ti=ti, Td=td, alpha=alpha))
    assert np.allclose(series, kc * (1 + 1 / (ti * S)) * (td * S + 1) / (alpha * td * S + 1), rtol=1e-9, atol=1e-12)
    parallel = response(PID(form="parallel", Kp=kc, Ki=kc / ti, Kd=kc * td, Tf=alpha * td))
    assert np.allclose(parallel, ideal, atol=1e-12)


@pytest.mark.parametrize("ti", [None, 0.0, np.inf])
def test_no_integral_time_means_no_integral(ti):
    assert np.allclose(response(PID(Kc=2.0, Ti=ti)), 2.0)
    assert np.allclose(response(PID(form="series", Kc=2.0, Ti=ti, Td=1.0)), 2.0 * (S + 1) / (0.1 * S + 1))


def test_direct_action_turns_all_gains_and_span_units_scale_them():
    law = {"Kc": 2.0, "Ti": 3.0, "Td": 0.5}
    plain = response(PID(**law))
    assert np.allclose(response(PID(**law, action="direct")), -plain)
    assert np.allclose(response(PID(**law, action="reverse")), plain)
    scaled = response(PID(**law, gain_unit="percent of span", op_span=50.0, pv_span=200.0))
    assert np.allclose(scaled, plain * 0.25)


def test_reference_and_setpoint_of_two_degrees_of_freedom():
    entry = PID(Kc=2.0, Ti=3.0, Td=0.5, setpoint_weight=0.4, derivative_on="pv", setpoint_filter=tf("1/(2 s + 1)"))
    law = 2 * (0.4 + 1 / (3 * S)) / (2 * S + 1)
    controller = Controller.diagonal([entry])
    assert np.allclose(controller.reference(S)[:, 0, 0], law)
    assert np.allclose((controller(S) @ controller.setpoint(S))[:, 0, 0], law)
    assert np.allclose(Controller.diagonal([PID(Kc=1.0, Ti=2.0)]).setpoint(S), 1.0)


@pytest.mark.parametrize(
    "entry",
    [
        PID(Kc=0.8, Ti=4.0, Td=0.7, sample_time=0.5, setpoint_weight=0.3, derivative_on="pv"),
        PID(form="series", Kc=0.8, Ti=4.0, Td=0.7, sample_time=0.5),
        PID(form="parallel", Kp=0.8, Ki=0.2, Kd=0.4, sample_time=0.5),
        PID(Kc=0.8, Ti=4.0, sample_time=0.5, setpoint_filter=tf("1/(3 s + 1)")),
        Linear(tf("(2 s + 1)/(s (0.3 s + 1))"), sample_time=0.5),
    ],
)
def test_sampled_law_in_frequency_is_the_recursion_to_rounding(entry):
    # on Re s > 0 the transform of a held signal is a sum over its samples
    h, steps = 0.5, 400
    controller = Controller.diagonal([entry])
    rng = np.random.default_rng(3)
    r, y = rng.normal(size=(2, steps, 1))
    r[200:], y[200:] = 0.0, 0.0
    u = replay(controller, r, y, h)[:, 0]
    s = 0.3 + 1j * np.linspace(0, 6, 40)
    powers = np.exp(-np.outer(s, np.arange(steps)) * h)
    one_hold = (1 - np.exp(-s * h)) / s
    held_u, held_r = (one_hold * (powers @ signal) for signal in (u, r[:, 0]))
    sampled_y = h * (powers @ y[:, 0])
    written = controller.reference(s)[:, 0, 0] * held_r - controller(s)[:, 0, 0] * sampled_y
    assert np.max(np.abs(held_u - written)) < 1e-10 * np.max(np.abs(held_u))
    same = controller(s) @ (controller.setpoint(s) * held_r[:, None, None] - sampled_y[:, None, None])
    assert np.allclose(same[:, 0, 0], held_u, rtol=1e-9)


def test_fast_scan_tends_to_the_continuous_law():
    law = {"Kc": 0.8, "Ti": 4.0, "Td": 0.7}
    s = 1j * np.array([0.1, 1.0])
    exact = Controller.diagonal([PID(**law)])(s)
    gaps = [np.max(np.abs(Controller.diagonal([PID(**law, sample_time=h)])(s) - exact)) for h in (1e-2, 1e-3)]
    assert gaps[0] / gaps[1] == pytest.approx(10, rel=0.1)


def test_transformed_pv_has_a_frequency_function_once_linearised():
    controller = Controller.diagonal([PID(Kc=2.0, Ti=3.0, pv_transform=np.sqrt)])
    with pytest.raises(LoopError, match="linearised"):
        controller(S)
    assert np.allclose(controller.linearised([4.0])(S)[:, 0, 0], 0.25 * 2 * (1 + 1 / (3 * S)), rtol=1e-6)


def test_full_matrix_is_assembled_by_input_and_output():
    controller = Controller({(0, 1): PID(Kc=3.0), (1, 0): Linear(tf("1/(s + 1)"))}, n_u=3, n_y=2)
    q = controller(np.array([1.0]))[0]
    assert np.allclose(q, [[0, 3], [0.5, 0], [0, 0]])
    with pytest.raises(LoopError, match="as many inputs as outputs"):
        Controller({(0, 0): PID(Kc=1.0, setpoint_weight=0.0)}, n_u=2, n_y=1).setpoint(S)


@pytest.mark.parametrize(
    ("settings_given", "message"),
    [
        ({"form": "textbook", "Kc": 1}, "form must be one of"),
        ({"Ti": 3.0}, "needs Kc"),
        ({"form": "parallel", "Kp": 1.0, "Ti": 3.0}, "remove Ti"),
        ({"Kc": 1, "Ki": 2.0}, "remove Ki"),
        ({"Kc": 1, "Ti": -3.0}, "Ti is a time"),
        ({"Kc": np.nan}, "finite"),
        ({"Kc": 1, "gain_unit": "percent of span"}, "op_span and pv_span"),
        ({"Kc": 1, "anti_windup": "clamp"}, "needs limits"),
        ({"Kc": 1, "limits": (5, 1)}, "low below high"),
        ({"Kc": 1, "sample_time": 0.0}, "above 0"),
        ({"Kc": 1, "action": "up"}, "action must be one of 'reverse', 'direct'"),
    ],
)
def test_contradictory_settings_are_named(settings_given, message):
    with pytest.raises(LoopError, match=message):
        PID(**settings_given)


def test_entries_outside_the_matrix_and_conflicting_limits_are_named():
    with pytest.raises(LoopError, match="outside"):
        Controller({(2, 0): PID(Kc=1)}, 2, 2)
    with pytest.raises(LoopError, match="different limits"):
        Controller({(0, 0): PID(Kc=1, limits=(0, 1)), (0, 1): PID(Kc=1, limits=(0, 2))}, 1, 2)
