"""Step responses as small pictures in a page; the colours come from its style sheet."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from trueplant.arrays import Array
from trueplant.lti import MeasuredStep, TransferFunction
from trueplant.lti.sampled import sampled_response
from trueplant.project.conversion import step_span

WIDTH, WIDE, HEIGHT, EDGE = 160, 640, 56, 4
POINTS = 120


def step_picture(given: TransferFunction | MeasuredStep, fitted: TransferFunction | None, time_unit: str) -> str:
    """An SVG of the response to a unit step; with what was fitted to it, where it was measured."""
    span = step_span(given)
    if isinstance(given, TransferFunction) and any(pole.real == 0 for pole in given.poles):
        span *= 2  # of an integrator the ramp is to be seen
    t = np.linspace(0.0, span, POINTS + 1)
    curves = {"model": response(given, t)}
    if fitted is not None:
        curves = {"points": curves["model"], "model": response(fitted, t)}
    end = curves["model"][-1]
    return picture(t, curves, f"step response: {end:.3g} after {span:.3g} {time_unit}")


def response(given: TransferFunction | MeasuredStep, t: Array) -> Array:
    """At even times from 0 on, after a unit step."""
    if isinstance(given, MeasuredStep):
        return np.asarray(given(t), dtype=np.float64)
    return np.asarray(sampled_response(given, np.ones(t.size), float(t[1] - t[0])), dtype=np.float64)


def picture(t: Array, curves: Mapping[str, Array], words: str, wide: bool = False) -> str:
    """Curves by the role that the style sheet colours, over a line at 0 unless it is a `wide` trend; in words, too."""
    width = WIDE if wide else WIDTH
    values = np.concatenate([np.zeros(0 if wide else 1), *(c[np.isfinite(c)] for c in curves.values())])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    scale = (HEIGHT - 2 * EDGE) / ((high - low) or 1.0)
    x = EDGE + (width - 2 * EDGE) * (t - t[0]) / (float(t[-1] - t[0]) or 1.0)

    def y(value: Array | float) -> Array:
        return np.asarray(HEIGHT - EDGE - (np.asarray(value) - low) * scale)

    zero = float(y(0.0))
    lines = [] if wide else [f'<line class="zero" x1="{EDGE}" x2="{WIDTH - EDGE}" y1="{zero:.1f}" y2="{zero:.1f}"/>']
    for role, curve in curves.items():
        lines += [f'<polyline class="{escape(role)}" points="{part}"/>' for part in _parts(x, y(curve))]
    kind = "trend" if wide else "step"
    head = f'<svg class="{kind}" viewBox="0 0 {width} {HEIGHT}" role="img" aria-label="{escape(words)}">'
    return f"{head}<title>{escape(words)}</title>{''.join(lines)}</svg>"


def _parts(x: Array, y: Array) -> list[str]:
    """The points of each stretch without gaps."""
    known = np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    return [
        " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[first:end], y[first:end], strict=True))
        for first, end in edges.reshape(-1, 2)
    ]
