"""Trends as drawings that need no script: what a refusal rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from trueplant.arrays import Array
from trueplant.printable import printable
from trueplant.report import levels
from trueplant.report.decimate import merged, min_max
from trueplant.report.excluded import drawn, spans_of, used
from trueplant.report.numbers import number
from trueplant.result import Calendar, Curves, Trend

if TYPE_CHECKING:
    from markupsafe import Markup


@dataclass(frozen=True)
class Still:
    """One signal of one experiment: PV with its SP, or OP."""

    signal: str
    caption: str
    drawing: Markup


@dataclass(frozen=True)
class StillTrend:
    """One experiment, and when it began and ended."""

    name: str
    panels: tuple[Still, ...]
    start: str
    end: str
    has_excluded: bool


def still_trends(curves: Curves) -> tuple[tuple[StillTrend, ...], int]:
    """The experiments in order, and how many signals were left out to keep the page small."""
    shown: list[StillTrend] = []
    left = levels.STILL_PANELS
    signals = len(curves.outputs) + len(curves.inputs)
    for trend in curves.trends:
        panels = _panels(curves, trend)[: max(left, 0)]
        left -= len(panels)
        if panels and trend.t.size:
            calendar: Calendar = curves.calendar(trend)
            ends = calendar.text(float(trend.t[0])), calendar.text(float(trend.t[-1]))
            shown.append(StillTrend(trend.name, tuple(panels), *ends, bool(trend.excluded)))
    return tuple(shown), signals * len(curves.trends) - sum(len(one.panels) for one in shown)


def _panels(curves: Curves, trend: Trend) -> list[Still]:
    found = []
    for i, name in enumerate(curves.outputs):
        said = f"PV {_extent(trend.y[used(curves, trend, name), i], curves.output_units[i])}"
        if np.isfinite(trend.r[:, i]).any():
            said += f"; SP {_extent(trend.r[:, i], curves.output_units[i])}"
        lines = (("setpoint", trend.r[:, i]), ("measured", drawn(trend, name, trend.y[:, i])))
        found.append(Still(name, said, _drawing(curves, trend, name, lines)))
    for j, name in enumerate(curves.inputs):
        said = f"OP {_extent(trend.u[used(curves, trend, name), j], curves.input_units[j])}"
        op = [("measured", drawn(trend, name, trend.u[:, j]))]
        found.append(Still(name, said, _drawing(curves, trend, name, op)))
    return found


def _extent(values: Array, unit: str) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "missing"
    low, high = number(float(known.min())), number(float(known.max()))
    return (f"does not move, {low} {unit}" if low == high else f"{low} to {high} {unit}").rstrip()


def _drawing(curves: Curves, trend: Trend, signal: str, lines: Sequence[tuple[str, Array]]) -> Markup:
    from markupsafe import Markup

    width, height, edge = levels.STILL_WIDTH, levels.STILL_HEIGHT, levels.CELL_EDGE
    t = trend.t
    known = np.concatenate([values[np.isfinite(values)] for _, values in lines])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    room = high - low

    def x(at: Array) -> Array:
        return np.asarray(np.clip(width * (at - t[0]) / ((t[-1] - t[0]) or 1.0), 0.0, width))

    def y(values: Array) -> Array:
        share = (high - values) / room if room > 0 else np.full(values.shape, 0.5)
        return np.asarray(edge + (height - 2 * edge) * share)

    spans = merged([(a, b) for a, b, _ in spans_of(curves, trend, signal)], (t[-1] - t[0]) / width)
    parts = [
        f'<rect class="excluded" x="{a:.1f}" width="{max(b - a, 1.0):.1f}" y="0" height="{height:g}"/>'
        for a, b in (x(np.array(span)) for span in spans)
    ]
    for role, values in lines:
        at, picked = min_max(t, values, levels.STILL_POINTS)
        for run in _runs(np.isfinite(picked)):
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x(at[run]), y(picked[run]), strict=True))
            parts.append(f'<polyline class="{role}" points="{points}"/>')
    box = f'viewBox="0 0 {width:g} {height:g}" preserveAspectRatio="none" role="img"'
    return Markup(f'<svg class="still" {box} aria-label="Trend of {escape(printable(signal))}">{"".join(parts)}</svg>')


def _runs(known: Array) -> list[slice]:
    """Stretches of known samples; one of a single sample is drawn as a dash of no length."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    return [slice(a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]
