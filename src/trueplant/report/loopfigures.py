"""Figures of the loops: structured singular values over frequency, and responses before and after retuning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from trueplant.arrays import Array
from trueplant.report import levels
from trueplant.report.decimate import compact, min_max
from trueplant.report.figures import axis_range, decades, log_ticks, outline
from trueplant.report.loops import place
from trueplant.report.numbers import number
from trueplant.report.style import LIGHT, area, framed, inert, line, shortened, whole_ticks, with_unit
from trueplant.result import MuCurves, RetuningCurves

NAMES = {"model": "model", "plant": "plant", "estimate": "plant, what the data leave open"}


def mu_span(curves: Sequence[MuCurves]) -> tuple[float, float]:
    """The frequencies between which any of the curves moves by more than 1 % of its peak, with some room."""
    lows, highs = [], []
    for one in curves:
        for bounds in one.bounds.values():
            upper = bounds[:, 1]
            moves = [np.flatnonzero(np.abs(upper - end) > 0.01 * upper.max()) for end in (upper[0], upper[-1])]
            if all(found.size for found in moves):
                lows.append(one.w[moves[0][0]])
                highs.append(one.w[moves[1][-1]])
    if not lows:
        return 1e-3, 1e3
    return float(min(lows)) / 3, float(max(highs)) * 1.5


def mu_test(curves: Sequence[MuCurves], test: str, time_unit: str) -> go.Figure:
    """One test over frequency for every system: upper bound, band down to the lower one, peak, and the line at 1."""
    figure = go.Figure()
    low, high = mu_span(curves)
    shown = [one for one in curves if test in one.bounds]
    top = max((float(one.bounds[test][:, 1].max()) for one in shown), default=1.0)
    figure.add_trace(line("limit", "limit", x=[low, high], y=[1.0, 1.0], hoverinfo="skip"))
    for one in shown:
        inside = (one.w >= low) & (one.w <= high)
        w, bounds = one.w[inside], one.bounds[test][inside]
        # the left edge stands for all lower frequencies
        w, bounds = np.append(low, w), np.vstack([bounds[:1], bounds])
        if np.any(bounds[:, 1] - bounds[:, 0] > 1e-3 * top):
            x, y = outline(w, bounds[:, 0], bounds[:, 1])
            figure.add_trace(area("plant_band", "between the bounds", x=x, y=y, hoverinfo="skip"))
        figure.add_trace(line(one.system, NAMES[one.system], x=w, y=bounds[:, 1]))
        frequency, peak = one.peaks[test]
        if np.isfinite(peak):
            marker = {"color": LIGHT[one.system], "size": 9, "symbol": "diamond-open", "line": {"width": 2}}
            at = {"x": [max(frequency, low)], "y": [peak], "cliponaxis": False}
            figure.add_trace(go.Scatter(mode="markers", marker=marker, name="peak", meta={"role": one.system}, **at))
    frequencies = [np.log10(low), np.log10(high)]
    figure.update_xaxes(
        type="log", range=frequencies, title_text=f"Frequency (rad/{inert(time_unit)})", **log_ticks(frequencies)
    )
    title = "σ<sub>max</sub>(w<sub>P</sub>S)" if test == "NP" else "µ"
    if max(top, 1.0) > levels.MOST_LINEAR:
        values = decades(np.concatenate([[1.0], *(one.bounds[test][:, 1] for one in shown)]))
        figure.update_yaxes(type="log", range=values, title_text=title, **log_ticks(values))
    else:
        figure.update_yaxes(range=[0, 1.12 * max(top, 1.0)], title_text=title, nticks=6)
    return framed(figure, 270)


def mu_caption(curves: Sequence[MuCurves], test: str, time_unit: str) -> str:
    """Peaks in words."""
    said = []
    for one in curves:
        if test in one.peaks:
            frequency, peak = one.peaks[test]
            verdict = "passes" if peak < 1 else "fails"
            name = NAMES[one.system]
            value = f"{number(peak, 3)} {place(frequency, time_unit)}"
            said.append(f"{name[0].upper()}{name[1:]}: {value}, {verdict}.")
    return " ".join(said)


def before_after(t: Array, responses: Mapping[str, Array], time_unit: str, unit: str, goal: float | None) -> go.Figure:
    """A response (n_t, 3: low, value, high) before and after, with the bands over the drawn plants; goal: where to."""
    figure = go.Figure()
    for role in ("before", "after"):
        x, y = outline(t, responses[role][:, 0], responses[role][:, 2])
        if x.size:
            figure.add_trace(area(f"{role}_band", f"{role}, interval", x=x, y=y, hoverinfo="skip"))
    if goal is not None:
        figure.add_trace(line("setpoint", "set-point", x=[float(t[0]), float(t[-1])], y=[goal, goal], hoverinfo="skip"))
    for role in ("before", "after"):
        figure.add_trace(line(role, role, x=t, y=responses[role][:, 1]))
    values = np.concatenate([responses[role][:, 1] for role in ("before", "after")])
    bands = np.concatenate([responses[role][:, (0, 2)].ravel() for role in ("before", "after")])
    known = values if goal is None else np.append(values, goal)
    figure.update_xaxes(title_text=with_unit("Time", inert(time_unit)))
    figure.update_yaxes(title_text=inert(shortened(unit or "Response", 24)), nticks=6, range=axis_range(known, bands))
    return framed(figure, 250)


def until_settled(curves: RetuningCurves) -> int:
    """How many of the times to draw: half as long again as any response, before or after, needs to come to rest."""
    last = 0
    for responses in (curves.setpoint, curves.load, curves.op_setpoint, curves.op_load):
        for values in responses.values():
            y = values[:, 1]
            if np.isfinite(y).all():
                moving = np.flatnonzero(np.abs(y - y[-1]) > 0.02 * np.ptp(y))
                last = max(last, int(moving[-1]) if moving.size else 0)
    return min(curves.t.size, 3 * last // 2 + 2) if last else curves.t.size


def settling_caption(t: Array, responses: Mapping[str, Array], time_unit: str) -> str:
    """From when on PV stays within 5 % of a unit step of the set-point."""
    said = []
    for role in ("before", "after"):
        outside = np.flatnonzero(~(np.abs(responses[role][:, 1] - 1) <= 0.05))
        reached = outside.size == 0 or outside[-1] + 1 < t.size
        when = number(float(t[outside[-1] + 1] if outside.size else t[0]), 3) if reached else ""
        said.append(f"from {when} {time_unit} on {role}".replace("  ", " ") if reached else f"not in this time {role}")
    return f"Within 5 % of the step {', '.join(said)}."


def size_caption(what: str, responses: Mapping[str, Array], unit: str) -> str:
    """The largest value of either sign before and after."""
    sizes = [float(np.max(np.abs(responses[role][:, 1]))) for role in ("before", "after")]
    before, after = (number(size, 3) if np.isfinite(size) else "no bound" for size in sizes)
    return f"{what}: {before} before, {after} after{f' ({unit})' if unit else ''}."


def replay(t: Array, errors: Mapping[str, Array], time_unit: str, unit: str, limit: int) -> go.Figure:
    """Control error under the disturbance recovered from the record: as it was, and before and after retuning."""
    figure = go.Figure()
    for name, role in (("record", "measured"), ("before", "before"), ("after", "after")):
        if name in errors:
            x, y = min_max(t, errors[name], limit)
            trace = line(role, name, x=x, y=compact(y))
            trace.line.update(width=1.2, dash="solid")
            figure.add_trace(trace)
    figure.update_xaxes(title_text=with_unit("Time", inert(time_unit)))
    figure.update_yaxes(title_text=inert(shortened(with_unit("SP - PV", unit), 24)), nticks=5)
    return whole_ticks(framed(figure, 250), t)


def replay_caption(errors: Mapping[str, Array], unit: str) -> str:
    """The size of the errors."""
    space = f" {unit}" if unit else ""
    names = {"record": "As recorded", "before": "Today's controller, simulated", "after": "New settings, simulated"}
    said = [
        f"{names[key]}: {number(float(np.sqrt(np.nanmean(errors[key] ** 2))), 3)}{space} (rms)."
        for key in names
        if key in errors and np.isfinite(errors[key]).any()
    ]
    return " ".join(said)
