"""One function a figure. Each takes the frozen curves and returns a plotly figure; nothing is computed anew."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from trueplant.arrays import Array, ComplexArray, IntArray
from trueplant.lti.structure import gain_unit
from trueplant.report.decimate import at_rest, compact, merged, min_max
from trueplant.report.excluded import drawn, spans_of, used
from trueplant.report.numbers import number
from trueplant.report.style import (
    BOTTOM,
    LIGHT,
    TOP,
    area,
    framed,
    inert,
    line,
    over_time,
    shortened,
    whole_ticks,
    with_unit,
)
from trueplant.result import CoherenceCurves, Curves, Residuals, Trend

PANEL, GAP = 120, 34


def has_response(model: NDArray[np.inexact], plant: NDArray[np.inexact]) -> bool:
    """Whether one of two curves is anything but zero or unknown."""
    values = np.abs(np.concatenate([model, plant]))
    return bool(np.any(values[np.isfinite(values)] > 0))


def outline(x: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The closed outline between two curves, where both are numbers."""
    known = np.isfinite(low) & np.isfinite(high) & np.isfinite(x)
    x, low, high = x[known], low[known], high[known]
    return np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]])


def drawn_steps(curves: Curves, i: int, j: int) -> int:
    """How many instants of a step response are drawn: until it is at rest."""
    both = curves.step_model[:, i, j], curves.step_plant[:, i, j]
    moving = [one for one in both if np.isfinite(one).any() and np.nanmax(np.abs(one)) > 0]
    return at_rest(moving) or curves.step_t.size


def step_response(curves: Curves, i: int, j: int) -> go.Figure:
    """Response of output i to a unit step of input j, until it is at rest: model, plant and the plant's band."""
    figure = go.Figure()
    model, plant = curves.step_model[:, i, j], curves.step_plant[:, i, j]
    until = np.s_[: drawn_steps(curves, i, j)]
    t = curves.step_t[until]
    x, y = outline(t, curves.step_low[until, i, j], curves.step_high[until, i, j])
    if x.size:
        figure.add_trace(area("plant_band", "plant, interval", x=x, y=y, hoverinfo="skip"))
    figure.add_trace(line("plant", "plant", x=t, y=plant[until]))
    figure.add_trace(line("model", "model", x=t, y=model[until]))
    figure.update_xaxes(title_text=with_unit("Time", inert(curves.time_unit)))
    unit = gain_unit(curves.output_units[i], curves.input_units[j])
    figure.update_yaxes(title_text=inert(shortened(unit or "Response", 24)), nticks=6)
    return framed(figure, 270)


def decades(values: Array, room: float = 0.12) -> list[float] | None:
    """Range of a logarithmic axis around positive values, at most six decades down from the largest."""
    logs = np.log10(values[np.isfinite(values) & (values > 0)])
    if not logs.size:
        return None
    top = float(logs.max())
    return [max(float(logs.min()), top - 6) - room, top + room]


def log_ticks(limits: list[float] | None) -> dict[str, object]:
    """Ticks of a logarithmic axis, every label in full: decades if there are enough, else 1, 2, 5, else even steps."""
    if limits is None:
        return {}
    low, high = limits
    if high - low < 0.7:
        ticks = _even(10.0**low, 10.0**high)
    else:
        stride = max(1, math.ceil((high - low) / 6))
        digits = (1,) if high - low >= 2 else (1, 2, 5)
        powers = [p for p in range(math.floor(low), math.ceil(high) + 1) if p % stride == 0]
        ticks = [d * 10.0**p for p in powers for d in digits if low <= math.log10(d) + p <= high]
    return {"tickvals": ticks, "ticktext": [_power(v) for v in ticks]}


def _even(low: float, high: float) -> list[float]:
    """Three to seven round numbers in even steps from `low` to `high`."""
    decade = 10.0 ** math.floor(math.log10((high - low) / 3))
    step = next(m * decade for m in (5, 2, 1) if high - low >= 3 * m * decade)
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _power(value: float) -> str:
    exponent = math.floor(math.log10(value) + 1e-9)
    if -3 <= exponent <= 3:
        return number(value)
    mantissa = number(value / 10.0**exponent, 3)
    power = f"10<sup>{exponent}</sup>"
    return power if mantissa == "1" else f"{mantissa}·{power}"


