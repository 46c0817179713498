"""A law keeps its transfer function through every form, unit and way to show it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.tune.forms import Notation, Settings, converted, pid_of, series_ratio, settings_of

S = 1j * np.geomspace(1e-3, 1e3, 40) + 0.01
positive = st.floats(0.01, 100.0)
filters = st.floats(0.01, 0.5)
ratios = st.floats(1.0, 50.0)  # Ti/Td of a series form; below 1 the filter can turn the sign of Kd in the others


def same_law(a: PID, b: PID, scale: float = 1.0) -> None:
    np.testing.assert_allclose(a.feedback(S * scale), b.feedback(S), rtol=1e-9)


@given(kc=st.one_of(positive, positive.map(lambda x: -x)), td=positive, ratio=ratios, alpha=filters)
@settings(max_examples=80, deadline=None)
def test_series_survives_the_other_forms(kc, td, ratio, alpha):
    ti = ratio * td
    pid = PID(form="series", Kc=kc, Ti=ti, Td=td, alpha=alpha, setpoint_weight=0.3)
    ideal = converted(pid, "ideal")
    for other in (ideal, converted(pid, "parallel"), converted(ideal, "series")):
        same_law(other, pid)
        assert other.setpoint_weight == 0.3
    back = converted(converted(pid, "parallel"), "series")
    assert (back.Ti, back.Td) == pytest.approx((ti, td), rel=1e-5)


@given(kc=positive, td=positive, ratio=st.floats(0.5, 20.0))
@settings(max_examples=80, deadline=None)
def test_unfiltered_ideal_has_a_series_form_exactly_from_four_derivative_times(kc, td, ratio):
    pid = PID(Kc=kc, Ti=ratio * td, Td=td, alpha=0.0)
    if ratio >= 4:
        same_law(converted(pid, "series"), pid)
    elif ratio < 4 * (1 - 1e-9):
        with pytest.raises(LoopError, match="Ti >= 4 Td"):
            converted(pid, "series")


@pytest.mark.parametrize("alpha", [0.0, 0.1, 0.5])
def test_shortest_integral_time_with_a_series_form(alpha):
    ratio = series_ratio(alpha)
    pid = PID(Kc=1.0, Ti=ratio * (1 + 1e-9) * 3, Td=3.0, alpha=alpha)
    same_law(converted(pid, "series"), pid)
    with pytest.raises(LoopError, match="no series form"):
        converted(PID(Kc=1.0, Ti=ratio * (1 - 1e-6) * 3, Td=3.0, alpha=alpha), "series")


def test_known_series_to_ideal_conversion():
    # without filter Kc' = Kc (1 + Td/Ti), Ti' = Ti + Td, Td' = Ti Td/(Ti + Td)
    ideal = converted(PID(form="series", Kc=0.5, Ti=1.5, Td=1.0, alpha=0.0), "ideal")
    assert (ideal.Kc, ideal.Ti, ideal.Td) == pytest.approx((0.5 * (1 + 1 / 1.5), 2.5, 0.6))


@pytest.mark.parametrize(
    "pid",
    [
        PID(form="parallel", Kp=0.0, Ki=1.0),
        PID(form="parallel", Kp=1.0, Ki=-1.0),
        PID(form="series", Kc=1.0, Ti=2.0, Td=1.0, alpha=1.5),
    ],
)
def test_no_ideal_equivalent_is_refused(pid):
    with pytest.raises(LoopError, match="no ideal form"):
        converted(pid, "ideal")


def test_pd_and_p_keep_their_form():
    for pid in (PID(Kc=2.0), PID(Kc=-2.0, Td=0.5), PID(form="series", Kc=2.0, Td=0.5, alpha=0.2)):
        for form in ("ideal", "series", "parallel"):
            same_law(converted(pid, form), pid)


notations = st.builds(
    lambda form, band, integral, how, unit, action, spans: Notation(
        form,
        "proportional band" if band and spans else "gain",
        integral,
        "time" if form == "parallel" else how,
        unit,
        action,
        "percent of span" if spans else "engineering",
        *(spans or (None, None)),
    ),
    st.sampled_from(["ideal", "series", "parallel"]),
    st.booleans(),
    st.sampled_from(["time", "repeats"]),
    st.sampled_from(["ratio", "divisor", "time"]),
    st.sampled_from(["ms", "s", "min", "h", "d"]),
    st.booleans(),
    st.one_of(st.none(), st.tuples(positive, positive)),
)


@given(
    notation=notations,
    kc=st.one_of(positive, positive.map(lambda x: -x)),
    ti=st.one_of(st.none(), positive),
    ratio=st.one_of(st.none(), ratios),
    alpha=st.one_of(st.just(0.0), filters),
)
@settings(max_examples=200, deadline=None)
def test_settings_round_trip(notation, kc, ti, ratio, alpha):
    td = 0.0 if ratio is None else (ti or 1.0) / ratio
    pid = PID(form="series", Kc=kc, Ti=ti, Td=td, alpha=alpha, limits=(0.0, 1.0))
    shown = settings_of(pid, notation, "min")
    back = pid_of(shown, notation, "min", like=pid)
    same_law(back, pid)
    assert back.limits == (0.0, 1.0)
    if notation.shows_action:
        assert shown.gain > 0 and shown.action == ("direct" if kc < 0 else "reverse")


def test_vendor_numbers():
    # 2 %/% is a band of 50 %; 120 s are 0.5 repeats a minute; alpha 0.1 is N = 10
    notation = Notation("ideal", "proportional band", "repeats", "divisor", "min", True, "percent of span", 100, 400)
    pid = PID(Kc=-0.5, Ti=120.0, Td=30.0, alpha=0.1)
    assert settings_of(pid, notation, "s") == Settings(50.0, 0.5, 0.5, 10.0, "direct")
    parallel = Notation("parallel", derivative_filter="time", time_unit="s", shows_action=False)
    shown = settings_of(pid_of(Settings(50.0, 0.5, 0.5, 10.0, "direct"), notation, "min"), parallel, "min")
    assert (shown.gain, shown.integral, shown.derivative, shown.derivative_filter) == pytest.approx(
        (-0.5, -0.5 / 120, -15.0, 3.0)
    )


def test_contradicting_notations_are_refused():
    for wrong in (
        {"gain": "proportional band"},
        {"form": "parallel"},
        {"time_unit": "fortnight"},
        {"gain_unit": "percent of span"},
    ):
        with pytest.raises(LoopError, match="must|needs|percent|time"):
            Notation(**wrong)
    with pytest.raises(LoopError, match="action must be"):
        pid_of(Settings(1.0, 1.0, 0.0, None, None), Notation(), "s")
    with pytest.raises(LoopError, match="above 0"):
        pid_of(Settings(1.0, 0.0, 0.0, None, "reverse"), Notation(), "s")
    with pytest.raises(LoopError, match="time_unit"):
        settings_of(PID(Kc=1.0), Notation(), "fortnight")
