"""What all figures share: colours, lines, axes, and text that cannot be mistaken for markup.

The colours are those of Okabe and Ito (2008), which stay apart for colour-blind readers; line
pattern and marker differ as well, so that the figures can be read in black and white. Each trace
bears its role in `meta`, by which the page recolours it for a dark screen or for paper.
"""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.printable import printable
from trueplant.result import Calendar

LIGHT = {
    "ink": "#1b1f24",
    "grid": "#dfe3e8",
    "axis": "#8a929c",
    "paper": "#ffffff",
    "measured": "#1b1f24",
    "setpoint": "#007d5a",
    "model": "#be4800",
    "plant": "#0072b2",
    "stem": "#0072b2",
    "plant_band": "rgba(0,114,178,0.20)",
    "points": "#a8487d",
    "excluded": "rgba(230,159,0,0.30)",
    "speaks": "rgba(0,158,115,0.13)",
    "bound": "#be4800",
    "limit": "#1b1f24",
    "estimate": "#8a3d6b",
    "before": "#be4800",
    "after": "#0072b2",
    "before_band": "rgba(190,72,0,0.17)",
    "after_band": "rgba(0,114,178,0.20)",
}
DARK = {
    "ink": "#e6e9ed",
    "grid": "#343b44",
    "axis": "#7d8793",
    "paper": "#14181d",
    "measured": "#f2f4f7",
    "setpoint": "#2fc79a",
    "model": "#f0a020",
    "plant": "#56b4e9",
    "stem": "#56b4e9",
    "plant_band": "rgba(86,180,233,0.25)",
    "points": "#dd9abf",
    "excluded": "rgba(230,159,0,0.34)",
    "speaks": "rgba(0,190,140,0.16)",
    "bound": "#f0a020",
    "limit": "#f2f4f7",
    "estimate": "#dd9abf",
    "before": "#f0a020",
    "after": "#56b4e9",
    "before_band": "rgba(240,160,32,0.22)",
    "after_band": "rgba(86,180,233,0.25)",
}
DASH = {"model": "dash", "setpoint": "dashdot", "bound": "dot", "limit": "dot", "estimate": "dashdot", "before": "dash"}
WIDTH = {"measured": 1.2, "setpoint": 1.6, "stem": 1.2, "bound": 1.4, "limit": 1.4}
"""2 where nothing is said."""
LEFT, RIGHT, TOP, BOTTOM = 64, 14, 26, 48
"""Margins in pixels, equal in all figures so that their axes line up."""


_LINE = 18
"""Pixels of the second line of labels, the date below the clock."""
_DATES = [
    {"dtickrange": [None, 60_000], "value": "%H:%M:%S\n%Y-%m-%d"},
    {"dtickrange": [60_000, 86_400_000 - 1], "value": "%H:%M\n%Y-%m-%d"},
    {"dtickrange": [86_400_000, "M1"], "value": "%Y-%m-%d"},
    {"dtickrange": ["M1", None], "value": "%Y-%m"},
]
"""Labels of a time axis by the distance of its ticks in ms ("M1": a month)."""


def inert(text: str) -> str:
    """User text for a figure: no pseudo-HTML and no hover-template fields."""
    return html.escape(printable(text), quote=False).replace("%{", "%&#123;")


def shortened(text: str, length: int = 40) -> str:
    """`text`, or its beginning and end where it is longer than `length`."""
    if len(text) <= length:
        return text
    head = (length - 1) * 2 // 3
    return f"{text[:head]}…{text[head + 1 - length :]}"


def with_unit(label: str, unit: str) -> str:
    """Axis label ``label (unit)``."""
    return f"{label} ({unit})" if unit else label


def line(role: str, name: str, **extra: object) -> go.Scatter:
    """A line in the colour, pattern and width of its role."""
    pen = {"color": LIGHT[role], "dash": DASH.get(role, "solid"), "width": WIDTH.get(role, 2)}
    return go.Scatter(mode="lines", name=inert(name), meta={"role": role}, line=pen, **extra)


def area(role: str, name: str, **extra: object) -> go.Scatter:
    """A filled closed outline without a border."""
    return go.Scatter(
        mode="lines",
        line={"width": 0},
        fill="toself",
        fillcolor=LIGHT[role],
        meta={"role": role},
        name=inert(name),
        **extra,
    )


def framed(figure: go.Figure, height: int) -> go.Figure:
    """`figure` with the margins, fonts and axes that all share, `height` pixels high."""
    figure.update_layout(
        template=go.layout.Template(),
        height=height,
        autosize=True,
        margin={"l": LEFT, "r": RIGHT, "t": TOP, "b": BOTTOM},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"size": 12, "color": LIGHT["ink"], "family": "system-ui, sans-serif"},
        showlegend=False,
        hovermode="closest",
        hoverlabel={"namelength": -1},
    )
    axis = {
        "gridcolor": LIGHT["grid"],
        "linecolor": LIGHT["axis"],
        "showline": True,
        "mirror": True,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": LIGHT["axis"],
        "zeroline": False,
        "exponentformat": "power",
        "showexponent": "all",
        "title_standoff": 8,
        "title_font_size": 12,
    }
    figure.update_xaxes(**axis)
    figure.update_yaxes(automargin=True, **axis)
    return figure


def over_time(
    figure: go.Figure, calendar: Calendar, span: Sequence[float] | Array, row: int | None = None
) -> go.Figure:
    """`figure` with a time axis: dates and clock times where there are time stamps. `row`: of panels, the lowest."""
    place = {} if row is None else {"row": row, "col": 1}
    figure.update_xaxes(title_text=with_unit("Time", inert(calendar.label)), **place)
    if calendar.start is not None:
        figure.update_xaxes(type="date", tickformatstops=_DATES)
        figure.update_layout(height=figure.layout.height + _LINE, margin_b=BOTTOM + _LINE)
    if len(span):
        figure.update_xaxes(range=list(calendar.axis([float(span[0]), float(span[-1])])))
    return figure if calendar.start is not None else whole_ticks(figure, np.asarray(span, dtype=float))


def whole_ticks(figure: go.Figure, t: NDArray[np.float64]) -> go.Figure:
    """`figure` with times written in full where they have at most nine digits before the point."""
    largest = float(np.abs(t).max(initial=0.0))
    if 1 <= largest < 1e9:
        figure.update_xaxes(exponentformat="none", separatethousands=True)
    return figure