def phases(curves: Curves, i: int, j: int) -> tuple[Array, Array, Array]:
    """Phase in degrees of model (n_w,), plant (n_w,) and non-parametric estimate (n_w2,), on one sheet."""

    def continuous(value: ComplexArray) -> Array:
        angle = np.where(np.abs(value) > 0, np.angle(value), np.nan)
        known = np.isfinite(angle)
        angle[known] = np.unwrap(angle[known])
        return np.degrees(angle)

    model, plant = continuous(curves.bode_model[:, i, j]), continuous(curves.bode_plant[:, i, j])
    both = np.isfinite(model) & np.isfinite(plant)
    if both.any():
        model = model - 360 * np.round((model - plant)[both][0] / 360)
    points = np.degrees(np.angle(curves.points(i, j)[0]))
    guide = plant if np.isfinite(plant).any() else model
    known = np.isfinite(guide)
    if known.any() and points.size:
        near = np.interp(curves.np_w, curves.w[known], guide[known])
        points = points - 360 * np.round((points - near) / 360)
    return model, plant, points


def bode(curves: Curves, i: int, j: int, z: float) -> go.Figure:
    """Magnitude and phase of element (i, j); bands of z standard errors; the estimate without a model as points.

    The band of the magnitude is |G| exp(-+ z s), s the relative standard error: it cannot cross zero.
    """
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    w, model, plant = curves.w, np.abs(curves.bode_model[:, i, j]), np.abs(curves.bode_plant[:, i, j])
    model, plant = np.where(model > 0, model, np.nan), np.where(plant > 0, plant, np.nan)
    phase_model, phase_plant, phase_points = phases(curves, i, j)
    spread = z * np.minimum(curves.bode_std[:, i, j], 50.0)
    wide = np.degrees(np.minimum(spread, np.pi))
    bands = [
        outline(w, plant * np.exp(-spread), plant * np.exp(spread)),
        outline(w, phase_plant - wide, phase_plant + wide),
    ]
    estimate, error = curves.points(i, j)
    value = np.abs(estimate)
    known = np.isfinite(value) & (value > 0)
    w_points, value, error, phase_points = curves.np_w[known], value[known], error[known], phase_points[known]
    angle_error = np.degrees(np.minimum(error / value, np.pi))
    points: list[tuple[Array, dict[str, object]]] = [
        (value, {"array": error, "arrayminus": np.minimum(error, 0.99 * value)}),
        (phase_points, {"array": angle_error}),
    ]
    for row, curve in enumerate([(plant, model), (phase_plant, phase_model)], start=1):
        x, y = bands[row - 1]
        if x.size:
            figure.add_trace(area("plant_band", "plant, interval", x=x, y=y, hoverinfo="skip"), row=row, col=1)
        if w_points.size:
            y, bars = points[row - 1]
            bars |= {"type": "data", "thickness": 1, "width": 2, "color": LIGHT["points"]}
            marker = {"color": LIGHT["points"], "size": 5, "symbol": "circle-open"}
            name, meta = inert(curves.np_label or "estimate"), {"role": "points"}
            dots = go.Scatter(x=w_points, y=y, error_y=bars, mode="markers", marker=marker, name=name, meta=meta)
            figure.add_trace(dots, row=row, col=1)
        figure.add_trace(line("plant", "plant", x=w, y=curve[0]), row=row, col=1)
        figure.add_trace(line("model", "model", x=w, y=curve[1]), row=row, col=1)
    _shade_band(figure, curves.band[i][j])

    curves_only = np.concatenate([model, plant])
    close = (value > np.nanmin(curves_only) / 10) & (value < np.nanmax(curves_only) * 10)
    magnitudes = decades(np.concatenate([curves_only, value[close]]))
    angles = np.concatenate([phase_model, phase_plant])
    highest = float(np.nanmax(angles)) + 12
    lowest = max(float(np.nanmin(angles)) - 12, highest - 900)
    tick = next(step for step in (15, 45, 90, 180) if (highest - lowest) / step <= 6)
    frequencies = decades(w, room=0.0)
    figure.update_xaxes(type="log", range=frequencies, **log_ticks(frequencies))
    figure.update_xaxes(title_text=f"Frequency (rad/{inert(curves.time_unit)})", row=2, col=1)
    unit = gain_unit(curves.output_units[i], curves.input_units[j])
    title = inert(shortened(unit or "Magnitude", 18))
    figure.update_yaxes(type="log", title_text=title, range=magnitudes, row=1, col=1, **log_ticks(magnitudes))
    figure.update_yaxes(title_text="Phase (°)", range=[lowest, highest], dtick=tick, row=2, col=1)
    return framed(figure, 380)


