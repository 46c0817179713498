"""A result on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from trueplant.printable import printable
from trueplant.result import Element, Parameter, Result
from trueplant.result.detectors_words import detector_lines
from trueplant.result.methods_words import comparison_lines
from trueplant.result.numbers import number, value_with_interval
from trueplant.result.status import ElementVerdict
from trueplant.result.summary import loop_line, settings_lines

_STYLE = {
    ElementVerdict.CHANGED: "bold red",
    ElementVerdict.UNCHANGED: "green",
    ElementVerdict.FOUND: "bold",
    ElementVerdict.NONE_FOUND: "dim",
    ElementVerdict.NOT_IDENTIFIABLE: "yellow",
}


def console() -> Console:
    """Standard output; in a pipe lines are not folded at 80 columns."""
    on_terminal = Console(highlight=False, soft_wrap=True)
    return on_terminal if on_terminal.is_terminal else Console(highlight=False, soft_wrap=True, width=140)


def say_lines(*lines: object) -> None:
    """Print plain lines."""
    print(*(printable(str(line)) for line in lines), sep="\n")


def text(content: str, **style: Any) -> Text:
    """For the terminal: names and messages may hold what came with the data."""
    return Text(printable(content), **style)


def show(result: Result, written: Sequence[Path]) -> None:
    """The headline, a table of the elements, what to know about the data, and the files written."""
    out = console()
    out.print(text(result.headline, style="bold"))
    if result.elements:
        out.print(elements_table(result))
        out.print(text(legend(result)))
    for line in (loop_line(result), *settings_lines(result), *comparison_lines(result), *detector_lines(result)):
        if line:
            out.print(text(line))
    for reason in (*result.reasons, *result.notes):
        where = f" ({reason.where})" if reason.where else ""
        out.print(text(f"{'refused' if reason in result.reasons else 'note'}{where}: {reason.message}"))
    for path in written:
        out.print(text(str(path)))


def elements_table(result: Result) -> Table:
    """One row a parameter: what the model says, what the plant does, and the verdict of its element."""
    plant = f"plant ({100 * result.provenance.settings.confidence:g} % interval)"
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    modelled = any(element.tf_model is not None for element in result.elements)
    for heading in ("element", "verdict", "grade", "parameter", "model", plant, "change"):
        compared = heading in ("model", "change")
        if modelled or not compared:
            table.add_column(heading, justify="right" if compared else "left", overflow="fold")
    for element in result.elements:
        for k, parameter in enumerate(element.parameters or (None,)):
            name, model, answer, change = _parameter_cells(element, parameter)
            cells = (name, model, answer, change) if modelled else (name, answer)
            table.add_row(*(_element_cells(element) if k == 0 else ("", "", "")), *cells)
    return table


def legend(result: Result) -> str:
    """What the marks of the table mean, as far as there are any."""
    marked = any(parameter.changed for element in result.elements for parameter in element.parameters)
    grades = {
        "A": "A and B are good enough to retune on",
        "B": "A and B are good enough to retune on",
        "C": "C is rough",
        "D": "D leaves something unanswered",
    }
    said = dict.fromkeys(text for grade, text in grades.items() if any(e.grade == grade for e in result.elements))
    return ". ".join(
        filter(None, ["* changed, beyond chance" if marked else "", f"Grade: {', '.join(said)}" if said else ""])
    )


def _element_cells(element: Element) -> tuple[Text, Text, Text]:
    name = text(f"{element.input} -> {element.output}")
    return name, text(element.verdict, style=_STYLE.get(element.verdict, "")), text(element.grade)


def _parameter_cells(element: Element, parameter: Parameter | None) -> tuple[Text, Text, Text, Text]:
    if parameter is None:
        return Text(""), Text(""), text(element.reason), Text("")
    unit = f" {parameter.unit}" if parameter.unit else ""
    model = "-" if parameter.model is None else number(parameter.model)
    if parameter.plant is None:
        plant = parameter.reason or "not known"
    elif parameter.ci is None:
        plant = f"{number(parameter.plant)}{unit}"
    else:
        plant = f"{value_with_interval(parameter.plant, parameter.ci)}{unit}"
    percent = "" if parameter.change_percent is None else f"{parameter.change_percent:+.1f} %"
    percent = f"{percent} *".strip() if parameter.changed else f"{percent}  "
    style = "bold" if parameter.changed else ""
    return text(parameter.name.replace("_", " ")), text(model), text(plant, style=style), text(percent, style=style)
