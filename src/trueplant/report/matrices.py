"""Whole matrices of figures in one, for a notebook."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from trueplant.report import figures, levels, loopfigures
from trueplant.report.style import LIGHT, inert
from trueplant.result import Curves

PANEL, SPACING = 210, 52
Responses = NDArray[np.inexact]


def steps(curves: Curves) -> go.Figure:
    """Step responses, a row an output, a column an input."""
    return _matrix(curves, (curves.step_model, curves.step_plant), lambda i, j: figures.step_response(curves, i, j))


def bodes(curves: Curves, confidence: float) -> go.Figure:
    """Magnitude above phase of each element."""
    z = statistics.NormalDist().inv_cdf(0.5 + confidence / 2)
    return _matrix(curves, (curves.bode_model, curves.bode_plant), lambda i, j: figures.bode(curves, i, j, z))


def trends(curves: Curves, experiment: int) -> go.Figure:
    """PVs and OPs of one record, one above the other."""
    trend = curves.trends[experiment]
    panels = [panel for group in figures.trend_panels(curves) for panel in group]
    drawn = [figures.trends(curves, trend, [panel], levels.MOST_POINTS) for panel in panels]
    names = [curves.outputs[k] if kind == "y" else curves.inputs[k] for kind, k in panels]
    return combined([[one] for one in drawn], names)


def retuning(curves: Curves) -> go.Figure:
    """PV and OP after a step of the set-point and of the load, before and after, a column a loop."""
    pv, op = (
        dict(zip(*pair, strict=True))
        for pair in ((curves.outputs, curves.output_units), (curves.inputs, curves.input_units))
    )
    cases = (
        ("set-point step: PV", "setpoint", pv, 1.0),
        ("set-point step: OP", "op_setpoint", op, None),
        ("load step: PV", "load", pv, 0.0),
        ("load step: OP", "op_load", op, None),
    )
    rows, titles = [], []
    for said, name, units, goal in cases:
        row = []
        for loop in curves.retuning:
            unit = units[loop.output if units is pv else loop.input]
            row.append(loopfigures.before_after(loop.t, getattr(loop, name), curves.time_unit, unit, goal))
            titles.append(f"{loop.input} → {loop.output}, {said}")
        rows.append(row)
    return combined(rows, titles)


def _matrix(curves: Curves, both: tuple[Responses, Responses], draw: Callable[[int, int], go.Figure]) -> go.Figure:
    """A panel an element; empty where neither model nor plant (n, n_y, n_u) answers."""
    places = [[(i, j) for j in range(len(curves.inputs))] for i in range(len(curves.outputs))]
    titles = [f"{curves.inputs[j]} → {curves.outputs[i]}" for row in places for i, j in row]
    there = [[figures.has_response(both[0][:, i, j], both[1][:, i, j]) for i, j in row] for row in places]
    rows = zip(places, there, strict=True)
    return combined(
        [[draw(*p) if is_there else None for p, is_there in zip(*row, strict=True)] for row in rows], titles
    )


def combined(rows: Sequence[Sequence[go.Figure | None]], titles: Sequence[str]) -> go.Figure:
    """Figures of the same kind as one, row by row; each may have several panels above each other."""
    drawn = [figure for row in rows for figure in row if figure is not None]
    deep = max(map(_panels, drawn), default=1)
    wide, high = len(rows[0]), len(rows) * deep
    heads = iter(titles)
    named = [inert(next(heads)) if k % deep == 0 else "" for k in range(high) for _ in range(wide)]
    out = make_subplots(
        high, wide, subplot_titles=named, vertical_spacing=SPACING / (PANEL * high), horizontal_spacing=0.09
    )
    shown: set[str] = set()
    for i, row in enumerate(rows):
        for j, figure in enumerate(row):
            for trace in () if figure is None else figure.data:
                panel = int((trace.yaxis or "y")[1:] or 1) - 1
                out.add_trace(trace, row=i * deep + panel + 1, col=j + 1)
                out.data[-1].update(showlegend=trace.name not in shown, legendgroup=trace.name)
                shown.add(trace.name)
            for panel in range(0 if figure is None else _panels(figure)):
                place = {"row": i * deep + panel + 1, "col": j + 1}
                out.update_xaxes(_axis(figure, "xaxis", panel), **place)
                if i < len(rows) - 1:
                    out.update_xaxes(title_text="", **place)  # that of the lowest row serves all
                out.update_yaxes(_axis(figure, "yaxis", panel), **place)
    paper = {"paper_bgcolor": LIGHT["paper"], "plot_bgcolor": LIGHT["paper"], "hovermode": "closest"}
    legend = {"orientation": "h", "y": 1.0, "yanchor": "top", "x": 0.0, "xanchor": "left", "yref": "container"}
    font = drawn[0].layout.font if drawn else None
    out.update_layout(template=go.layout.Template(), height=PANEL * high + 80, font=font, showlegend=True, **paper)
    out.update_layout(legend=legend, margin={"l": 70, "r": 20, "t": 76, "b": 50})
    return out


def _panels(figure: go.Figure) -> int:
    return max(int((trace.yaxis or "y")[1:] or 1) for trace in figure.data) if figure.data else 1


def _axis(figure: go.Figure, kind: str, panel: int) -> dict[str, object]:
    """The axis of one panel without what says where it lies."""
    axis = getattr(figure.layout, f"{kind}{panel + 1 if panel else ''}").to_plotly_json()
    return {key: value for key, value in axis.items() if key not in ("anchor", "domain", "matches", "overlaying")}