def _shade_band(figure: go.Figure, band: tuple[float, float] | None) -> None:
    if band is None:
        return
    for x, y in (("x", "y domain"), ("x2", "y2 domain")):
        figure.add_shape(
            type="rect",
            xref=x,
            yref=y,
            x0=band[0],
            x1=band[1],
            y0=0,
            y1=1,
            name="speaks",
            fillcolor=LIGHT["speaks"],
            line_width=0,
            layer="below",
        )


def axis_range(main: Array, also: Array) -> list[float]:
    """Range of a linear axis that shows all of `main`, and of `also` what lies within two spans of it."""
    main, also = main[np.isfinite(main)], also[np.isfinite(also)]
    if not main.size:
        main = also if also.size else np.array([0.0, 1.0])
    low, high = float(main.min()), float(main.max())
    span = high - low or abs(high) or 1.0
    if also.size:
        low = min(low, max(float(also.min()), low - 2 * span))
        high = max(high, min(float(also.max()), high + 2 * span))
    room = 0.06 * (high - low or span)
    return [low - room, high + room]


def trend_panels(curves: Curves, most: int = 4) -> list[list[tuple[str, int]]]:
    """The panels ("y" or "u", index) of each figure of an experiment, at most `most` in a figure."""
    panels = [("y", i) for i in range(len(curves.outputs))] + [("u", j) for j in range(len(curves.inputs))]
    count = math.ceil(len(panels) / most)
    cuts = [round(k * len(panels) / count) for k in range(count + 1)]
    return [panels[a:b] for a, b in pairwise(cuts)]


def trends(curves: Curves, trend: Trend, panels: Sequence[tuple[str, int]], limit: int) -> go.Figure:
    """SP, PV and OP of one experiment over time, with the predictions and the spans that were left out."""
    height = TOP + BOTTOM + PANEL * len(panels) + GAP * (len(panels) - 1)
    inner = height - TOP - BOTTOM
    names = {"y": curves.outputs, "u": curves.inputs}
    units = {"y": curves.output_units, "u": curves.input_units}
    figure = make_subplots(
        rows=len(panels),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=GAP / inner if len(panels) > 1 else 0,
        subplot_titles=[inert(shortened(names[kind][k])) for kind, k in panels],
    )
    figure.update_annotations(x=0, xanchor="left", font_size=12)
    calendar = curves.calendar(trend)
    for row, (kind, k) in enumerate(panels, start=1):
        inside = used(curves, trend, names[kind][k])
        if kind == "y":
            signals = [
                ("measured", "PV", drawn(trend, names[kind][k], trend.y[:, k]), "linear"),
                ("setpoint", "SP", trend.r[:, k], "hv"),
                ("plant", "plant", trend.plant[:, k], "linear"),
                ("model", "model", trend.model[:, k], "linear"),
            ]
            known = np.concatenate([trend.y[inside, k], trend.r[inside, k]])
            limits = axis_range(known, np.concatenate([trend.model[inside, k], trend.plant[inside, k]]))
        else:
            signals = [("measured", "OP", drawn(trend, names[kind][k], trend.u[:, k]), "hv")]
            limits = axis_range(trend.u[inside, k], np.zeros(0))
        for shade in _excluded(curves, trend, names[kind][k], limits):
            figure.add_trace(shade, row=row, col=1)
        for role, name, x, shape in signals:
            if np.isfinite(x).any():
                t, shown = min_max(trend.t, x, limit)
                trace = line(role, name, x=calendar.axis(t), y=compact(shown))
                trace.line.shape = shape
                figure.add_trace(trace, row=row, col=1)
        unit = inert(shortened(units[kind][k], 16))
        figure.update_yaxes(title_text=unit, range=limits, nticks=5, row=row, col=1)
    return over_time(framed(figure, height), calendar, trend.t, len(panels))


