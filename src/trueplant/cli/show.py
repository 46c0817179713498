"""A result on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import RenderableType
from rich.text import Text

from trueplant.cli.layout import Group, blocks, console, text
from trueplant.result import Element, Parameter, Result
from trueplant.result.detectors_words import detector_lines
from trueplant.result.headline import has_moved, seen
from trueplant.result.methods_words import comparison_lines
from trueplant.result.numbers import counted, number, percentage, value_with_interval
from trueplant.result.reason import is_common
from trueplant.result.status import ElementVerdict
from trueplant.result.summary import loop_line, settings_lines, told_elements, told_reasons, worth_knowing

_STYLE = {
    ElementVerdict.CHANGED: "bold red",
    ElementVerdict.UNCHANGED: "green",
    ElementVerdict.FOUND: "bold",
    ElementVerdict.NONE_FOUND: "dim",
    ElementVerdict.NOT_IDENTIFIABLE: "yellow",
}


def show(result: Result, written: Sequence[Path]) -> None:
    """The headline, a table of the elements, what to know about the data, and the files written."""
    out = console()
    out.print(text(result.shift, style="bold"))
    out.print(text(result.headline))
    if told_elements(result):
        out.print()
        for line in elements_table(result, out.width):
            out.print(line)
        out.print()
        out.print(text(legend(result)))
    for line in (loop_line(result), *settings_lines(result), *comparison_lines(result), *detector_lines(result)):
        if line:
            out.print(text(line))
    for reason in (*told_reasons(result), *worth_knowing(result)):
        where = f" ({reason.where})" if reason.where else ""
        out.print(text(f"{'refused' if reason in result.reasons else 'note'}{where}: {reason.message}"))
    if common := sum(map(is_common, result.notes)):
        out.print(text(f"({counted(common, 'note')} on what holds for most records: in report.html)"))
    for path in written:
        out.print(text(str(path)), soft_wrap=True)


def elements_table(result: Result, width: int) -> Iterator[RenderableType]:
    """Below each element with its verdict, a row a parameter: what the model says, and what the plant does."""
    plant = f"plant ({100 * result.provenance.settings.confidence:g} % interval)"
    modelled = any(element.tf_model is not None for element in result.elements)
    headings = ("parameter", "model", plant, "change") if modelled else ("parameter", plant)
    groups: list[Group] = []
    for element in told_elements(result):
        before = ["", *(parameter.reason for parameter in element.parameters)]
        rows = [
            _parameter_cells(replace(p, reason="likewise") if p.reason and p.reason == above else p)
            for above, p in zip(before, element.parameters, strict=False)
        ]
        groups.append((_title(element), rows if modelled else [(name, answer) for name, _, answer, _ in rows]))
    return blocks(headings, groups, ("model", "change"), width)


def legend(result: Result) -> str:
    """What the marks of the table mean, as far as there are any."""
    marked = any(parameter.changed for element in result.elements for parameter in element.parameters)
    moved = has_moved(result)
    good = f"A and B are good enough to retune on{', but not what changed during the record' if moved else ''}"
    grades = {
        "A": good,
        "B": good,
        "C": "C is rough",
        "D": "D leaves something unanswered",
    }
    said = dict.fromkeys(text for grade, text in grades.items() if any(e.grade == grade for e in result.elements))
    return ". ".join(
        filter(None, ["* changed, beyond chance" if marked else "", f"Grade: {', '.join(said)}" if said else ""])
    )


def _title(element: Element) -> Text:
    said = text(f"{element.input} -> {element.output}: ")
    said.append(text(element.verdict, style=_STYLE.get(element.verdict, "")))
    if element.grade:
        said.append(text(f", grade {element.grade}"))
    if element.verdict == ElementVerdict.NOT_IDENTIFIABLE:
        said.append(text(seen(element)))
    return said if element.parameters or not element.reason else said.append(text(f" ({element.reason})"))


def _parameter_cells(parameter: Parameter) -> tuple[Text, Text, Text, Text]:
    unit = f" {parameter.unit}" if parameter.unit else ""
    model = "-" if parameter.model is None else number(parameter.model)
    if parameter.plant is None:
        plant = parameter.reason or "not known"
    elif parameter.ci is None:
        plant = f"{number(parameter.plant)}{unit}"
    else:
        plant = f"{value_with_interval(parameter.plant, parameter.ci)}{unit}"
    percent = "" if parameter.change_percent is None else percentage(parameter.change_percent)
    percent = f"{percent} *".strip() if parameter.changed else f"{percent}  "
    style = "bold" if parameter.changed else ""
    return text(parameter.name.replace("_", " ")), text(model), text(plant, style=style), text(percent, style=style)
