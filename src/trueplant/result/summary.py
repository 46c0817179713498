"""A result as terminal text and as notebook HTML, and its lines on loops and settings."""

from __future__ import annotations

import html
import math
from typing import Any

from trueplant.result.detectors_words import detector_lines
from trueplant.result.element import Parameter
from trueplant.result.headline import headline
from trueplant.result.methods_words import comparison_lines
from trueplant.result.numbers import number, sentence, spoken, value_with_interval
from trueplant.result.outcome import Outcome

_SYMBOLS = {"gain": "K", "slope": "K'", "dead_time": "dead time"}


def parameter_line(parameter: Parameter) -> str:
    """``K = 0.917 ± 0.012 degC/% (model 0.932, -1.6 %)``; ± is half of the interval."""
    base = parameter.name.rstrip("0123456789")
    symbol = _SYMBOLS.get(base, parameter.name)
    symbol += parameter.name.removeprefix(base) if base in _SYMBOLS else ""
    unit = f" {parameter.unit}" if parameter.unit else ""
    if parameter.plant is None:
        known = f"model {number(parameter.model)}{unit}" if parameter.model is not None else "not in the model"
        return f"{symbol} not known: {parameter.reason or 'the data do not say'} ({known})"
    if parameter.ci is None:
        value = f"{number(parameter.plant)}{unit}"
    else:
        value = f"{value_with_interval(parameter.plant, parameter.ci)}{unit}"
    if parameter.model is None:
        compared = "not in the model"
    else:
        compared = f"model {number(parameter.model)}"
        if parameter.change_percent is not None and math.isfinite(parameter.change_percent):
            compared += f", {parameter.change_percent:+.1f} %"
    return f"{symbol} = {value} ({compared})" + ("  changed" if parameter.changed else "")


def text_summary(result: Outcome) -> str:
    """What a terminal shows."""

    lines = [headline(result)]
    confidence = result.provenance.get("settings", {}).get("confidence") if result.elements else None
    if confidence:
        lines.append(f"(± is half of the {100 * confidence:g} % interval)")
    for element in result.elements:
        grade = f", grade {element.grade}" if element.grade else ""
        lines += ["", f"{element.input} -> {element.output} ({element.structure}): {element.verdict}{grade}"]
        lines += [f"  {parameter_line(p)}" for p in element.parameters]
        if element.reason:
            lines.append(f"  {sentence(element.reason)}")
    if compared := comparison_lines(result):
        lines += ["", *compared]
    if detected := detector_lines(result):
        lines += ["", *detected]
    if loop := loop_line(result):
        lines += ["", loop, *settings_lines(result)]
    for title, reasons in (("refused", result.reasons), ("note", result.notes)):
        if reasons:
            lines.append("")
        for reason in reasons:
            where = f" ({reason.where})" if reason.where else ""
            lines.append(f"{title}{where}: {sentence(reason.message)}")
    return "\n".join(lines)


def loop_line(result: Outcome) -> str:
    """Whether the change matters to today's loops, in a sentence or two; empty where no controller is declared."""
    margins = result.robustness.get("margins")
    if not margins:
        return ""
    unstable = [spoken(loop["input"]) for loop in margins["plant"] if not loop["stable"]]
    if unstable:
        every = len(unstable) == len(margins["plant"]) > 1
        which = "the loops" if every else f"the loop of {' and '.join(unstable)}"
        return f"Today's controller leaves {which} unstable on the plant as estimated."
    measured = [loop for loop in margins["plant"] if loop["Ms"] is not None]
    text = "Today's controller keeps the plant stable"
    if measured:
        highest = max(measured, key=lambda loop: float(loop["Ms"]))
        before = next(loop for loop in margins["model"] if loop["input"] == highest["input"])
        text += f"; the sensitivity peaks at Ms = {number(highest['Ms'])} ({spoken(highest['input'])}; usual is below 2"
        text += f"; {number(before['Ms'])} on the model)" if before["stable"] else "; unstable on the model)"
    text += "."
    peaks = result.robustness.get("peaks", {})
    if "RP" in peaks.get("plant", {}):
        before, today = peaks["model"]["RP"]["upper"], peaks["plant"]["RP"]["upper"]
        holds = "holds" if peaks["plant"]["robust_performance_holds"] else "does not hold"
        peak = f"mu peaks at {number(today)} ({number(before)} on the model)" if _finite(today) else "mu has no bound"
        text += f" Robust performance {holds}: {peak}."
    drawn = result.robustness.get("drawn", {})
    if drawn and drawn["share_stable"] < 1:
        text += f" It is unstable on {100 * (1 - drawn['share_stable']):.2g} % of the plants that the data leave open."
    return text


def _finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def settings_lines(result: Outcome) -> list[str]:
    """The settings to enter, a line a loop; one line where today's are to stay; nothing where none were asked for."""
    loops = [loop for loop in result.controllers if "recommended" in loop]
    lines = []
    for loop in loops:
        chosen = next((p for p in loop["proposals"] if p["method"] == loop["recommended"]), None)
        if chosen is None:
            continue
        now, new = loop["current"]["settings"] or {}, chosen["settings"]
        changed = [
            f"{key} = {_setting(new[key])} (now {_setting(now.get(key))})"
            for key in new
            if key != "others" and _setting(new[key]) != _setting(now.get(key))
        ]
        said = ", ".join(changed) or "as today"
        if new.get("others"):
            said += f", and from {', '.join(new['others'])} as in the report"
        lines.append(f"recommended for {loop['input']} ({loop['recommended']}): {said}")
    if lines and loops[0]["reason"]:
        lines.append(f"  because it {sentence(loops[0]['reason'])}")
    if loops and not lines:
        lines.append(f"no retuning is recommended: {sentence(loops[0]['reason'] or 'see the report')}")
    return lines


def _setting(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else f"{value:.4g}"


def html_summary(result: Outcome) -> str:
    """What a notebook shows."""
    rows = []
    for element in result.elements:
        cells = "<br>".join(html.escape(parameter_line(p)) for p in element.parameters)
        named = html.escape(f"{element.input} → {element.output}")
        said = html.escape(f"{element.verdict}, grade {element.grade}" if element.grade else element.verdict)
        rows.append(f"<tr><td>{named}</td><td>{said}</td><td style='text-align:left'>{cells}</td></tr>")
    notes = "".join(f"<li>{html.escape(sentence(r.message))}</li>" for r in (*result.reasons, *result.notes))
    head = "<tr><th>element</th><th>verdict</th><th>parameters</th></tr>"
    table = f"<table>{head}{''.join(rows)}</table>" if rows else ""
    return f"<p><b>{html.escape(headline(result))}</b></p>{table}{f'<ul>{notes}</ul>' if notes else ''}"