def _excluded(curves: Curves, trend: Trend, signal: str, limits: list[float]) -> list[go.Scatter]:
    """Shading of the spans left out of `signal`; a span that names no signal concerns all of them."""
    calendar = curves.calendar(trend)
    by_reason: dict[str, list[tuple[float, float]]] = {}
    for low, high, reason in spans_of(curves, trend, signal):
        by_reason.setdefault(reason, []).append((low, high))
    shades = []
    pixel = (float(trend.t[-1]) - float(trend.t[0])) / 2000 if trend.t.size else 0.0
    for reason, spans in by_reason.items():
        corners = [
            ([low, low, max(high, low + pixel), max(high, low + pixel), None], [*limits, *limits[::-1], None])
            for low, high in merged(spans, pixel)
        ]
        x = [v for xs, _ in corners for v in xs]
        y = [v for _, ys in corners for v in ys]
        said = inert(f"left out: {reason}")
        shades.append(area("excluded", said, x=calendar.axis(x), y=y, hoveron="fills", hoverinfo="text", text=said))
    return shades


def residuals_over_time(curves: Curves, found: Residuals, unit: str, limit: int) -> go.Figure:
    """Prediction errors over time; by sample number where several experiments follow each other."""
    calendar = curves.calendar(curves.trends[0] if len(curves.trends) == 1 else None)
    in_order = bool(np.all(np.diff(found.t) > 0))
    t = found.t if in_order else np.arange(found.t.size, dtype=float)
    x, e = min_max(t, found.e, limit)
    figure = go.Figure(line("measured", "prediction error", x=calendar.axis(x) if in_order else x, y=compact(e)))
    figure.update_yaxes(title_text=inert(shortened(unit or "Error", 16)), nticks=5)
    if in_order:
        return over_time(framed(figure, 210), calendar, t)
    figure.update_xaxes(title_text="Sample (all experiments, one after the other)")
    return whole_ticks(framed(figure, 210), t)


def correlation(lags: Array | IntArray, value: Array, bound: float) -> go.Figure:
    """A correlation over lags with the bound within which it is due to chance."""
    figure = go.Figure()
    stems = np.repeat(lags, 3).astype(float)
    heights = np.column_stack([np.zeros_like(value), value, np.full_like(value, np.nan)]).ravel()
    figure.add_trace(line("stem", "correlation", x=stems, y=heights, hoverinfo="skip"))
    marker = {"color": LIGHT["plant"], "size": 5}
    meta = {"role": "plant"}
    dots = go.Scatter(x=lags, y=value, mode="markers", marker=marker, name="correlation", meta=meta)
    figure.add_trace(dots)
    if lags.size and math.isfinite(bound):
        ends = [float(lags[0]), float(lags[-1])]
        for sign in (1, -1):
            figure.add_trace(line("bound", "bound", x=ends, y=[sign * bound] * 2))
    figure.update_xaxes(title_text="Lag (samples)")
    figure.update_yaxes(title_text="Correlation", nticks=6)
    return framed(figure, 230)


def coherence(curves: Curves, found: CoherenceCurves, i: int) -> go.Figure:
    """Multiple coherence of output i over frequency, and the level that noise alone seldom exceeds."""
    frequencies = decades(found.w, room=0.0)
    figure = go.Figure(line("plant", "coherence", x=found.w, y=found.multiple[:, i]))
    figure.add_trace(line("bound", "level of noise", x=[found.w[0], found.w[-1]], y=[found.level] * 2))
    unit = inert(curves.time_unit)
    figure.update_xaxes(type="log", title_text=f"Frequency (rad/{unit})", range=frequencies, **log_ticks(frequencies))
    figure.update_yaxes(title_text="Coherence (-)", range=[-0.02, 1.02], dtick=0.25)
    return framed(figure, 230)


def condition(curves: Curves) -> go.Figure:
    """Condition number of the excitation over frequency."""
    figure = go.Figure(line("plant", "condition number", x=curves.condition_w, y=curves.condition))
    frequencies = decades(curves.condition_w, room=0.0)
    values = decades(np.append(curves.condition, [1.0]))
    unit = inert(curves.time_unit)
    figure.update_xaxes(type="log", title_text=f"Frequency (rad/{unit})", range=frequencies, **log_ticks(frequencies))
    figure.update_yaxes(type="log", title_text="Condition number (-)", range=values, **log_ticks(values))
    return framed(figure, 270)
