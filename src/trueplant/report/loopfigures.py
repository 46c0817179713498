"""Figures of the loops: structured singular values over frequency, and responses before and after retuning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from trueplant.report.figures import decades, log_ticks, outline
from trueplant.report.loops import place
from trueplant.report.numbers import number
from trueplant.report.style import LIGHT, area, framed, inert, line
from trueplant.study.result import MuCurves

Array = NDArray[np.float64]

NAMES = {"model": "model", "plant": "plant", "estimate": "plant, what the data leave open"}
MOST_LINEAR = 8.0


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
    if max(top, 1.0) > MOST_LINEAR:
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
