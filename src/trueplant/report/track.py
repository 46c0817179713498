"""The page of a track: parameters over time with their intervals, changes, and what was refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trueplant.report.figures import GAP, PANEL, axis_range
from trueplant.report.frame import Book, Drawn, frame
from trueplant.report.levels import MOST_ROWS
from trueplant.report.page import environment
from trueplant.report.style import BOTTOM, TOP, area, framed, inert, line, over_time, shortened
from trueplant.report.tables import origin
from trueplant.result import (
    Axis,
    Calendar,
    Change,
    ChangeKind,
    Parameter,
    Status,
    Track,
    TrackedElement,
    Window,
)
from trueplant.result.numbers import counted
from trueplant.result.track_words import change_sentence, holds, refused_stretches, told_reasons, what_moved, word_of

if TYPE_CHECKING:
    import plotly.graph_objects as go


def render(track: Track) -> str:
    """The track as HTML text: no file or address outside of it is needed. The same track gives the same text."""
    book = Book()
    figures = [(e, _drawn(track, e, book)) for e in track.elements]
    page = (
        environment("trueplant.report")
        .get_template("track.html.j2")
        .render(
            track=track,
            headline=track.headline.replace("->", "→"),
            confidence=track.provenance.settings.confidence,
            precision=track.provenance.settings.precision_percent,
            changes=[(c, change_sentence(c, track.calendar).replace("->", "→")) for c in track.changes],
            figures=figures,
            refused=refused_stretches(track),
            reasons_told=told_reasons(track),
            holds=holds(track),
            word_of=word_of,
            moved=lambda change: what_moved(change).replace("->", "→"),
            calendar=track.calendar,
            provenance=track.provenance,
            origin=origin(track.provenance, _calendars(track)),
            most_rows=MOST_ROWS,
            **frame(book),
        )
    )
    return page + "\n"


def _calendars(track: Track) -> dict[str, Calendar]:
    """The times of each record in words, where the common axis has time stamps."""
    zone = track.time_zone
    return {e.name: Calendar.of(track.time_unit, e.start, zone) for e in track.experiments if track.start}


def _drawn(track: Track, element: TrackedElement, book: Book) -> Drawn | None:
    windows = [w for w in track.windows if w.output == element.output]
    changes = [c for c in track.changes if (c.output, c.input) == (element.output, element.input)]
    names = _names(windows, element.input)
    if not names:
        return None
    figure = element_figure(track, element, windows, changes, names)
    estimated = sum(any(e.input == element.input for e in w.elements) for w in windows)
    refused = sum(w.status == Status.REFUSED for w in windows)
    caption = f"{counted(estimated, 'window')} estimated, {counted(refused, 'stretch', 'es')} of the record refused."
    if changes:
        caption += " " + " ".join(change_sentence(c, track.calendar).replace("->", "→") for c in changes)
    return book.add(figure, f"Parameters of {element.input} → {element.output}", caption)


def _names(windows: Sequence[Window], column: str) -> list[str]:
    for window in windows:
        for element in window.elements:
            if element.input == column:
                return [p.name for p in element.parameters]
    return []


def element_figure(
    track: Track, element: TrackedElement, windows: Sequence[Window], changes: Sequence[Change], names: Sequence[str]
) -> go.Figure:
    """One panel a parameter: estimate and interval of each window, the model, refused stretches and changes shaded."""
    from plotly.subplots import make_subplots

    height = TOP + BOTTOM + PANEL * len(names) + GAP * (len(names) - 1)
    inner = height - TOP - BOTTOM
    figure = make_subplots(
        rows=len(names),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=GAP / inner if len(names) > 1 else 0,
        subplot_titles=[inert(name.replace("_", " ")) for name in names],
    )
    figure.update_annotations(x=0, xanchor="left", font_size=12)
    span = (min(e.span[0] for e in track.experiments), max(e.span[1] for e in track.experiments))
    for row, name in enumerate(names, start=1):
        found = [(w, p) for w in windows for p in [_parameter(w, element.input, name)] if p is not None]
        answered = [(w, p) for w, p in found if p.plant is not None]
        values = np.array([x for _, p in answered for x in ((p.plant,) if p.ci is None else (*p.ci, p.plant))], float)
        model = next((p.model for _, p in found), None)
        limits = axis_range(values[np.isfinite(values)], np.array([] if model is None else [model], dtype=float))
        for trace in _traces(track.calendar, windows, changes, answered, limits):
            figure.add_trace(trace, row=row, col=1)
        if model is not None:
            ends = track.calendar.axis(span)
            figure.add_trace(line("model", "model", x=ends, y=[model] * 2), row=row, col=1)
        unit = next((p.unit for _, p in found), "")
        figure.update_yaxes(title_text=inert(shortened(unit, 16)), range=limits, nticks=5, row=row, col=1)
    return over_time(framed(figure, height), track.calendar, span, len(names))


def _traces(
    calendar: Calendar,
    windows: Sequence[Window],
    changes: Sequence[Change],
    answered: Sequence[tuple[Window, Parameter]],
    limits: list[float],
) -> list[go.Scatter]:
    traces = []
    pixel = (max(w.end for w in windows) - min(w.start for w in windows)) / 1000
    for window in windows:
        if window.status == Status.REFUSED:
            text = inert(f"refused: {window.reason}")
            traces.append(_shade("excluded", calendar.axis([window.start, window.end]), limits, text))
    for change in changes:
        if change.kind != ChangeKind.DRIFT:
            low, high = change.interval
            text = inert(f"{change.kind} within {calendar.span(low, high)}")
            traces.append(_shade("speaks", calendar.axis([low, max(high, low + pixel)]), limits, text))
    x, y = [], []
    for window, parameter in answered:
        if parameter.ci is not None:
            low, high = np.clip(parameter.ci, limits[0] - (limits[1] - limits[0]), limits[1] + (limits[1] - limits[0]))
            x += [window.start, window.start, window.end, window.end, None]
            y += [float(low), float(high), float(high), float(low), None]
    if x:
        traces.append(area("plant_band", "interval", x=calendar.axis(x), y=y, hoverinfo="skip"))
    x = [t for w, _ in answered for t in (w.start, w.end, None)]
    y = [v for _, p in answered for v in (p.plant, p.plant, None)]
    traces.append(line("plant", "plant", x=calendar.axis(x), y=y))
    for change in changes:
        if change.time is not None:
            traces.append(line("bound", "change", x=calendar.axis([change.time] * 2), y=limits))
    return traces


def _shade(role: str, ends: Axis, limits: list[float], text: str) -> go.Scatter:
    x, y = [ends[0], ends[0], ends[1], ends[1]], [*limits, *limits[::-1]]
    return area(role, text, x=x, y=y, hoveron="fills", hoverinfo="text", text=text)


def _parameter(window: Window, column: str, name: str) -> Parameter | None:
    for element in window.elements:
        if element.input == column:
            return next((p for p in element.parameters if p.name == name), None)
    return None
