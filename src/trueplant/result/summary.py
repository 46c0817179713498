"""A result as terminal text and as notebook HTML, and its lines on loops and settings."""

from __future__ import annotations

import html
import math

from trueplant.result.controllers import KEEP
from trueplant.result.detectors_words import detector_lines
from trueplant.result.element import Element, Parameter
from trueplant.result.faceplate_words import faceplate_values
from trueplant.result.headline import headline, is_another, is_answered, seen
from trueplant.result.methods_words import comparison_lines
from trueplant.result.numbers import number, percentage, sentence, spoken, value_with_interval
from trueplant.result.outcome import Outcome
from trueplant.result.parameter_words import kind_of, number_of
from trueplant.result.reason import Code, Reason, is_common, ranked
from trueplant.result.robustness import Margins
from trueplant.result.status import Status

_SYMBOLS = {"gain": "K", "slope": "K'", "dead_time": "dead time"}


def parameter_line(parameter: Parameter) -> str:
    """``K = 0.917 ± 0.012 degC/% (model 0.932, -1.6 %)``; ± is half of the interval."""
    symbol = _SYMBOLS.get(kind_of(parameter.name))
    symbol = parameter.name if symbol is None else symbol + number_of(parameter.name)
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
            compared += f", {percentage(parameter.change_percent)}"
    return f"{symbol} = {value} ({compared})" + ("  changed" if parameter.changed else "")


def text_summary(result: Outcome) -> str:
    """What a terminal shows."""

    lines = [headline(result)]
    if told_elements(result):
        confidence = result.provenance.settings.confidence
        lines.append(f"(± is half of the {100 * confidence:g} % interval)")
    for element in told_elements(result):
        grade = f", grade {element.grade}" if element.grade else ""
        said = f"{element.verdict}{seen(element)}{grade}"
        lines += ["", f"{element.input} -> {element.output} ({element.structure}): {said}"]
        lines += [f"  {parameter_line(p)}" for p in element.parameters]
        if element.reason:
            lines.append(f"  {sentence(element.reason)}")
    if compared := comparison_lines(result):
        lines += ["", *compared]
    if detected := detector_lines(result):
        lines += ["", *detected]
    if loop := loop_line(result):
        lines += ["", loop, *settings_lines(result)]
    common = [note for note in result.notes if is_common(note)]
    for title, reasons in (("refused", told_reasons(result)), ("note", [*worth_knowing(result), *common])):
        if reasons:
            lines.append("")
        for reason in reasons:
            where = f" ({reason.where})" if reason.where else ""
            lines.append(f"{title}{where}: {sentence(reason.message)}")
    return "\n".join(lines)


def told_elements(result: Outcome) -> list[Element]:
    """The elements, but for those of a refusal of which nothing is said but its reasons."""
    said = {reason.message for reason in result.reasons} if result.status == Status.REFUSED else set()

    def tells(element: Element) -> bool:
        answers = [(p.plant, p.reason) for p in element.parameters] or [(None, element.reason)]
        return any(plant is not None or reason not in said for plant, reason in answers)

    return [element for element in result.elements if tells(element)]


def told_reasons(result: Outcome) -> list[Reason]:
    """The reasons that the headline does not say."""
    said = headline(result)

    def is_told(reason: Reason) -> bool:
        if reason.code is Code.NOT_IDENTIFIABLE and not reason.where:  # there is no answer: the headline begins so
            return True
        return reason.message in said and spoken(reason.where) in spoken(said)

    return [reason for reason in result.reasons if not is_told(reason)]


def worth_knowing(result: Outcome) -> list[Reason]:
    """The notes that are neither common to most records nor said of today's loops already, the causes first."""
    loops = loop_line(result)
    said = {
        Code.ROBUST_PERFORMANCE: "Robust performance does not hold" in loops,
        Code.DRAWN: "that the data leave open" in loops,
    }
    return [note for note in ranked(result.notes) if not is_common(note) and not said.get(note.code, False)]


