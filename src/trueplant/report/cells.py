"""The step response of each element as a small drawing for the matrix of a page: no script is needed for it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from trueplant.arrays import Array
from trueplant.printable import printable
from trueplant.report import levels
from trueplant.report.decimate import at_rest
from trueplant.report.labels import label
from trueplant.report.numbers import number
from trueplant.result import Curves

if TYPE_CHECKING:
    from markupsafe import Markup


def step_cells(curves: Curves) -> Mapping[tuple[str, str], Markup]:
    """By (output, input): model dashed, plant, and its band; none where nothing is known of both."""
    found = {}
    for i, output in enumerate(curves.outputs):
        for j, name in enumerate(curves.inputs):
            at = np.s_[:, i, j]
            drawn = _cell(
                curves, curves.step_model[at], curves.step_plant[at], (curves.step_low[at], curves.step_high[at])
            )
            if drawn:
                found[output, name] = _framed(drawn, f"Step response of {label(output)} to {label(name)}")
    return found


def _framed(drawn: str, said: str) -> Markup:
    from markupsafe import Markup

    size = f"0 0 {levels.CELL_WIDTH:g} {levels.CELL_HEIGHT:g}"
    box = f'viewBox="{size}" role="img" aria-label="{escape(printable(said))}: model dashed, plant with its band"'
    return Markup(f'<svg class="cell" {box}>{drawn}</svg>')


def _cell(curves: Curves, model: Array, plant: Array, band: tuple[Array, Array]) -> str:
    width, height, edge = levels.CELL_WIDTH, levels.CELL_HEIGHT, levels.CELL_EDGE
    floor = height - levels.CELL_TEXT
    lines = [y for y in (model, plant) if np.isfinite(y).any() and np.ptp(y[np.isfinite(y)]) > 0]
    if not lines:
        return ""
    end = at_rest(lines)
    t = curves.step_t[:end]
    pick = np.unique(np.linspace(0, end - 1, levels.CELL_POINTS).round().astype(int))
    seen = np.concatenate([y[:end] for y in lines])
    low, high = min(float(np.nanmin(seen)), 0.0), max(float(np.nanmax(seen)), 0.0)
    room = (high - low) or 1.0

    def x(k: Array) -> Array:
        return np.asarray(edge + (width - 2 * edge) * (t[k] - t[0]) / ((t[-1] - t[0]) or 1.0))

    def y(values: Array) -> Array:
        return np.asarray(np.clip(edge + (floor - 2 * edge) * (high - values) / room, 0.0, floor))

    def path(values: Array, role: str) -> str:
        known = pick[np.isfinite(values[pick])]
        if known.size < 2:
            return ""
        return f'<polyline class="{role}" points="{_points(x(known), y(values[known]))}"/>'

    rest = f"{float(y(np.zeros(1))[0]):.1f}"
    parts = [f'<line class="zero" x1="0" x2="{width:g}" y1="{rest}" y2="{rest}"/>']
    both = pick[np.isfinite(band[0][pick]) & np.isfinite(band[1][pick])]
    if both.size > 1:
        outline = f"{_points(x(both), y(band[0][both]))} {_points(x(both)[::-1], y(band[1][both])[::-1])}"
        parts.append(f'<polygon class="band" points="{outline}"/>')
    parts += [path(model, "model"), path(plant, "plant")]
    span = escape(f"{number(float(t[-1]), 2)} {curves.time_unit}")
    parts.append(f'<text x="{width - edge:g}" y="{height - edge:g}">{span}</text>')
    return "".join(parts)


def _points(x: Array, y: Array) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
