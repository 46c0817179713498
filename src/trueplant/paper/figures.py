"""The paper's figures from what was computed. Lines: dashed for the model, full for the plant, as in the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from trueplant.arrays import Array
from trueplant.loop import Simulation
from trueplant.paper.mill import Mill
from trueplant.paper.montecarlo import NAMES, Estimates, bound_percent, percent
from trueplant.paper.tables import WINDOW, Shown
from trueplant.report.decimate import compact, min_max
from trueplant.report.figures import log_ticks
from trueplant.report.style import BOTTOM, LIGHT, TOP, framed, line

Curve = tuple[str, str, Array]
"""Role, name, values."""

PANEL, GAP, POINTS = 130, 34, 1500
MU_ROLES = {"nominal": "model", "printed": "plant", "eq37": "setpoint"}
"""Dashed for the model, full for the plant as (34) prints it, dash-dotted for the plant as (37) implies."""
MU_NAMES = {"nominal": "model", "printed": "plant, 1.1014", "eq37": "plant, 1.0137"}


def figure_4(mill: Mill) -> go.Figure:
    """mu for robust performance over frequency."""
    figure = go.Figure()
    curves = {"nominal": mill.nominal, **mill.perturbed}
    low, high = 1e-3, 1e2
    for name, found in curves.items():
        seen = (found.w >= low) & (found.w <= high)
        x, y = found.w[seen], found.performance[seen, 1]
        figure.add_trace(line(MU_ROLES[name], MU_NAMES[name], x=compact(x), y=compact(y)))
    figure.add_trace(line("bound", "limit", x=[low, high], y=[1.0, 1.0]))
    limits = [float(np.log10(low)), float(np.log10(high))]
    figure.update_xaxes(type="log", title_text="Frequency (rad/min)", range=limits, **log_ticks(limits))
    figure.update_yaxes(title_text="mu, upper bound", rangemode="tozero")
    return framed(figure, 330)


def stacked(t: Array, panels: Sequence[tuple[str, Sequence[Curve]]], time_unit: str = "min") -> go.Figure:
    """Signals over time, one panel a title."""
    height = TOP + BOTTOM + PANEL * len(panels) + GAP * (len(panels) - 1)
    spacing = GAP / (height - TOP - BOTTOM) if len(panels) > 1 else 0
    figure = make_subplots(
        rows=len(panels),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=spacing,
        subplot_titles=[title for title, _ in panels],
    )
    figure.update_annotations(x=0, xanchor="left", font_size=12)
    for row, (_, curves) in enumerate(panels, start=1):
        for role, name, x in curves:
            time, drawn = min_max(t, x, POINTS)
            trace = line(role, name, x=compact(time), y=compact(drawn))
            trace.line.shape = "hv" if name in ("SP", "OP") else "linear"
            figure.add_trace(trace, row=row, col=1)
        figure.update_yaxes(nticks=5, row=row, col=1)
    figure.update_xaxes(title_text=f"Time ({time_unit})", row=len(panels), col=1)
    figure.update_xaxes(range=[float(t[0]), float(t[-1])])
    return framed(figure, height)


def mill_steps(mill: Mill, k: int, signals: str) -> go.Figure:
    """Figures 5 and 7 (signals "y") or 6 and 8 ("u"): a step of set-point k."""
    titles = {"y": ("Particle size (%)", "Circulating load (t/h)"), "u": ("Ore feed (t/h)", "Dilution water (m3/h)")}
    runs: dict[str, Simulation] = {"nominal": mill.steps.nominal[k]}
    runs |= {name: pair[k] for name, pair in mill.steps.perturbed.items()}
    t = runs["nominal"].t
    panels = []
    for i, title in enumerate(titles[signals]):
        curves = [(MU_ROLES[name], MU_NAMES[name], getattr(run, signals)[:, i]) for name, run in runs.items()]
        if signals == "y":
            curves.append(("bound", "SP", runs["nominal"].r[:, i]))
        panels.append((title, curves))
    return stacked(t, panels)


def figure_10(shown: Shown) -> go.Figure:
    """The whole simulated record."""
    run = shown.run
    panels: list[tuple[str, Sequence[Curve]]] = []
    for i, (output, op) in enumerate((("Top temperature", "Reflux"), ("Vaporisation", "Fuel gas"))):
        panels.append((output, [("measured", "PV", run.y[:, i]), ("setpoint", "SP", run.r[:, i])]))
        panels.append((f"{op} (OP)", [("measured", "OP", run.u[:, i])]))
    return stacked(run.t, panels)


def step_data(shown: Shown, output: int, start: float, end: float) -> go.Figure:
    """Figures 11 and 12: input, output, model output and error about one step."""
    run = shown.run
    part = (run.t >= start) & (run.t <= end)
    y, yhat = run.y[part, output], shown.model[part, output]
    panels = [
        ("PV and model output", [("measured", "PV", y), ("model", "model", yhat)]),
        ("Error", [("setpoint", "error", y - yhat)]),
        ("OP", [("measured", "OP", run.u[part, output])]),
    ]
    return stacked(run.t[part], panels)


def comparison(shown: Shown, output: int, step: float) -> go.Figure:
    """Figures 13 to 15: PV, model and estimated plant about one step."""
    run = shown.run
    part = np.abs(run.t - step) <= WINDOW
    curves = [
        ("measured", "PV", run.y[part, output]),
        ("model", "model", shown.model[part, output]),
        ("plant", "plant, estimated", shown.plant[part, output]),
    ]
    return stacked(run.t[part], [("", curves)]).update_layout(height=260)


def errors(runs: Estimates) -> go.Figure:
    """Root mean square errors of our estimates and median errors of the paper's route beside the bound."""
    names = [name.replace("delay", "θ").replace("gain", "K").replace("tau", "τ") for name in NAMES]
    rms = np.sqrt(np.mean(percent(runs.ours) ** 2, axis=0))
    route = np.median(percent(runs.route), axis=0)
    figure = go.Figure()
    for role, name, symbol, values in (
        ("bound", "Cramér-Rao bound", "line-ew-open", bound_percent(runs)),
        ("plant", "ours, rms", "circle", rms),
        ("points", "paper's route, median", "x-thin-open", route),
    ):
        size = 16 if symbol == "line-ew-open" else 9
        marker = {"color": LIGHT[role], "size": size, "symbol": symbol, "line": {"width": 2}}
        shown = np.where(values > 1e-6, values, np.nan)
        figure.add_trace(go.Scatter(x=names, y=shown, mode="markers", name=name, marker=marker, meta={"role": role}))
    limits = [-1.0, 2.5]
    figure.update_yaxes(type="log", title_text="Error (% of the true value)", range=limits, **log_ticks(limits))
    figure.update_xaxes(tickangle=0)
    return framed(figure, 330)
