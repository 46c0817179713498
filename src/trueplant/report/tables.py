"""The tables of the report: rows of text from elements and from what the methods answered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from trueplant.report import levels
from trueplant.report.labels import label
from trueplant.report.numbers import MISSING, finite, interval, number, percentage, probability, to_precision
from trueplant.report.walk import Table, as_table
from trueplant.result import (
    Calendar,
    ControllerCheck,
    Element,
    ExperimentData,
    FitRow,
    MethodParameter,
    Methods,
    Parameter,
    Provenance,
    Trend,
)
from trueplant.result.codec import entries_of
from trueplant.result.headline import is_useful
from trueplant.result.parameter_words import kind_of

WIDTH, HALF = 132, 60


@dataclass(frozen=True)
class ParameterRow:
    """One parameter as text; `kind` is "changed", "unchanged" or "unknown"."""

    name: str
    unit: str
    model: str
    plant: str
    error: str
    interval: str
    change: str
    p: str
    kind: str
    answer: str
    drawing: Markup


def plain_name(name: str) -> str:
    """``dead_time`` as ``dead time``."""
    return name.replace("_", " ")


def _percent_interval(p: Parameter) -> tuple[float, float, float] | None:
    """Change and its interval in percent of the model's value."""
    if p.plant is None or not p.model or p.change_percent is None or not math.isfinite(p.change_percent):
        return None
    gap = p.plant - p.model
    scale = p.change_percent / gap if gap else 100 / abs(p.model)
    low, high = p.ci if p.ci is not None else (p.plant, p.plant)
    ends = sorted((scale * (low - p.model), scale * (high - p.model)))
    return (p.change_percent, ends[0], ends[1]) if all(map(math.isfinite, ends)) else None


