"""A result in words, as terminal text, as notebook HTML, and as plain Python for JSON."""

from __future__ import annotations

import dataclasses
import html
import math
from collections.abc import Collection, Mapping, Sequence
from datetime import date, datetime
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.study.result import Element, Parameter, Result

if TYPE_CHECKING:
    from trueplant.study.track_result import Track

_PHRASES = {
    "gain": "a gain",
    "slope": "a slope",
    "tau": "a time constant",
    "lead": "a lead time",
    "dead_time": "a dead time",
    "omega0": "a natural frequency",
    "zeta": "a damping ratio",
}
_SYMBOLS = {"gain": "K", "slope": "K'", "dead_time": "dead time"}


def headline(result: Result) -> str:
    """The verdict first, in a sentence or two for the person at the panel."""
    if result.status == "refused":
        why = result.reasons[0].message if result.reasons else "the data do not say enough"
        more = len(result.reasons) - 1
        rest = f" ({more} more reason{'s' if more > 1 else ''} in the result)" if more > 0 else ""
        return f"No answer can be given: {_sentence(why)}{rest}"
    changed = sorted((e for e in result.elements if e.verdict == "changed"), key=_weight)
    open_ones = [e for e in result.elements if e.verdict == "not identifiable"]
    kept = len(result.elements) - len(changed) - len(open_ones)
    if changed:
        text = f"The plant has changed: {_what_changed(changed[0])}."
        if len(changed) > 1:
            text += f" {_also(changed[1:])}"
        if kept:
            text += f" {counted(kept, 'element')} with no change found."
    elif kept:
        whole = "" if open_ones else "all " if kept > 1 else ""
        where = f"{whole}{counted(kept, 'element')}" if kept > 1 or open_ones else _arrow(result.elements[0])
        text = f"No change was found in {where}{_hidden([e for e in result.elements if e.verdict == 'unchanged'])}."
        settings = result.provenance.get("settings", {})
        tolerance, level = settings.get("tolerance_percent"), 1 - settings.get("confidence", 0.95)
        p_values = [p.p_adjusted for e in result.elements for p in e.parameters if p.p_adjusted is not None]
        if tolerance and min(p_values, default=1.0) < level:
            text += f" Differences beyond chance are there, but none above the tolerance of {tolerance:g} %."
    else:
        text = "No verdict is possible: none of the elements can be told from these data."
    if open_ones and (changed or kept):
        text += f" {counted(len(open_ones), 'element')} could not be judged ({', '.join(map(_arrow, open_ones[:3]))}"
        text += f" and {len(open_ones) - 3} more)." if len(open_ones) > 3 else ")."
    return text


def _hidden(elements: Sequence[Element]) -> str:
    """How large a change of a gain could be without being found."""
    gains = [p for e in elements for p in e.parameters if p.name.startswith("gain") and p.model and p.ci is not None]
    reach = [100 * max(abs(end - p.model) for end in p.ci or ()) / abs(p.model) for p in gains if p.model]
    if not reach or not math.isfinite(max(reach)):
        return ""
    return f"; a change of a gain by {max(reach):.2g} % would still fit these data"


def _weight(element: Element) -> tuple[float, float]:
    importance = element.importance.value
    return -(importance if importance is not None and math.isfinite(importance) else 0.0), element.p_adjusted or 0.0


def _arrow(element: Element) -> str:
    return f"{spoken(element.input)} -> {spoken(element.output)}"


def spoken(name: str) -> str:
    return name.replace("_", " ")


def counted(n: int, word: str, plural: str = "s") -> str:
    return f"{n} {word}{plural if n != 1 else ''}"


def _sentence(text: str) -> str:
    text = text.strip()
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _what_changed(element: Element) -> str:
    moved = [p for p in element.parameters if p.changed and p.plant is not None]
    where = _arrow(element)
    if element.tf_model.strip() in ("0", "0.0", ""):
        known = [p for p in element.parameters if p.plant is not None]
        values = ", ".join(f"{_phrase(p, known)} of {_quantity(p.plant, p.unit)}" for p in known)
        return f"{where} responds with {values}, where the model has no response" if values else f"{where} responds"
    if not moved:
        return f"{where} differs from the model as a whole, though no single parameter does for certain"
    clauses = []
    for parameter in moved:
        clause = f"{_phrase(parameter, element.parameters)} of {_quantity(parameter.plant, parameter.unit)}"
        if parameter.model is not None:
            clause += f", not {_quantity(parameter.model, parameter.unit)}"
            if parameter.change_percent is not None and math.isfinite(parameter.change_percent):
                clause += f" ({parameter.change_percent:+.0f} %)"
        clauses.append(clause)
    return f"{where} responds with {_listed(clauses)}"


def _listed(clauses: Sequence[str]) -> str:
    return clauses[0] if len(clauses) == 1 else f"{'; '.join(clauses[:-1])}; and {clauses[-1]}"


def _also(elements: Sequence[Element]) -> str:
    named = [f"{_arrow(e)} ({_short(e)})" for e in elements[:3]]
    rest = f" and {len(elements) - 3} more" if len(elements) > 3 else ""
    return f"Changed too: {', '.join(named)}{rest}."


