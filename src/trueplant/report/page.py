"""The report as one HTML file: it opens offline, in any browser, on paper and on a phone."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.printable import printable
from trueplant.report import known, levels, loops, retuned, tables, walk
from trueplant.report.cells import step_cells
from trueplant.report.detected import detected
from trueplant.report.frame import Book, Drawn, frame
from trueplant.report.labels import label
from trueplant.report.numbers import number, probability
from trueplant.report.still import still_trends
from trueplant.result import Curves, Reason, Residuals, Result, RetuningCurves, Status, Trend

if TYPE_CHECKING:
    import jinja2
    from markupsafe import Markup


def render(result: Result) -> str:
    """The report of `result` as HTML text: no file or address outside of it is needed.

    The same result gives the same text. Raises nothing for results without curves, elements or data.
    """
    from trueplant.result.headline import seen
    from trueplant.result.reason import is_common
    from trueplant.result.summary import loop_line, told_elements, told_reasons, worth_knowing

    book = Book()
    scale = tables.percent_scale(result.elements)
    # a refusal needs no figures but the trends that it rests on
    curves = None if result.status == Status.REFUSED else result.curves
    trends, more_trends = still_trends(result.curves) if result.curves and curves is None else ((), 0)
    page = (
        environment("trueplant.report")
        .get_template("report.html.j2")
        .render(
            result=result,
            worth_knowing=_not_above(result, worth_knowing(result)),
            told=told_reasons(result),
            common=[note for note in result.notes if is_common(note)],
            shift=_unbroken(result.shift),
            headline=_unbroken(result.headline),
            confidence=_confidence(result),
            most_rows=levels.MOST_ROWS,
            provenance=result.provenance,
            origin=tables.origin(
                result.provenance, {one.name: one.calendar(result.provenance.time_unit) for one in result.data}
            ),
            data=[(one, tables.experiment_parts(one, result.provenance.time_unit)) for one in result.data],
            experiments=tables.experiments_table(result.data, result.provenance.time_unit),
            fit=tables.fit_table(result.fit),
            residual_tests=tables.residual_table(result.fit),
            loop_line=loop_line(result),
            seen=seen,
            today=loops.today(result),
            retuned=_retuned(result, book),
            more_data=result.more_data,
            comparison=tables.comparison(result.methods, result.elements),
            laws=tables.law_rows(result.methods.controller_consistency),
            detected=detected(result.methods.detectors, result.elements),
            elements=[
                (e, [tables.parameter_row(p, scale, e.reason) for p in e.parameters]) for e in told_elements(result)
            ],
            known=known.known_table(result.elements),
            budget=known.budget_table(result.elements),
            grid=_grid(result),
            drawings={} if curves is None else step_cells(curves),
            trends=trends,
            more_trends=more_trends,
            scale=number(scale),
            figures=_figures(curves, book, _z(_confidence(result))) if curves is not None else None,
            mu_figures=_mu_figures(curves, book),
            **frame(book),
        )
    )
    return page + "\n"


def _not_above(result: Result, notes: list[Reason]) -> list[Reason]:
    """The notes, but for those that say why an element has no answer, which stands above them."""
    said = {f"{e.input} -> {e.output}": e.reason for e in result.elements if e.verdict == "not identifiable"}

    def is_above(note: Reason) -> bool:
        return all(note.message in said.get(where, "") for where in note.where.split("; "))

    return [note for note in notes if not is_above(note)]


def environment(*packages: str) -> jinja2.Environment:
    """Templates of these packages, the first that has one counting, with the filters that the macros need."""
    import jinja2

    rooms = [files(package) for package in packages]

    def load(name: str) -> str | None:
        found = next((room.joinpath(name) for room in rooms if room.joinpath(name).is_file()), None)
        return None if found is None else found.read_text(encoding="utf-8")

    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(load),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )
    made.filters |= {"number": number, "probability": probability, "label": label, "sentence": _sentence}
    made.filters |= {"unbroken": _unbroken, "breakable": _breakable}
    made.filters |= {"entries": walk.entries, "as_table": walk.as_table}
    made.tests |= {"missing": walk.is_missing, "record": walk.is_record}
    made.tests |= {"records": walk.is_records, "spans": walk.is_spans}
    return made


def _unbroken(text: str) -> str:
    """No line breaks inside an arrow, or between a number and its per cent."""
    return text.replace("->", "→").replace(" %", "\u00a0%")


def _breakable(name: str) -> Markup:
    """A name that may go on in the next line behind an underscore, where there is no room for all of it."""
    from markupsafe import Markup

    return Markup("_<wbr>").join(printable(name).split("_"))


def _confidence(result: Result) -> float:
    return result.provenance.settings.confidence


def _z(confidence: float) -> float:
    return statistics.NormalDist().inv_cdf(0.5 + confidence / 2)


def _sentence(text: str) -> str:
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"


def _grid(result: Result) -> tuple[list[str], list[tuple[str, list[Any]]]]:
    """Inputs, and for each output its elements in the order of the inputs (None where there is none)."""
    curves = result.curves
    outputs = list(curves.outputs) if curves else list(dict.fromkeys(e.output for e in result.elements))
    inputs = list(curves.inputs) if curves else list(dict.fromkeys(e.input for e in result.elements))
    found = {(e.output, e.input): e for e in result.elements}
    return inputs, [(i, [found.get((i, j)) for j in inputs]) for i in outputs]


def _retuned(result: Result, book: Book) -> list[tuple[retuned.Retuned, list[Drawn]]]:
    """New settings, a loop at a time, with the responses before and after."""
    curves = result.curves
    outputs = dict(zip(curves.outputs, curves.output_units, strict=True)) if curves else {}
    inputs = dict(zip(curves.inputs, curves.input_units, strict=True)) if curves else {}
    drawn = {(c.input, c.output): c for c in curves.retuning} if curves else {}
    found = []
    for loop in result.controllers:
        place = loop.input, loop.output
        pv, op = outputs.get(place[1], ""), inputs.get(place[0], "")
        responses = _retuning_figures(drawn[place], pv, op, loop.time_unit, book) if place in drawn else []
        found.append((retuned.retuned(loop, op, pv), responses))
    return found


def _retuning_figures(curves: RetuningCurves, pv: str, op: str, time_unit: str, book: Book) -> list[Drawn]:
    """Set-point and load steps, then the record again where it can be run again."""
    from trueplant.report import loopfigures as draw

    count = draw.until_settled(curves)
    t = curves.t[:count]
    cases = (
        ("Set-point step: PV", curves.setpoint, pv, 1.0, draw.settling_caption(curves.t, curves.setpoint, time_unit)),
        ("Load step: PV", curves.load, pv, 0.0, draw.size_caption("Largest error", curves.load, pv)),
        ("Set-point step: OP", curves.op_setpoint, op, None, draw.size_caption("Largest move", curves.op_setpoint, op)),
        ("Load step: OP", curves.op_load, op, None, draw.size_caption("Largest move", curves.op_load, op)),
    )
    figures = []
    for title, responses, unit, goal, said in cases:
        cut = {role: values[:count] for role, values in responses.items()}
        figures.append(book.add(draw.before_after(t, cut, time_unit, unit, goal), title, said))
    if curves.replay_t.size:
        figure = draw.replay(curves.replay_t, curves.replay, time_unit, pv, levels.MOST_POINTS)
        title = "The record again: control error with the disturbances that were in it"
        figures.append(book.add(figure, title, draw.replay_caption(curves.replay, pv)))
    return figures


def _mu_figures(curves: Curves | None, book: Book) -> list[Drawn]:
    from trueplant.report import loopfigures

    if curves is None or not curves.mu:
        return []
    unit = curves.time_unit
    return [
        book.add(loopfigures.mu_test(curves.mu, test, unit), label, loopfigures.mu_caption(curves.mu, test, unit))
        for test, label in loops.TESTS.items()
        if any(test in one.bounds for one in curves.mu)
    ]


def _figures(curves: Curves, book: Book, z: float) -> dict[str, Any]:
    from trueplant.report import captions, figures

    limit = _points(curves)
    steps = _matrix(
        curves,
        (curves.step_model, curves.step_plant),
        lambda i, j: (figures.step_response(curves, i, j), captions.step_response(curves, i, j)),
        book,
    )
    shown = [
        (t, _trend_figures(curves, t, book, limit), tables.excluded_table(t, curves.calendar(t))) for t in curves.trends
    ]
    bodes = _matrix(
        curves,
        (curves.bode_model, curves.bode_plant),
        lambda i, j: (figures.bode(curves, i, j, z), captions.bode(curves, i, j)),
        book,
    )
    residuals = [_residual_figures(curves, found, book, limit) for found in curves.residuals]
    explained = curves.coherence
    coherences = [
        book.add(figures.coherence(curves, explained, i), name, captions.coherence(curves, explained, i))
        for i, name in enumerate(curves.outputs)
        if explained is not None
    ]
    condition = None
    if np.isfinite(curves.condition).any():
        title = "Condition number of the excitation"
        condition = book.add(figures.condition(curves), title, captions.condition(curves))
    return {
        "steps": steps,
        "trends": shown,
        "bodes": bodes,
        "residuals": residuals,
        "condition": condition,
        "coherences": coherences,
        "coherent_with": "the set-points" if curves.coherence is None or curves.coherence.setpoints else "OP",
        "np_label": curves.np_label or "estimate without a model",
        "has_plant": bool(np.isfinite(curves.bode_plant).any()),
        "has_setpoint": any(np.isfinite(t.r).any() for t in curves.trends),
        "has_excluded": any(t.excluded for t in curves.trends),
        "has_points": bool(np.isfinite(curves.np_value).any()),
        "time_unit": curves.time_unit,
    }


def _matrix(
    curves: Curves, both: tuple[Any, Any], draw: Callable[[int, int], tuple[Any, str]], book: Book
) -> list[tuple[str, list[Drawn], list[str]]]:
    """For each output its figures, and the inputs that neither model nor plant answers to.

    both: the curves (n, n_y, n_u) of model and plant; draw: figure and caption of an element.
    """
    from trueplant.report import figures

    rows = []
    for i, output in enumerate(curves.outputs):
        drawn, still = [], []
        for j, name in enumerate(curves.inputs):
            if figures.has_response(both[0][:, i, j], both[1][:, i, j]):
                figure, caption = draw(i, j)
                drawn.append(book.add(figure, f"{name} → {output}", caption))
            else:
                still.append(name)
        rows.append((output, drawn, still))
    return rows


def _residual_figures(curves: Curves, found: Residuals, book: Book, limit: int) -> tuple[str, Drawn, list[Drawn]]:
    """The prediction errors of one output over time, and their correlations."""
    from trueplant.report import captions, figures

    unit = dict(zip(curves.outputs, curves.output_units, strict=True)).get(found.output, "")
    over_time = book.add(
        figures.residuals_over_time(curves, found, unit, limit),
        f"Prediction errors of {found.output}",
        captions.residuals_over_time(found, unit),
    )
    pairs_of_lags = [("Autocorrelation", found.lags, found.acf, found.acf_bound, found.lags != 0)] + [
        (f"Correlation with {name}", found.ccf_lags, value, found.ccf_bound, np.ones(value.size, dtype=bool))
        for name, value in found.ccf.items()
    ]
    correlations = [
        book.add(figures.correlation(lags, value, bound), title, captions.correlation(lags[told], value[told], bound))
        for title, lags, value, bound, told in pairs_of_lags
    ]
    return found.output, over_time, correlations


def _trend_figures(curves: Curves, trend: Trend, book: Book, limit: int) -> list[Drawn]:
    from trueplant.report import captions, figures

    drawn = []
    for panels in figures.trend_panels(curves):
        names = ", ".join(curves.outputs[i] if kind == "y" else curves.inputs[i] for kind, i in panels)
        caption = captions.trends(curves, trend, panels)
        drawn.append(book.add(figures.trends(curves, trend, panels, limit), f"{trend.name}: {names}", caption))
    return drawn


def _points(curves: Curves) -> int:
    """Points a trace, so that many long experiments together stay small enough to open quickly."""
    traces = len(curves.trends) * (4 * len(curves.outputs) + len(curves.inputs)) + len(curves.residuals)
    return max(400, min(levels.MOST_POINTS, levels.ALL_POINTS // max(1, traces)))
