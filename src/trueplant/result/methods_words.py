"""What the methods that were asked for say, as a terminal shows it."""

from __future__ import annotations

from collections.abc import Sequence

from trueplant.result.methods import BlackBox, MethodElement, MethodParameter
from trueplant.result.numbers import number, value_with_interval
from trueplant.result.outcome import Outcome

Place = tuple[str, str]
USUAL = ("auto", "direct")
"""Values of `analysis.method` with which a terminal shows the fit alone: the report has the rest."""


def comparison_lines(result: Outcome) -> list[str]:
    """Element by element what each method answers; nothing where none was asked for."""
    if result.status != "ok" or result.provenance.settings.method in USUAL:
        return []
    methods = result.methods
    lines = ["beside the direct fit, on which the verdicts rest:"]
    for element in result.elements:
        place = (element.output, element.input)
        found = {name: values for name, rows in methods.answers.items() if (values := _of(rows, place))}
        lines.append(f"{element.input} -> {element.output}")
        for parameter in element.parameters:
            said = [
                f"{name} {_value(values[parameter.name])}"
                for name, values in found.items()
                if parameter.name in values and values[parameter.name].plant is not None
            ]
            unit = f" [{parameter.unit}]" if parameter.unit else ""
            lines.append(f"  {parameter.name.replace('_', ' ')}{unit}: {', '.join(said) or 'not known'}")
        lines += _black_box(methods.black_box, place)
    lines += [sentence for sentence in methods.agreement if sentence not in methods.disagreements]
    return lines + [f"{name} does not apply: {why}" for name, why in methods.not_applied.items() if why]


def _of(rows: Sequence[MethodElement], place: Place) -> dict[str, MethodParameter]:
    return {p.name: p for row in rows if (row.output, row.input) == place for p in row.parameters}


def _value(parameter: MethodParameter) -> str:
    if parameter.ci is None or parameter.plant is None:
        return number(parameter.plant)
    return value_with_interval(parameter.plant, parameter.ci)


def _black_box(found: BlackBox | None, place: Place) -> list[str]:
    rows = [] if found is None else [row.p_values for row in found.elements if (row.output, row.input) == place]
    return [
        f"  black box: {', '.join(f'{name} p = {number(p, 2)}' for name, p in p_values.items())}" for p_values in rows
    ]