def _short(element: Element) -> str:
    if element.tf_model.strip() in ("0", "0.0", ""):
        return "not in the model"
    parts = []
    for p in element.parameters:
        if p.changed and p.plant is not None:
            told = p.change_percent is not None and math.isfinite(p.change_percent)
            size = f"{p.change_percent:+.0f} %" if told else f"{number(p.plant)} {p.unit}".strip()
            parts.append(f"{p.name.replace('_', ' ')} {size}")
    return ", ".join(parts) or "as a whole"


def _phrase(parameter: Parameter, parameters: Sequence[Parameter]) -> str:
    base = parameter.name.rstrip("0123456789") if parameter.name != "omega0" else "omega0"
    alike = [p for p in parameters if p.name.rstrip("0123456789") == base]
    phrase = _PHRASES.get(base, f"a {parameter.name}")
    ordinal = {"1": "first", "2": "second", "3": "third"}.get(parameter.name[-1])
    return phrase.replace("a ", f"a {ordinal} ", 1) if len(alike) > 1 and ordinal else phrase


def _quantity(value: float | None, unit: str) -> str:
    return f"{number(value)} {unit}".rstrip()


def number(value: float | None, digits: int = 3) -> str:
    """Three significant digits, without an exponent where it can be helped."""
    if value is None or not math.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{value:.{max(decimals, 0)}f}"


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


def value_with_interval(value: float, ci: tuple[float, float]) -> str:
    """``0.917 ± 0.012`` with half of the interval, or ``0.917, 0.90 to 0.95`` where it is lopsided."""
    if not all(map(math.isfinite, ci)):
        if math.isfinite(ci[0]) or math.isfinite(ci[1]):
            known = f"at least {number(ci[0])}" if math.isfinite(ci[0]) else f"at most {number(ci[1])}"
        else:
            known = "no limit known"
        return f"{number(value)}, {known}"
    below, above = value - ci[0], ci[1] - value
    half = (below + above) / 2
    if not half > 0 or half > 1e6 * max(abs(value), 1e-300):
        return f"{number(value)}, {number(ci[0])} to {number(ci[1])}"
    decimals = min(max(1 - math.floor(math.log10(half)), 0), 12)
    if abs(above - below) > 0.4 * half:
        return f"{value:.{decimals}f}, {ci[0]:.{decimals}f} to {ci[1]:.{decimals}f}"
    return f"{value:.{decimals}f} ± {half:.{decimals}f}"


def text_summary(result: Result) -> str:
    """What a terminal shows."""
    from trueplant.study.detectors_words import detector_lines
    from trueplant.study.methods_words import comparison_lines

    lines = [headline(result)]
    confidence = result.provenance.get("settings", {}).get("confidence") if result.elements else None
    if confidence:
        lines.append(f"(± is half of the {100 * confidence:g} % interval)")
    for element in result.elements:
        grade = f", grade {element.grade}" if element.grade else ""
        lines += ["", f"{element.input} -> {element.output} ({element.structure}): {element.verdict}{grade}"]
        lines += [f"  {parameter_line(p)}" for p in element.parameters]
        if element.reason:
            lines.append(f"  {_sentence(element.reason)}")
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
            lines.append(f"{title}{where}: {_sentence(reason.message)}")
    return "\n".join(lines)


def loop_line(result: Result) -> str:
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


def settings_lines(result: Result) -> list[str]:
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
        lines.append(f"  because it {_sentence(loops[0]['reason'])}")
    if loops and not lines:
        lines.append(f"no retuning is recommended: {_sentence(loops[0]['reason'] or 'see the report')}")
    return lines


def _setting(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else f"{value:.4g}"


def html_summary(result: Result) -> str:
    """What a notebook shows."""
    rows = []
    for element in result.elements:
        cells = "<br>".join(html.escape(parameter_line(p)) for p in element.parameters)
        named = html.escape(f"{element.input} → {element.output}")
        said = html.escape(f"{element.verdict}, grade {element.grade}" if element.grade else element.verdict)
        rows.append(f"<tr><td>{named}</td><td>{said}</td><td style='text-align:left'>{cells}</td></tr>")
    notes = "".join(f"<li>{html.escape(_sentence(r.message))}</li>" for r in (*result.reasons, *result.notes))
    head = "<tr><th>element</th><th>verdict</th><th>parameters</th></tr>"
    table = f"<table>{head}{''.join(rows)}</table>" if rows else ""
    return f"<p><b>{html.escape(headline(result))}</b></p>{table}{f'<ul>{notes}</ul>' if notes else ''}"


def document(outcome: Result | Track, left_out: Collection[str] = ()) -> dict[str, Any]:
    """An outcome as plain Python (schema 1), without some of its fields; first what happened, then what was found."""
    names = dict.fromkeys(["status", "headline", "reasons", "notes", *(f.name for f in dataclasses.fields(outcome))])
    return {"schema": 1} | {name: plain(getattr(outcome, name)) for name in names if name not in left_out}


def plain(value: Any) -> Any:
    """``value`` as what JSON can hold: dataclasses and mappings as dicts, arrays as lists, non-finite numbers as None.

    Raises TypeError for anything else, rather than write what nobody can read back.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (set, frozenset)):
        return sorted(plain(entry) for entry in value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, complex):
        return {"re": plain(value.real), "im": plain(value.imag)}
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, (datetime, date)):
        return value.isoformat()
    if isinstance(value, PurePath):
        return value.as_posix()
    raise TypeError(f"a {type(value).__name__} has no place in result.json")
