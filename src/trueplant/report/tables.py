"""The tables of the report: rows of text from elements and from what the methods answered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from trueplant.report import levels
from trueplant.report.numbers import MISSING, interval, number, percentage, probability, to_precision
from trueplant.result import Element, Parameter

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


def parameter_row(p: Parameter, scale: float) -> ParameterRow:
    """`scale` is the half width of the drawing in percent."""
    kind = "unknown" if p.plant is None else "changed" if p.changed else "unchanged"
    if kind == "unchanged" and p.model is None:
        kind, answer = "unknown", "not in the model"
    else:
        answer = {"unknown": "not answered", "changed": "changed", "unchanged": "unchanged"}[kind]
    if p.reason:
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


def fit_tables(fit: Sequence[Mapping[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """How well each output is predicted, and the tests of its residuals: one row each, nested tables as columns."""
    fits: list[dict[str, Any]] = []
    tests: list[dict[str, Any]] = []
    for row in fit:
        flat = {key: value for key, value in row.items() if key not in ("validation", "residual_tests")}
        validation, residuals = row.get("validation"), row.get("residual_tests")
        if validation:
            flat |= {
                "Validated on": validation["kind"],
                "Fit there (%)": validation["fit_percent"],
                "Fit there of the final estimate (%)": validation["fit_percent_same_data"],
            }
        fits.append(flat)
        if residuals and row.get("output") not in [test["output"] for test in tests]:
            test = {"output": row.get("output"), "p, white": residuals["whiteness_p"]}
            test |= {f"p, unrelated to {name}": p for name, p in residuals["input_p"].items()}
            test |= {f"p, {name}": p for name, p in residuals["further_p"].items()}
            known = ("whiteness_p", "input_p", "further_p")
            tests.append(test | {key: value for key, value in residuals.items() if key not in known})
    return fits, tests


def _is_elements(answer: Any) -> bool:
    return (
        isinstance(answer, list)
        and bool(answer)
        and all(isinstance(e, Mapping) and {"output", "input", "parameters"} <= e.keys() for e in answer)
    )


def _parameters(element: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Parameters as a list of mappings with a name, whichever way the method wrote them."""
    given = element["parameters"]
    if isinstance(given, Mapping):
        return [{"name": k, **(v if isinstance(v, Mapping) else {"plant": v})} for k, v in given.items()]
    return list(given)


@dataclass(frozen=True)
class ComparisonRow:
    """One parameter: what each method answers."""

    name: str
    unit: str
    answers: tuple[str, ...]


APART = ("coherence", "detectors", "disagreements")
"""Entries of `methods` that figures, or tables of their own, show."""


@dataclass(frozen=True)
class Comparison:
    """What each method answers, element by element; and what the methods said besides."""

    methods: tuple[str, ...]
    elements: tuple[tuple[tuple[str, str], tuple[ComparisonRow, ...]], ...]
    """((output, input), rows) of each element."""
    others: Mapping[str, Any]


def comparison(methods: Mapping[str, Any], elements: Sequence[Element] = ()) -> Comparison:
    """`methods` as plain data: {method: [{output, input, parameters: [{name, unit, plant, ci, std_error}]}]}.

    Units that the methods do not state are those of the elements. Entries of any other form come back in `others`.
    """
    names = tuple(name for name, answer in methods.items() if _is_elements(answer))
    found: dict[tuple[str, str], dict[str, dict[str, Mapping[str, Any]]]] = {}
    for method in names:
        for element in methods[method]:
            rows = found.setdefault((str(element["output"]), str(element["input"])), {})
            for p in _parameters(element):
                rows.setdefault(str(p.get("name", "")), {})[method] = p
    units = {(e.output, e.input, p.name): p.unit for e in elements for p in e.parameters}
    rows_of = tuple(
        (
            element,
            tuple(
                ComparisonRow(
                    plain_name(parameter),
                    next(
                        (str(p["unit"]) for p in answers.values() if p.get("unit")),
                        units.get((*element, parameter), ""),
                    ),
                    tuple(_answer(answers[m]) if m in answers else MISSING for m in names),
                )
                for parameter, answers in rows.items()
            ),
        )
        for element, rows in found.items()
    )
    return Comparison(names, rows_of, {k: v for k, v in methods.items() if v and k not in (*names, *APART)})


def _answer(p: Mapping[str, Any]) -> str:
    error = p.get("std_error")
    text = to_precision(p.get("plant"), error)
    if p.get("ci") is None:
        return text
    low, high = p["ci"]
    return f"{text} ({interval(low, high, error)})"
