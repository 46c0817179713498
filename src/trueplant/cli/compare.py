"""The command ``compare``: two saved results beside each other."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from rich.console import RenderableType

from trueplant.cli.analyse import REFUSED
from trueplant.cli.layout import Group, blocks, console, text
from trueplant.detect.beside import compare_results
from trueplant.errors import UsageError
from trueplant.output import as_json, read_results
from trueplant.result import Result, Status
from trueplant.result.comparison import ComparedLoop, ComparedParameter, Comparison
from trueplant.result.numbers import number, percentage, value_with_interval


def compare(first: Path, second: Path, json: bool) -> int:
    """Say what differs between two results, and whether that is beyond chance."""
    results = read_results(first), read_results(second)
    _require_common(first, second, *results)
    found = compare_results(*results)
    if json:
        sys.stdout.write(as_json(found.to_dict()))
    else:
        show(found, (str(first), str(second)))
    return REFUSED if found.status == Status.REFUSED else 0


def _require_common(first: Path, second: Path, a: Result, b: Result) -> None:
    ours, theirs = ({(e.output, e.input) for e in result.elements} for result in (a, b))
    if ours and theirs and not ours & theirs:
        told = [", ".join(f"{source} -> {output}" for output, source in sorted(pairs)) for pairs in (ours, theirs)]
        raise UsageError(
            f"{first} and {second} have no element in common ({told[0]}; {told[1]}): give outputs and inputs the same "
            "names in both project files and run them again"
        )


def show(found: Comparison, names: tuple[str, str]) -> None:
    """The headline, a row a parameter, then verdicts, fit, settings and notes."""
    out = console()
    out.print(text(found.headline, style="bold"))
    if any(e.parameters for e in found.elements):
        for line in _table(found, names, out.width):
            out.print(line)
        if found.independent:
            out.print(text(f"* differs beyond chance ({100 * found.confidence:g} %, over all parameters together)"))
    for element in found.elements:
        told = element.verdicts
        said = told[0] if told[0] == told[1] else f"{told[0]}, then {told[1]}"
        other = "" if element.models[0] == element.models[1] else f"; the model was {element.models[0]}, then "
        after = f"{other}{element.models[1]}" if other else ""
        out.print(text(f"{element.input} -> {element.output}: {said}{after}"))
    for fit in found.fit:
        told_fit = ", then ".join("unknown" if one is None else f"{one:.1f} %" for one in fit.fit_percent)
        out.print(text(f"fit of {fit.output}: {told_fit}"))
    for loop in found.controllers:
        out.print(text(f"settings of {loop.input}: {_settings(loop)}"))
    for reason in (*found.reasons, *found.notes):
        out.print(text(f"{'refused' if reason in found.reasons else 'note'}: {reason.message}"))


def _table(found: Comparison, names: tuple[str, str], width: int) -> Iterator[RenderableType]:
    groups: list[Group] = []
    for element in found.elements:
        rows = [tuple(map(text, (one.name.replace("_", " "), *_cells(one)))) for one in element.parameters]
        groups.append((text(f"{element.input} -> {element.output}"), rows))
    return blocks(("parameter", *names, "difference", "p"), groups, ("p",), width)


def _cells(one: ComparedParameter) -> Iterator[str]:
    for value, ci in ((one.first, one.first_ci), (one.second, one.second_ci)):
        known = "not known" if value is None else number(value) if ci is None else value_with_interval(value, ci)
        yield f"{known} {one.unit}".rstrip() if value is not None else known
    if one.difference is None:
        yield one.reason
        yield ""
        return
    share = f" ({percentage(100 * one.difference / abs(one.first))})" if one.first else ""
    error = "" if one.std_error is None else f", std error {number(one.std_error, 2)}"
    yield f"{number(one.difference)}{error}{share}{' *' if one.differs else ''}"
    yield "" if one.p_adjusted is None else f"{one.p_adjusted:.2g}"


def _settings(loop: ComparedLoop) -> str:
    told = [_values(values) for values in (loop.first, loop.second)]
    return told[0] if told[0] == told[1] else f"{told[0]}, then {told[1]}"


def _values(values: object) -> str:
    if not isinstance(values, dict) or not values:
        return "none recommended"
    shown = ((key, f"{value:.4g}" if isinstance(value, float) else str(value)) for key, value in values.items())
    return " ".join(f"{key} {value}" for key, value in shown if value != "None")
