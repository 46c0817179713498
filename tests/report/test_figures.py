"""The figures draw what the curves hold, and their captions tell it."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from support.report_sample import refused, sample
from trueplant.report import captions, figures, levels, tables
from trueplant.report.decimate import compact, merged, min_max
from trueplant.report.numbers import number, percentage, probability, to_precision
from trueplant.report.tables import comparison, parameter_row, percent_scale
from trueplant.result import CoherenceCurves, Curves, MethodElement, MethodParameter, Methods, Parameter
from trueplant.result.codec import build, plain


@pytest.fixture(scope="module")
def curves() -> Curves:
    return sample().curves


def trace(figure, name, occurrence=0):
    return [t for t in figure.data if t.name == name][occurrence]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
        (0.0, "0"),
        (0.93249, "0.9325"),
        (-12.5, "-12.5"),
        (123456.7, "123457"),
        (1e-6, "1e-6"),
        (2.5e7, "2.5e7"),
        (7, "7"),
        (1234567, "1234567"),
        (0.000123456, "0.0001235"),
    ],
)
def test_numbers_have_the_digits_they_deserve(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(0.91712, 0.0123, "0.917"), (123.456, 12.0, "123"), (5.0, None, "5"), (-0.001, 0.5, "0.00"), (3e-7, 1e-8, "3e-7")],
)
def test_values_are_rounded_by_their_standard_error(value, error, text):
    assert to_precision(value, error) == text


def test_probabilities_and_percentages():
    assert [probability(p) for p in (None, 0.0004, 0.05, 1.0)] == ["–", "< 0.001", "0.050", "1.000"]
    assert [percentage(c) for c in (None, -0.01, 12.34, -123.4, 5e7)] == ["–", "0.0 %", "+12.3 %", "-123 %", "5e+07 %"]


def test_decimation_keeps_order_extremes_and_gaps():
    rng = np.random.default_rng(3)
    t, x = np.arange(100_003.0), rng.normal(size=100_003)
    x[40_000:50_000] = np.nan
    kept_t, kept_x = min_max(t, x, 1000)
    assert kept_t.size <= 1000
    assert np.all(np.diff(kept_t) > 0)
    assert np.nanmax(kept_x) == np.nanmax(x)
    assert np.nanmin(kept_x) == np.nanmin(x)
    assert np.isnan(kept_x[(kept_t > 40_300) & (kept_t < 49_700)]).all()
    assert np.isfinite(kept_x[kept_t < 39_000]).all()
    assert np.array_equal(x[kept_t.astype(int)], kept_x, equal_nan=True)


def test_short_records_are_drawn_as_they_are():
    t = np.arange(50.0)
    assert min_max(t, t**2, 100)[1].tolist() == (t**2).tolist()


def test_single_precision_only_where_it_cannot_be_seen():
    coarse, fine = np.linspace(0, 1, 9), 1e6 + np.linspace(0, 1e-3, 9)
    assert compact(coarse).dtype == np.float32
    assert compact(fine).dtype == np.float64
    assert compact(np.array([1e300, 1.0])).dtype == np.float64


def test_near_spans_become_one():
    assert merged([(5, 6), (0, 1), (1.5, 3), (2, 2.5)], 0.6) == [(0, 3), (5, 6)]


def test_step_response_draws_the_curves(curves):
    figure = figures.step_response(curves, 1, 0)
    model, plant = curves.step_model[:, 1, 0], curves.step_plant[:, 1, 0]
    shown = trace(figure, "model").y.size
    assert np.array_equal(trace(figure, "model").y, model[:shown])
    assert np.array_equal(trace(figure, "plant").y, plant[:shown])
    # the axis ends soon after all has come to rest
    for one in (model, plant):
        assert np.abs(one[shown:] - one[-1]).max() <= levels.AT_REST * np.ptp(one)
    away = max(int(np.flatnonzero(np.abs(one - one[-1]) > levels.AT_REST * np.ptp(one))[-1]) for one in (model, plant))
    assert away < shown < 2 * away
    assert trace(figure, "model").line.dash == "dash"
    assert trace(figure, "plant").line.dash == "solid"
    band = trace(figure, "plant, interval")
    assert band.y.max() == curves.step_high[:shown, 1, 0].max()
    assert figure.layout.yaxis.title.text == "%/%"
    assert figure.layout.xaxis.title.text == "Time (min)"


def test_step_caption_tells_the_values_where_its_figure_ends_rounded_as_the_tables_are(curves):
    said = captions.step_response(curves, 0, 0)
    end = trace(figures.step_response(curves, 0, 0), "plant").x.size - 1
    assert end < curves.step_t.size - 1
    low, high = (float(band[end, 0, 0]) for band in (curves.step_low, curves.step_high))
    error = (high - low) / 4
    model, plant = (to_precision(float(one[end, 0, 0]), error) for one in (curves.step_model, curves.step_plant))
    band = f"{to_precision(low, error)} to {to_precision(high, error)}"
    assert f"After {number(float(curves.step_t[end]), 3)} min: model {model}, plant {plant} ({band})" in said


def test_coherence_says_below_which_frequency_it_cannot_tell(curves):
    found = CoherenceCurves(np.array([0.5, 1.0, 2.0]), np.array([[0.2], [0.9], [0.1]]), 0.3, 0.05, True)
    slow, fast = ((((low, 1.5), None),) for low in (0.1, 0.5))
    said = captions.coherence(dataclasses.replace(curves, band=slow), found, 0)
    assert "Largest, 0.9, at 1 rad/min" in said
    assert said.endswith("slower than 0.5 rad/min, where the data speak too, its windows are too short to tell.")
    assert "windows" not in captions.coherence(dataclasses.replace(curves, band=fast), found, 0)


def test_a_magnitude_that_is_the_model_s_is_not_one_times_it(curves):
    same = dataclasses.replace(curves, bode_plant=curves.bode_model)
    assert "the plant has the model's magnitude and its phase differs by 0°" in captions.bode(same, 0, 0)


def test_phase_is_that_of_the_closed_form():
    gain, tau, theta, w = 2.0, 5.0, 4.0, np.geomspace(0.01, 20, 300)
    value = gain * np.exp(-1j * w * theta) / (1j * w * tau + 1)
    points = w[::30]
    base = sample(("y",), ("u",), experiments=1).curves
    curves = dataclasses.replace(
        base,
        w=w,
        bode_plant=value[:, None, None],
        bode_model=-value[:, None, None],
        np_w=points,
        np_value=value[::30, None, None],
        np_std=np.full((points.size, 1, 1), 0.1),
        bode_std=np.full((w.size, 1, 1), 0.1),
    )
    expected = -np.degrees(w * theta + np.arctan(w * tau))
    model, plant, estimate = figures.phases(curves, 0, 0)
    assert plant == pytest.approx(expected, abs=1e-6)
    assert estimate == pytest.approx(expected[::30], abs=1e-6)
    assert np.abs(model - plant) == pytest.approx(180, abs=1e-6)
    figure = figures.bode(curves, 0, 0, 1.96)
    assert trace(figure, "plant").y == pytest.approx(np.abs(value))
    upper = trace(figure, "plant, interval").y[: w.size]
    assert upper == pytest.approx(np.abs(value) * np.exp(0.196))


def test_frequencies_in_which_the_data_speak_are_shaded(curves):
    shapes = figures.bode(curves, 0, 1, 1.96).layout.shapes
    assert [(s.x0, s.x1) for s in shapes] == [curves.band[0][1]] * 2
    nowhere = dataclasses.replace(curves, band=((None, None), (None, None)))
    assert not figures.bode(nowhere, 0, 1, 1.96).layout.shapes
    assert "at no frequency" in captions.bode(nowhere, 0, 1)


def test_bode_caption_compares_inside_the_band_only(curves):
    inside = (curves.w >= 0.02) & (curves.w <= 0.4)
    ratio = np.abs(curves.bode_plant / curves.bode_model)[inside, 0, 0]
    assert f"the plant has {number(ratio.min(), 3)} times the model's" in captions.bode(curves, 0, 0)
    tilted = dataclasses.replace(curves, bode_plant=curves.bode_plant * (1 + curves.w)[:, None, None])
    ratio = np.abs(tilted.bode_plant / tilted.bode_model)[inside, 0, 0]
    assert f"{number(ratio.min(), 3)} to {number(ratio.max(), 3)} times" in captions.bode(tilted, 0, 0)


@pytest.mark.parametrize("missing", ["bode_model", "bode_plant"])
def test_an_element_without_one_of_its_curves_is_drawn(curves, missing):
    value = np.zeros_like(curves.bode_model) if missing == "bode_model" else np.full_like(curves.bode_model, np.nan)
    partial = dataclasses.replace(curves, **{missing: value})
    assert figures.has_response(partial.bode_model[:, 0, 0], partial.bode_plant[:, 0, 0])
    assert figures.bode(partial, 0, 0, 1.96).layout.yaxis.range is not None
    assert "cannot be compared" in captions.bode(partial, 0, 0)


@pytest.mark.parametrize("nothing", [np.zeros(5), np.full(5, np.nan), np.zeros(0)])
def test_an_element_without_any_response_is_not_drawn(nothing):
    assert not figures.has_response(np.zeros(5), nothing)
    assert figures.has_response(np.zeros(5), np.ones(5, dtype=complex))


def test_left_out_spans_are_shaded_where_they_apply(curves):
    figure = figures.trends(curves, curves.trends[0], [("y", 0), ("u", 0), ("u", 1)], 4000)
    shaded = {(t.yaxis or "y", t.text) for t in figure.data if t.meta["role"] == "excluded"}
    everywhere, limited = "left out: excluded in the project file", "left out: OP at its upper limit"
    assert shaded == {("y", everywhere), ("y2", everywhere), ("y3", everywhere), ("y2", limited)}


def test_panels_are_shared_out_evenly():
    curves = sample(("a", "b", "c"), ("d", "e", "f"), experiments=1).curves
    assert [len(group) for group in figures.trend_panels(curves)] == [3, 3]


def test_axis_follows_the_measurement_not_a_diverging_prediction():
    low, high = figures.axis_range(np.array([0.0, 1.0]), np.array([0.5, 1e9]))
    assert -0.5 < low < 0
    assert 3 <= high < 4


@pytest.mark.parametrize("limits", [[-6.0, 6.0], [-1.0, 1.0], [0.1, 0.4], [0.0, 0.7]])
def test_logarithmic_axes_have_a_few_ticks_inside(limits):
    ticks = figures.log_ticks(limits)["tickvals"]
    assert 3 <= len(ticks) <= 8
    assert all(limits[0] <= np.log10(v) <= limits[1] for v in ticks)


def test_residuals_of_joined_experiments_are_drawn_by_sample():
    curves = sample(experiments=1).curves
    found = curves.residuals[0]
    joined = dataclasses.replace(found, t=np.concatenate([found.t, found.t]), e=np.concatenate([found.e, found.e]))
    x = figures.residuals_over_time(curves, joined, "degC", 4000).data[0].x
    assert np.array_equal(x, np.arange(found.t.size * 2))


def test_correlation_caption_counts_what_is_outside():
    said = captions.correlation(np.arange(4.0), np.array([0.1, -0.5, 0.3, np.nan]), 0.2)
    assert said.startswith("2 of 3 lags lie outside ±0.2")
    assert "-0.5 at lag 1" in said


def test_unknown_plant_is_drawn_as_the_model_alone():
    curves = refused(curves=True).curves
    assert "plant, interval" not in [t.name for t in figures.step_response(curves, 0, 0).data]


def parameter(**changes):
    base = Parameter("gain", "", -2.0, -2.5, 0.1, (-2.7, -2.3), 25.0, 0.0, 0.0, True)
    return dataclasses.replace(base, **changes)


def test_drawing_shows_the_change_on_its_scale():
    drawing = parameter_row(parameter(), 50.0).drawing
    assert 'cx="96.0"' in drawing  # half of the way from the middle (66) to +50 % (126)
    assert 'd="M84.0 9H108.0"' in drawing  # 15 % to 35 %


def test_nothing_is_drawn_where_there_is_nothing_to_compare():
    for p in (parameter(plant=None, ci=None, change_percent=None), parameter(model=None, change_percent=None)):
        assert parameter_row(p, 50.0).drawing == ""


def test_scale_of_the_drawings_holds_every_change():
    elements = sample().elements
    largest = max(abs(p.change_percent) for e in elements for p in e.parameters)
    assert percent_scale(elements) >= largest


def test_methods_stand_side_by_side_and_the_rest_is_handed_on():
    one = MethodElement("y", "u", (MethodParameter("gain", 2.0, 0.1, (1.8, 2.2)),))
    bare = MethodParameter("gain", 2.05, None, None), MethodParameter("dead_time", 1.0, None, None)
    answers = {"joint": (one,), "direct": (MethodElement("y", "u", bare),)}
    found = comparison(Methods(answers, agreement=("they agree",)))
    assert found.methods == ("joint", "direct")
    assert found.others == {"agreement": ("they agree",)}
    (key, rows) = found.elements[0]
    assert key == ("y", "u")
    assert [(r.name, r.answers) for r in rows] == [
        ("gain", ("2.00 (1.80 to 2.20)", "2.05")),
        ("dead time", ("–", "1")),
    ]


def test_what_could_hide_a_large_change_is_not_called_unchanged():
    """A gain of 3.6 ± 1.9 beside a model of 4: nothing was found, and half of it could be gone."""
    wide = Parameter("gain1", "%", 4.0, 3.6, 0.95, (1.7, 5.5), -10.0, 0.7, 1.0, False)
    assert parameter_row(wide, 30.0).answer == "no change told"
    narrow = Parameter("gain1", "%", 4.0, 3.9, 0.1, (3.7, 4.1), -2.5, 0.3, 1.0, False)
    assert parameter_row(narrow, 30.0).answer == "unchanged"


def test_a_saved_result_without_a_response_is_drawn_again(curves):
    """JSON keeps no shape of an array that is empty."""
    nothing = dataclasses.replace(
        curves, np_w=np.zeros(0), np_value=np.zeros((0, 1, 1), dtype=complex), np_std=np.zeros((0, 1, 1))
    )
    again = build(Curves, plain(nothing))
    assert again.np_value.shape == (0,)
    assert len(figures.bode(again, 0, 0, 1.96).data) == len(figures.bode(nothing, 0, 0, 1.96).data)


def test_trends_and_left_out_spans_stand_in_calendar_time():
    """Across a change of the clock, and with gaps; numbers where the record has none."""
    curves = sample(experiments=1).curves
    start = datetime(2024, 3, 31, 0, 30, tzinfo=UTC)
    trend = dataclasses.replace(
        curves.trends[0],
        start=start.isoformat(),
        time_zone="Europe/Amsterdam",
        excluded=((10.0, 40.0, curves.outputs[0], "spike"),),
    )
    for figure in (
        figures.trends(curves, trend, [("y", 0)], 4000),
        figures.residuals_over_time(dataclasses.replace(curves, trends=(trend,)), curves.residuals[0], "degC", 4000),
    ):
        assert figure.layout.xaxis.type == "date" and "Europe/Amsterdam" in figure.layout.xaxis.title.text
    figure = figures.trends(curves, trend, [("y", 0)], 4000)
    lines = {trace.meta["role"]: trace for trace in figure.data}
    walls = [
        (start + timedelta(minutes=float(t))).astimezone(ZoneInfo("Europe/Amsterdam")).strftime("%Y-%m-%d %H:%M:%S")
        for t in trend.t
    ]
    assert list(lines["measured"].x) == walls
    assert list(lines["excluded"].x)[:4] == ["2024-03-31 01:40:00"] * 2 + ["2024-03-31 03:10:00"] * 2
    (row,) = tables.excluded_table(trend, curves.calendar(trend)).rows
    assert row[0] == "2024-03-31 01:40:00 CET to 2024-03-31 03:10:00 CEST"
    numeric = figures.trends(curves, curves.trends[0], [("y", 0)], 4000)
    assert numeric.layout.xaxis.type is None and "(min)" in numeric.layout.xaxis.title.text


def test_struck_samples_are_gaps_and_scale_no_axis(curves):
    """A spike of a PV is not drawn; what was left out of all signals is, but neither makes the axis longer."""
    trend = curves.trends[0]
    y = trend.y.copy()
    y[10, 0], y[40, 0] = 5000.0, 900.0
    spans = (
        (trend.t[10], trend.t[10], curves.outputs[0], "spike"),
        (trend.t[39], trend.t[41], "", "left out as asked"),
    )
    struck = dataclasses.replace(trend, y=y, excluded=spans)
    shown = figures.trends(curves, struck, [("y", 0), ("y", 1)], limit=10 * y.size)
    pv = trace(shown, "PV").y
    assert np.isnan(pv[10]) and pv[40] == 900.0
    assert max(shown.layout.yaxis.range) < 1.5 * np.nanmax(np.abs(trend.y[:, 0]))
    said = captions.trends(curves, struck, [("y", 0)])
    assert "5000" not in said and "900" not in said
    rms = np.sqrt(np.nanmean(np.delete(trend.y[:, 0] - trend.plant[:, 0], [10, 39, 40, 41]) ** 2))
    assert f"{number(float(rms), 3)} for the plant" in said
