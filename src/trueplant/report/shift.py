"""One sheet of paper for the shift: what the plant does now, whether today's tuning holds, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from trueplant.report.levels import MOST_CELLS, MOST_LINES
from trueplant.report.page import environment
from trueplant.result import Code, Element, ElementVerdict, Result, Status
from trueplant.result.headline import is_another
from trueplant.result.numbers import counted, percentage, spoken
from trueplant.result.summary import loop_line, settings_lines

_CAUSES = tuple(code for code in Code if code.name.startswith("CAUSE_"))
_KINDS = {ElementVerdict.CHANGED: "changed", ElementVerdict.NOT_IDENTIFIABLE: "unknown"}


@dataclass(frozen=True)
class Cell:
    """One element of the matrix."""

    kind: str
    text: str


def render_shift(result: Result) -> str:
    """The sheet as HTML text, without scripts; one page of A4 in print. The same result gives the same text."""
    inputs = list(dict.fromkeys(e.input for e in result.elements))
    rows = _matrix(result, inputs)
    small = len(inputs) * len(rows) <= MOST_CELLS
    page = (
        environment("trueplant.report")
        .get_template("shift.html.j2")
        .render(
            shift=result.shift,
            headline=result.headline.replace("->", "→"),
            inputs=[spoken(name) for name in inputs],
            rows=rows if small else (),
            listed=() if small else _cut([_line(e) for e in result.elements if e.verdict != ElementVerdict.UNCHANGED]),
            tuning=_tuning(result),
            loop_line=loop_line(result),
            settings=_cut([line.strip().replace("->", "→") for line in settings_lines(result)]),
            todo=_cut(list(_todo(result))),
            origin=_origin(result),
        )
    )
    return page + "\n"


def _matrix(result: Result, inputs: list[str]) -> list[tuple[str, list[Cell]]]:
    found = {(e.output, e.input): e for e in result.elements}
    outputs = dict.fromkeys(e.output for e in result.elements)
    return [(spoken(output), [_cell(found.get((output, name))) for name in inputs]) for output in outputs]


def _cell(element: Element | None) -> Cell:
    if element is None:
        return Cell("", "–")
    return Cell(_KINDS.get(element.verdict, ""), _said(element))


def _said(element: Element) -> str:
    """The verdict, and by how much the parameters that changed have."""
    moved = [
        f"{spoken(p.name)} {'other' if p.change_percent is None else percentage(p.change_percent, 0)}"
        for p in element.parameters
        if p.changed
    ]
    return f"{element.verdict}: {', '.join(moved)}" if moved else str(element.verdict)


def _line(element: Element) -> str:
    return f"{spoken(element.input)} → {spoken(element.output)}: {_said(element)}"


def _cut(lines: list[str]) -> list[str]:
    left = len(lines) - MOST_LINES
    return lines if left <= 0 else [*lines[:MOST_LINES], f"and {left} more in report.html"]


def _tuning(result: Result) -> str:
    """Whether the loops may stay as they are today."""
    found = result.robustness
    if found is None:
        return "Not known: no controller is declared, or nothing was answered."
    if is_another(result):
        return "Not known: OP was written by another controller than declared. Look up which settings are in it."
    if any(not loop.stable for loop in found.margins.plant):
        return "NOT SAFE: at least one loop is unstable on the plant as estimated."
    if found.worse:
        return f"CLOSE TO ITS LIMIT: {', '.join(map(spoken, found.worse))}."
    if found.drawn is not None and found.drawn.share_stable < 1:
        return "NOT SURE: unstable on some of the plants that the data leave open."
    if any(e.verdict == ElementVerdict.NOT_IDENTIFIABLE for e in result.elements):
        return "Safe, if what the data leave open is as in the model."
    return "Safe, as far as these data tell."


def _todo(result: Result) -> Iterator[str]:
    """The causes that were found, what else speaks against the settings of today, and how to learn more.

    Of a refusal: why, place by place, and which other structure might end it.
    """
    refused = result.status == Status.REFUSED
    # that nothing can be told stands in the headline
    reasons = [r for r in result.reasons if r.where or r.code is not Code.NOT_IDENTIFIABLE] if refused else []
    told = {*_CAUSES, Code.UNDERMODELLED} if refused else set(_CAUSES)
    for said in (*reasons, *(note for note in result.notes if note.code in told)):
        where = f" ({spoken(said.where)})" if said.where else ""
        yield f"{said.message}{where}".replace("->", "→")
    yield from (plan.sentence.replace("->", "→") for plan in result.more_data[:1])
    asked = result.robustness is None or result.controllers or is_another(result)  # or asked in vain
    if result.mismatch and not asked:
        yield "settings for the plant as it is now: add the table [tuning] to the project and run it again"
    if result.mismatch or refused or result.more_data:
        return
    open_ones = [e for e in result.elements if e.verdict == ElementVerdict.NOT_IDENTIFIABLE]
    for element in open_ones:
        yield f"{spoken(element.input)} → {spoken(element.output)}: {element.reason or 'not answered by these data'}"
    if not open_ones:
        yield "nothing: the model still describes the plant as far as these data tell"


def _origin(result: Result) -> str:
    unit = result.provenance.time_unit
    records = [f"{one.name} ({one.calendar(unit).span(*one.span)})" for one in result.data]
    told = records[0] if len(records) == 1 else counted(len(records), "record")
    return f"{result.provenance.project}; {told}; trueplant {result.provenance.version}; all of it in report.html"