def loop_line(result: Outcome) -> str:
    """Whether the change matters to today's loops, in a sentence or two; empty where no controller is declared."""
    found = result.robustness
    if found is None:
        return ""
    whose = "The controller as declared (OP was written by another)" if is_another(result) else "Today's controller"
    unstable = [spoken(loop.input) for loop in found.margins.plant if not loop.stable]
    if unstable:
        every = len(unstable) == len(found.margins.plant) > 1
        which = "the loops" if every else f"the loop of {' and '.join(unstable)}"
        return f"{whose} leaves {which} unstable on the plant as estimated."
    modelled = any(element.tf_model is not None for element in result.elements)
    if not is_answered(result):
        peak = _highest_peak(Margins(found.margins.model, found.margins.model), modelled=False)
        return f"{whose} keeps the model stable{peak}: what it does on the plant, these data do not say."
    text = f"{whose} keeps the plant stable{_highest_peak(found.margins, modelled)}."
    on_model, on_plant = found.peaks.get("model"), found.peaks.get("plant")
    if modelled and on_model and on_plant and on_model.RP and on_plant.RP:
        before, today = on_model.RP.upper, on_plant.RP.upper
        holds = "holds" if on_plant.robust_performance_holds else "does not hold"
        finite = math.isfinite(today)
        peak = f"mu peaks at {number(today)} ({number(before)} on the model)" if finite else "mu has no bound"
        text += f" Robust performance {holds}: {peak}."
    if found.drawn and found.drawn.share_stable < 1:
        unstable_share = 100 * (1 - found.drawn.share_stable)
        text += f" It is unstable on {number(unstable_share, 2)} % of the plants that the data leave open."
    return text


def _highest_peak(margins: Margins, modelled: bool) -> str:
    measured = [(loop.Ms, loop) for loop in margins.plant if loop.Ms is not None]
    if not measured:
        return ""
    peak, highest = max(measured, key=lambda one: one[0])
    before = next(loop for loop in margins.model if loop.input == highest.input)
    text = f"; the sensitivity peaks at Ms = {number(peak)} ({spoken(highest.input)}; usual is below 2"
    if not modelled:
        return f"{text})"
    return text + (f"; {number(before.Ms)} on the model)" if before.stable else "; unstable on the model)")


def settings_lines(result: Outcome) -> list[str]:
    """The settings to enter, a line a loop; one line where today's are to stay; nothing where none were asked for."""
    loops = result.controllers
    lines = []
    for loop in loops:
        if loop.chosen is None or loop.chosen.settings is None:
            continue
        now, new = faceplate_values(loop, loop.current), loop.chosen.settings
        changed = [
            f"{name} = {value} (now {now.get(name, 'none')})"
            for name, value in faceplate_values(loop, loop.chosen).items()
            if value != now.get(name, "none")
        ]
        said = ", ".join(changed) or "as today"
        if new.others:
            said += f", and from {', '.join(new.others)} as in the report"
        lines.append(f"recommended for {loop.input} ({loop.recommended}): {said}")
    if chosen := [loop for loop in loops if loop.chosen is not None]:
        lines += [f"for {loop.input}: {loop.reason}" for loop in loops if loop.recommended == KEEP]
        if chosen[0].reason:
            lines.append(f"  because it {sentence(chosen[0].reason)}")
    if loops and not lines:
        says = sentence(loops[0].reason or "see the report")
        kept = any(loop.recommended == KEEP for loop in loops)
        lines.append(f"{says[:1].upper()}{says[1:]}" if kept else f"no retuning is recommended: {says}")
    return lines


def html_summary(result: Outcome) -> str:
    """What a notebook shows."""
    rows = []
    for element in result.elements:
        cells = "<br>".join(html.escape(parameter_line(p)) for p in element.parameters)
        named = html.escape(f"{element.input} → {element.output}")
        said = html.escape(f"{element.verdict}, grade {element.grade}" if element.grade else element.verdict)
        rows.append(f"<tr><td>{named}</td><td>{said}</td><td style='text-align:left'>{cells}</td></tr>")
    told = (*result.reasons, *ranked(result.notes))
    notes = "".join(f"<li>{html.escape(sentence(r.message))}</li>" for r in told)
    head = "<tr><th>element</th><th>verdict</th><th>parameters</th></tr>"
    table = f"<table>{head}{''.join(rows)}</table>" if rows else ""
    return f"<p><b>{html.escape(headline(result))}</b></p>{table}{f'<ul>{notes}</ul>' if notes else ''}"