def percent_scale(elements: Sequence[Element]) -> float:
    """Half width in percent of the drawings: a round number that holds all changes and most of the intervals."""
    spans = [span for e in elements for p in e.parameters if (span := _percent_interval(p))]
    ends = sorted(max(abs(low), abs(high)) for _, low, high in spans)
    needed = max([abs(change) for change, _, _ in spans] + ends[3 * len(ends) // 4 :][:1], default=10.0)
    return next((r for r in (5.0, 10.0, 20.0, 30.0, 50.0, 100.0, 200.0) if r >= needed), levels.MOST_PERCENT)


def _drawing(p: Parameter, scale: float, kind: str) -> Markup:
    """The change and its interval as a whisker around zero; an end beyond the scale becomes an arrowhead."""
    span = _percent_interval(p)
    if span is None:
        return Markup("")
    middle = WIDTH / 2
    centre, low, high = (middle + HALF * min(max(v / scale, -1.0), 1.0) for v in span)
    ends = []
    for value, x, sign in ((span[1], low, -1), (span[2], high, 1)):
        if abs(value) > scale:
            ends.append(f'<path d="M{x - 4 * sign:.1f} 5L{x + 3 * sign:.1f} 9L{x - 4 * sign:.1f} 13"/>')
        else:
            ends.append(f'<path d="M{x:.1f} 6V12"/>')
    return Markup(
        f'<svg class="whisker {kind}" width="{WIDTH}" height="18" viewBox="0 0 {WIDTH} 18" aria-hidden="true">'
        f'<path class="zero" d="M{middle:.1f} 0V18"/><path d="M{low:.1f} 9H{high:.1f}"/>{"".join(ends)}'
        f'<circle cx="{centre:.1f}" cy="9" r="4"/></svg>'
    )


def _digits(p: Parameter) -> int:
    """Of the model's value: as far as the plant's is known, and three to six."""
    if not (p.model and p.std_error and math.isfinite(p.std_error)):
        return 4
    return min(max(2 + math.floor(math.log10(abs(p.model))) - math.floor(math.log10(p.std_error)), 3), 6)


def parameter_row(p: Parameter, scale: float, said: str = "") -> ParameterRow:
    """`scale` is the half width of the drawing in percent; `said`: of the element, above its parameters."""
    kind = "unknown" if p.plant is None else "changed" if p.changed else "unchanged"
    if kind == "unchanged" and p.changed is None:
        answer = "found"
    elif kind == "unchanged" and p.model is None:
        kind, answer = "unknown", "not in the model"
    else:
        answer = {"unknown": "not answered", "changed": "changed", "unchanged": "unchanged"}[kind]
    if answer == "unchanged" and kind_of(p.name) != "dead_time" and not is_useful(p):
        answer = "no change told"  # what could hide in the interval is no small change
    if p.reason and p.reason not in said:
        answer += f": {p.reason}"
    return ParameterRow(
        name=plain_name(p.name),
        unit=p.unit,
        model=number(p.model, _digits(p)),
        plant=to_precision(p.plant, p.std_error),
        error=number(p.std_error, 2),
        interval=interval(*p.ci, resolution=p.std_error) if p.ci is not None else MISSING,
        change=percentage(p.change_percent),
        p=probability(p.p_adjusted),
        kind=kind,
        answer=answer,
        drawing=_drawing(p, scale, kind),
    )


def fit_table(fit: Sequence[FitRow]) -> Table:
    """How well each output is predicted; the columns on validation only where there is any."""
    rows = []
    for row in fit:
        cells = entries_of(row, ("validation", "residual_tests"))
        if row.validation is not None:
            cells |= {
                "Validated on": row.validation.kind,
                "Fit there (%)": row.validation.fit_percent,
                "Fit there of the final estimate (%)": row.validation.fit_percent_same_data,
            }
        rows.append(cells)
    return as_table(rows)


def residual_table(fit: Sequence[FitRow]) -> Table:
    """The tests of the residuals, a row for each output that was estimated."""
    rows: dict[str, dict[str, object]] = {}
    for row in fit:
        test = row.residual_tests
        if test is not None and row.output not in rows:
            cells = {"output": row.output, "p, white": probability(test.whiteness_p)}
            cells |= {f"p, unrelated to {name}": probability(p) for name, p in test.input_p.items()}
            cells |= {f"p, {name}": probability(p) for name, p in test.further_p.items()}
            rows[row.output] = cells | entries_of(test, ("whiteness_p", "input_p", "further_p"))
    return as_table(list(rows.values()))


def experiments_table(data: Sequence[ExperimentData], unit: str) -> Table:
    """What is a single value of each experiment."""
    headings = ("name", "loop", "samples", "sample_time", "start", "refused")
    starts = [one.calendar(unit).text(0.0) if one.start else None for one in data]
    rows = tuple(
        (one.name, one.loop, one.samples, one.sample_time, start, one.refused)
        for one, start in zip(data, starts, strict=True)
    )
    return Table(tuple(map(label, headings)), rows)


def origin(provenance: Provenance, calendars: Mapping[str, Calendar]) -> dict[str, object]:
    """Where a result comes from, the times of the records in words."""
    spans = {
        name: (calendars.get(name) or Calendar(provenance.time_unit)).span(*span)
        for name, span in provenance.time_spans.items()
    }
    return entries_of(provenance) | {"time_spans": spans}


def experiment_parts(one: ExperimentData, unit: str) -> dict[str, object]:
    """What is more than a single value of an experiment, its times in words."""
    calendar = one.calendar(unit)
    parts = {name: part for name, part in entries_of(one, ("used_calendar", "span_calendar")).items()}
    parts["span"] = (calendar.span(*one.span),)
    parts["used"] = _spans(one.used, calendar)
    parts["excluded"] = tuple(
        {"span": calendar.span(x.start, x.end), "signal": x.signal, "reason": x.reason} for x in one.excluded
    )
    parts["findings"] = tuple(
        entries_of(x, ("calendar",)) | {"spans": "; ".join(_spans(x.spans, calendar))} for x in one.findings
    )
    return {name: part for name, part in parts.items() if not isinstance(part, str | int | float | None)}


def _spans(spans: Sequence[tuple[float, float]], calendar: Calendar) -> tuple[str, ...]:
    left = len(spans) - levels.MOST_ROWS
    more = (f"and {left} more in result.json",) if left > 0 else ()
    return (*(calendar.span(*span) for span in spans[: levels.MOST_ROWS]), *more)


def excluded_table(trend: Trend, calendar: Calendar) -> Table:
    """The spans that are left out of a trend."""
    rows = tuple((calendar.span(low, high), signal, reason) for low, high, signal, reason in trend.excluded)
    return Table(tuple(map(label, ("span", "signal", "reason"))), rows)


@dataclass(frozen=True)
class ComparisonRow:
    """One parameter: what each method answers."""

    name: str
    unit: str
    answers: tuple[str, ...]


@dataclass(frozen=True)
class LawRow:
    """Does a declared controller reproduce OP?"""

    experiment: str
    input: str
    answer: str
    missed: str
    """Of OP, within short windows (rms)."""
    message: str


def law_rows(checks: Sequence[ControllerCheck]) -> tuple[LawRow, ...]:
    """The controllers of all experiments, one a row."""
    answers = {True: "confirmed", False: "contradicted", None: "cannot be told"}
    return tuple(
        LawRow(
            one.experiment,
            one.input,
            answers[one.confirmed],
            _not_explained(one),
            one.message,
        )
        for one in checks
    )


def _not_explained(check: ControllerCheck) -> str:
    if check.rms is None:
        return MISSING
    # beside OP's own movement it may be what the arithmetic leaves
    nothing = check.relative is not None and check.relative < levels.ARITHMETIC
    return f"{number(0.0 if nothing else check.rms, 3)} {check.unit}".strip()


DIFFERS = "≠ "
"""Before an answer that is not that of the direct fit."""
APART = ("answers", "coherence", "detectors", "disagreements", "controller_consistency")
"""Fields of `Methods` that figures, or tables of their own, show."""


@dataclass(frozen=True)
class Comparison:
    """What each method answers, element by element; and what the methods said besides."""

    methods: tuple[str, ...]
    elements: tuple[tuple[tuple[str, str], tuple[ComparisonRow, ...]], ...]
    """((output, input), rows) of each element."""
    others: Mapping[str, object]
    """The other fields of `Methods` that say something, by their names in result.json."""
    differs: bool = False
    """Is an answer marked as different from that of the direct fit?"""


def comparison(methods: Methods, elements: Sequence[Element] = ()) -> Comparison:
    """The answers of the methods side by side, in the units of the elements."""
    names = tuple(name for name, answer in methods.answers.items() if answer)
    found: dict[tuple[str, str], dict[str, dict[str, MethodParameter]]] = {}
    for method in names:
        for element in methods.answers[method]:
            rows = found.setdefault((element.output, element.input), {})
            for p in element.parameters:
                rows.setdefault(p.name, {})[method] = p
    units = {(e.output, e.input, p.name): p.unit for e in elements for p in e.parameters}
    rows_of = tuple(
        (
            place,
            tuple(
                ComparisonRow(
                    plain_name(parameter),
                    units.get((*place, parameter), ""),
                    tuple(_answer(answers[m]) if m in answers else MISSING for m in names),
                )
                for parameter, answers in rows.items()
            ),
        )
        for place, rows in found.items()
    )
    others = {name: said for name, said in entries_of(methods, APART).items() if said}
    return Comparison(names, rows_of, others, _marked(found))


def _marked(found: Mapping[tuple[str, str], Mapping[str, Mapping[str, MethodParameter]]]) -> bool:
    return any(p.differs for rows in found.values() for answers in rows.values() for p in answers.values())


def _answer(p: MethodParameter) -> str:
    plant, error = finite(p.plant), finite(p.std_error)
    text = f"{DIFFERS * p.differs}{to_precision(plant, error)}"
    if p.ci is None:
        return text
    low, high = map(finite, p.ci)
    return f"{text} ({interval(low, high, error)})"
