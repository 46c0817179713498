"""Whole matrices of figures in one, for a notebook."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from trueplant.report import figures, levels, loopfigures
from trueplant.report.style import LIGHT, inert
from trueplant.result import Curves

PANEL, GAP = 210, 0.08


def steps(curves: Curves) -> go.Figure:
    """Step responses, a row an output, a column an input."""
    return _matrix(curves, lambda i, j: figures.step_response(curves, i, j))


def bodes(curves: Curves, confidence: float) -> go.Figure:
    """Magnitude above phase of each element."""
    z = statistics.NormalDist().inv_cdf(0.5 + confidence / 2)
    return _matrix(curves, lambda i, j: figures.bode(curves, i, j, z))


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


def _matrix(curves: Curves, draw: Callable[[int, int], go.Figure]) -> go.Figure:
    places = [[(i, j) for j in range(len(curves.inputs))] for i in range(len(curves.outputs))]
    titles = [f"{curves.inputs[j]} → {curves.outputs[i]}" for row in places for i, j in row]
    return combined([[draw(i, j) for i, j in row] for row in places], titles)


def combined(rows: Sequence[Sequence[go.Figure]], titles: Sequence[str]) -> go.Figure:
    """Figures of the same kind as one, row by row; each may have several panels above each other."""
    deep = max(_panels(figure) for row in rows for figure in row)
    wide, high = len(rows[0]), len(rows) * deep
    heads = iter(titles)
    named = [inert(next(heads)) if k % deep == 0 else "" for k in range(high) for _ in range(wide)]
    out = make_subplots(high, wide, subplot_titles=named, vertical_spacing=GAP / high * 2.5, horizontal_spacing=0.09)
    shown: set[str] = set()
    for i, row in enumerate(rows):
        for j, figure in enumerate(row):
            for trace in figure.data:
                panel = int((trace.yaxis or "y")[1:] or 1) - 1
                out.add_trace(trace, row=i * deep + panel + 1, col=j + 1)
                out.data[-1].update(showlegend=trace.name not in shown, legendgroup=trace.name)
                shown.add(trace.name)
            for panel in range(_panels(figure)):
                place = {"row": i * deep + panel + 1, "col": j + 1}
                out.update_xaxes(_axis(figure, "xaxis", panel), **place)
                out.update_yaxes(_axis(figure, "yaxis", panel), **place)
    paper = {"paper_bgcolor": LIGHT["paper"], "plot_bgcolor": LIGHT["paper"], "hovermode": "closest"}
    legend = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 1.0, "xanchor": "right", "yref": "container"}
    font = rows[0][0].layout.font
    out.update_layout(template=go.layout.Template(), height=PANEL * high + 80, font=font, showlegend=True, **paper)
    out.update_layout(legend=legend, margin={"l": 70, "r": 20, "t": 70, "b": 50})
    return out


def _panels(figure: go.Figure) -> int:
    return max(int((trace.yaxis or "y")[1:] or 1) for trace in figure.data) if figure.data else 1


def _axis(figure: go.Figure, kind: str, panel: int) -> dict[str, object]:
    """The axis of one panel without what says where it lies."""
    axis = getattr(figure.layout, f"{kind}{panel + 1 if panel else ''}").to_plotly_json()
    return {key: value for key, value in axis.items() if key not in ("anchor", "domain", "matches", "overlaying")}
