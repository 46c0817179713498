"""One element of the plant, opened: what is said of it, its figures, and the tables behind them."""

from __future__ import annotations

import json
import statistics
from dataclasses import dataclass
from typing import Any

from trueplant.app import behind
from trueplant.app.fragments import fragment
from trueplant.report import captions, figures, known, levels, tables
from trueplant.report.frame import Book, Drawn
from trueplant.report.numbers import MISSING, number
from trueplant.report.walk import Table
from trueplant.result import Curves, Element, Result
from trueplant.result.headline import seen
from trueplant.result.parameter_words import word_of

TRENDS = 6
"""Experiments that are drawn; the report has all of them."""


@dataclass(frozen=True)
class Shown:
    """One figure with the table behind it."""

    drawn: Drawn
    table: Table
    roles: tuple[tuple[str, str], ...]
    """Of its legend: role and words."""


def element_view(result: Result, element: Element) -> dict[str, Any]:
    """HTML, and plotly's figures by the id of their place in it. All of it from the saved result."""
    book = Book()
    curves = result.curves
    shown = _figures(result, curves, element, book) if curves is not None else []
    scale = tables.percent_scale(result.elements)
    html = fragment(
        "verdict_element.html.j2",
        element=element,
        seen=seen(element),
        moved=_moved(element),
        shown=shown,
        left_out=max(0, len(curves.trends) - TRENDS) if curves is not None else 0,
        rows=[tables.parameter_row(p, scale) for p in element.parameters],
        scale=number(scale),
        percent=number(100 * result.provenance.settings.confidence),
        known=known.known_table([element]),
        budget=known.budget_table([element]),
        compared=_compared(result, element),
        time_unit=result.provenance.time_unit or "time unit",
    )
    return {"html": html, "figures": {one.id: json.loads(one.json) for one in book.drawn}}


def _moved(element: Element) -> list[str]:
    """What changed, in words: gain -0.464 -> -0.580 degC/% (+25.1 %)."""
    rows = [(word_of(p.name), tables.parameter_row(p, 100.0)) for p in element.parameters if p.changed]
    return [
        f"{word} {row.model} → {row.plant} {row.unit}".rstrip() + ("" if row.change == MISSING else f" ({row.change})")
        for word, row in rows
    ]


def _figures(result: Result, curves: Curves, element: Element, book: Book) -> list[Shown]:
    """Step and frequency response where there are any, then measurement and prediction of each experiment."""
    if element.output not in curves.outputs or element.input not in curves.inputs:
        return []
    i, j = curves.outputs.index(element.output), curves.inputs.index(element.input)
    shown = []
    modelled = element.tf_model is not None
    lines = ((("model", "model"),) if modelled else ()) + (("plant", "plant"),)
    if curves.step_t.size and figures.has_response(curves.step_model[:, i, j], curves.step_plant[:, i, j]):
        drawn = book.add(figures.step_response(curves, i, j), "Answer to a step", captions.step_response(curves, i, j))
        shown.append(Shown(drawn, behind.step_table(curves, i, j), (*lines, ("plant-band", "plant, interval"))))
    if curves.w.size and figures.has_response(curves.bode_model[:, i, j], curves.bode_plant[:, i, j]):
        z = statistics.NormalDist().inv_cdf(0.5 + result.provenance.settings.confidence / 2)
        drawn = book.add(figures.bode(curves, i, j, z), "Frequency response", captions.bode(curves, i, j))
        roles = (*lines, ("plant-band", "plant, interval"), ("speaks", "here the data speak"))
        points = (("points", curves.np_label or "estimate without a model"),) if curves.points(i, j)[0].size else ()
        shown.append(Shown(drawn, behind.bode_table(curves, i, j), (*roles, *points)))
    for trend in curves.trends[:TRENDS]:
        if trend.t.size:
            panels = [("y", i), ("u", j)]
            figure = figures.trends(curves, trend, panels, levels.MOST_POINTS)
            drawn = book.add(figure, f"Measured and predicted: {trend.name}", captions.trends(curves, trend, panels))
            roles = (("measured", "measured"), ("setpoint", "set-point"), *lines)
            left = (("excluded", "left out"),) if trend.excluded else ()
            shown.append(Shown(drawn, behind.trend_table(curves, trend, i, j), (*roles, *left)))
    return shown


def _compared(result: Result, element: Element) -> tuple[tuple[str, ...], tuple[tables.ComparisonRow, ...]]:
    """The methods, and what each answers for this element."""
    found = tables.comparison(result.methods, result.elements)
    rows = dict(found.elements).get((element.output, element.input), ())
    return found.methods, rows
