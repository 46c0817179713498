"""What the methods that were asked for say, as a terminal shows it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueplant.result.numbers import number, value_with_interval
from trueplant.result.outcome import Outcome

USUAL = ("auto", "direct")
"""Values of `analysis.method` with which a terminal shows the fit alone: the report has the rest."""


def comparison_lines(result: Outcome) -> list[str]:
    """Element by element what each method answers; nothing where none was asked for."""
    if result.status != "ok" or result.provenance.get("settings", {}).get("method", "auto") in USUAL:
        return []
    methods = result.methods
    ran = [name for name, rows in methods.items() if _answers(rows)]
    lines = ["beside the direct fit, on which the verdicts rest:"]
    for element in result.elements:
        place = (element.output, element.input)
        found = {name: values for name in ran if (values := _of(methods[name], place))}
        lines.append(f"{element.input} -> {element.output}")
        for parameter in element.parameters:
            said = [
                f"{name} {_value(values[parameter.name])}"
                for name, values in found.items()
                if _known(values, parameter.name)
            ]
            unit = f" [{parameter.unit}]" if parameter.unit else ""
            lines.append(f"  {parameter.name.replace('_', ' ')}{unit}: {', '.join(said) or 'not known'}")
        lines += _black_box(methods.get("black_box", {}), place)
    lines += [sentence for sentence in methods.get("agreement", ()) if "disagree" not in sentence]
    return lines + [f"{name} does not apply: {why}" for name, why in methods.get("not_applied", {}).items() if why]


def _answers(rows: Any) -> bool:
    return isinstance(rows, (list, tuple)) and any(isinstance(row, Mapping) and "parameters" in row for row in rows)


def _of(rows: Any, place: tuple[str, str]) -> dict[str, Mapping[str, Any]]:
    return {p["name"]: p for row in rows if (row["output"], row["input"]) == place for p in row["parameters"]}


def _known(values: Mapping[str, Mapping[str, Any]], name: str) -> bool:
    return name in values and values[name]["plant"] is not None


def _value(parameter: Mapping[str, Any]) -> str:
    if parameter["ci"] is None:
        return number(parameter["plant"])
    return value_with_interval(parameter["plant"], parameter["ci"])


def _black_box(table: Mapping[str, Any], place: tuple[str, str]) -> list[str]:
    rows = [row["p_values"] for row in table.get("elements", ()) if (row["output"], row["input"]) == place]
    return [
        f"  black box: {', '.join(f'{name} p = {number(p, 2)}' for name, p in p_values.items())}" for p_values in rows
    ]
