"""The verdict of an analysis in a sentence or two."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trueplant.result import levels
from trueplant.result.element import Element, Parameter
from trueplant.result.numbers import counted, number, sentence, spoken
from trueplant.result.outcome import Outcome
from trueplant.result.parameter_words import change_of, kind_of, number_of, word_of
from trueplant.result.reason import Code
from trueplant.result.status import ElementVerdict, Status


def headline(result: Outcome) -> str:
    """The verdict first, in a sentence or two for the person at the panel."""
    if result.status == Status.REFUSED:
        return _refusal(result)
    first = [e for e in result.elements if e.verdict in (ElementVerdict.FOUND, ElementVerdict.NONE_FOUND)]
    changed = [e for e in result.elements if e.verdict == ElementVerdict.CHANGED]
    changed.sort(key=lambda element: (only_simpler(element), weight(element)))
    open_ones = [e for e in result.elements if e.verdict == ElementVerdict.NOT_IDENTIFIABLE]
    kept = len(result.elements) - len(changed) - len(open_ones) - len(first)
    if first and not changed and not kept:
        text = _first_model(first)
    elif changed:
        simpler = only_simpler(changed[0])
        text = f"{'The model is too simple' if simpler else 'The plant has changed'}: {_what_changed(changed[0])}."
        text += " That may be as old as the model." if simpler and len(changed) == 1 else ""
        if len(changed) > 1:
            text += f" {_also(changed[1:], simpler)}"
        if kept:
            text += f" {counted(kept, 'element')} with no change found."
    elif kept:
        whole = "any of the " if kept > 1 and not open_ones else ""
        where = f"{whole}{counted(kept, 'element')}" if kept > 1 or open_ones else _arrow(result.elements[0])
        unchanged = [e for e in result.elements if e.verdict == ElementVerdict.UNCHANGED]
        text = f"No change was found in {where}{_would_be_seen(unchanged)}."
        settings = result.provenance.settings
        tolerance, level = settings.tolerance_percent, 1 - settings.confidence
        p_values = [p.p_adjusted for e in result.elements for p in e.parameters if p.p_adjusted is not None]
        if tolerance and min(p_values, default=1.0) < level:
            text += f" Differences beyond chance are there, but none above the tolerance of {tolerance:g} %."
    elif tested := [e for e in open_ones if e.p_adjusted is not None]:
        text = f"No change was found in {_named(tested)}, but these data say too little: {_missed(tested)}."
    else:
        text = "No verdict is possible: none of the elements can be told from these data."
    if first and (changed or kept):
        text += f" {_first_model(first)}"
    if open_ones and (changed or kept or first):
        text += _left_open(open_ones)
    if has_moved(result):
        text += " No one plant suits the whole record, so that these values lie between several: see the notes."
    return text


def _left_open(elements: Sequence[Element]) -> str:
    """The elements without a verdict: those in which a change could have been missed, and those that say nothing."""
    tested = [e for e in elements if e.p_adjusted is not None]
    blind = [e for e in elements if e.p_adjusted is None]
    text = ""
    for some, begin, said in (
        (tested, "In ", f" no change was found, but {_missed(tested)}" if tested else ""),
        (blind, "", " could not be judged"),
    ):
        if some:
            more = f" and {len(some) - 3} more" if len(some) > 3 else ""
            text += f" {begin}{counted(len(some), 'element')}{said} ({', '.join(map(_arrow, some[:3]))}{more})."
    return text


def _refusal(result: Outcome) -> str:
    """Why there is no answer: what is said of one place where the first reason says no more than that there is none."""
    if not result.reasons:
        return "No answer can be given: the data do not say enough."
    first, *others = result.reasons
    if first.code is Code.NOT_IDENTIFIABLE and not first.where and others:
        first, *others = others
    places = first.where.split("; ") if first.code is Code.NOT_IDENTIFIABLE and first.where else []
    where = f"{spoken(places[0])}: " if len(places) == 1 else f"{counted(len(places), 'parameter')}: " if places else ""
    rest = f" ({counted(len(others), 'more reason')} in the result)" if others else ""
    return f"No answer can be given: {where}{sentence(first.message)}{rest}"


def _first_model(elements: Sequence[Element]) -> str:
    """What was found where nobody said anything, the elements of the loops first."""
    found = [e for e in elements if e.verdict == ElementVerdict.FOUND]
    if not found:
        return "No first model: nothing in these data shows beyond chance what answers to what."
    told = [f"{_arrow(e)} has {_values(e)}" for e in found[: levels.SHOWN_FIRST]]
    more = f" and {len(found) - levels.SHOWN_FIRST} more" if len(found) > levels.SHOWN_FIRST else ""
    some = f", {len(found)} of {len(elements)} elements" if len(elements) > 1 else ""
    return f"First model found{some}: {'; '.join(told)}{more}."


def _values(element: Element) -> str:
    known = [p for p in element.parameters if p.plant is not None]
    return ", ".join(f"{_phrase(p, known)} {_told(p)}" for p in known)


def _named(elements: Sequence[Element]) -> str:
    return _arrow(elements[0]) if len(elements) == 1 else counted(len(elements), "element")


def _missed(elements: Sequence[Element]) -> str:
    """How large a change could have been missed."""
    shares = {math.inf if e.detectable_change is None else e.detectable_change: e.detectable_of for e in elements}
    if not math.isfinite(share := max(shares)):
        return "any could have been missed"
    return f"one {change_of(shares[share], f'{number(100 * share, 2)} %')} could have been missed"


def _would_be_seen(elements: Sequence[Element]) -> str:
    """How large a change would have been found."""
    shares = [e.detectable_change for e in elements if e.detectable_change is not None and not is_lacking(e)]
    if not shares or not math.isfinite(max(shares)):
        return ""
    return f"; one of gain, lag or dead time by more than {number(100 * max(shares), 2)} % would have been seen"


def weight(element: Element) -> tuple[bool, float, float]:
    """To sort by: what answers the other way first, then what matters most to the loops."""
    importance = element.importance.value
    size = importance if importance is not None and math.isfinite(importance) else 0.0
    return not is_reversed(element), -size, element.p_adjusted or 0.0


def is_reversed(element: Element) -> bool:
    """Does the output of a changed element for certain answer in the opposite direction to its model?"""
    nets = [one for one in element.derived if one.name in ("net_gain", "net_slope") and one.model and one.ci]
    beyond = any(max(end * (one.model or 0.0) for end in one.ci or ()) < 0 for one in nets)
    return element.verdict == ElementVerdict.CHANGED and beyond


def _arrow(element: Element) -> str:
    return f"{spoken(element.input)} -> {spoken(element.output)}"


def _what_changed(element: Element) -> str:
    moved = [p for p in element.parameters if p.changed and p.plant is not None]
    where = _arrow(element)
    if is_lacking(element):
        known = [p for p in element.parameters if p.plant is not None]
        values = ", ".join(f"{_phrase(p, known)} of {_quantity(p.plant, p.unit)}" for p in known)
        return f"{where} responds with {values}, where the model has no response" if values else f"{where} responds"
    if not moved:
        if element.rejected_structure is not None:
            return f"{where} does not have its model's structure {element.rejected_structure}: {element.structure} fits"
        return f"{where} differs from the model as a whole, though no single parameter does for certain"
    clauses = []
    for parameter in moved:
        clause = f"{_phrase(parameter, element.parameters)} {_told(parameter)}"
        if parameter.model is not None:
            clause += f", not {_quantity(parameter.model, parameter.unit)}"
            if is_useful(parameter) and _is_number(parameter.change_percent):
                clause += f" ({parameter.change_percent:+.0f} %)"
        clauses.append(clause)
    way = " in the opposite direction to the model," if is_reversed(element) else ""
    return f"{where} responds{way} with {_listed(clauses)}"


def _listed(clauses: Sequence[str]) -> str:
    return clauses[0] if len(clauses) == 1 else f"{'; '.join(clauses[:-1])}; and {clauses[-1]}"


def only_simpler(element: Element) -> bool:
    """Is all that is known of its change that the model's structure does not suffice, as it perhaps never has?"""
    moved = any(p.changed and p.plant is not None for p in element.parameters)
    return not moved and element.rejected_structure is not None and not is_lacking(element)


def is_lacking(element: Element) -> bool:
    """Does the model have no such element?"""
    return element.tf_model in ("0", "0.0", "")


def seen(element: Element) -> str:
    """How large a change of an unchanged element would have been found; empty where nothing is known of that."""
    share = element.detectable_change
    if element.verdict == ElementVerdict.NOT_IDENTIFIABLE and element.p_adjusted is not None:
        return f" (no change was found, but {_missed([element])})"
    if element.verdict != ElementVerdict.UNCHANGED or share is None:
        return ""
    size = f"{number(100 * share, 2)} %"
    if is_lacking(element):
        return f" (an answer of {size} of all that PV does would have been seen)"
    return f" (a change of gain, lag or dead time by {size} would have been seen)"


def _also(elements: Sequence[Element], simpler: bool) -> str:
    if simpler:
        where = counted(len(elements), "other element") if len(elements) > 3 else ", ".join(map(_arrow, elements))
        does, own = ("does", "its own") if len(elements) == 1 else ("do", "their own")
        return f"Nor {does} {where} have {own}. All of that may be as old as the model."
    named = [f"{_arrow(e)} ({_short(e)})" for e in elements[:3]]
    rest = f" and {len(elements) - 3} more" if len(elements) > 3 else ""
    return f"Changed too: {', '.join(named)}{rest}."


def _short(element: Element) -> str:
    if is_lacking(element):
        return "not in the model"
    parts = []
    for p in element.parameters:
        if p.changed and p.plant is not None:
            told = is_useful(p) and _is_number(p.change_percent)
            size = f"{p.change_percent:+.0f} %" if told else _told(p)
            parts.append(f"{p.name.replace('_', ' ')} {size}")
    return ", ".join(parts) or ("as a whole" if element.rejected_structure is None else "another structure")


def _phrase(parameter: Parameter, parameters: Sequence[Parameter]) -> str:
    alike = [p for p in parameters if kind_of(p.name) == kind_of(parameter.name)]
    ordinal = {"": "first", "1": "first", "2": "second", "3": "third"}.get(number_of(parameter.name))
    return f"a {ordinal} {word_of(parameter.name)}" if len(alike) > 1 and ordinal else f"a {word_of(parameter.name)}"


def _is_number(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def is_another(result: Outcome) -> bool:
    """Was OP of today's loop written by another controller than was declared?"""
    today = result.robustness.controller_of if result.robustness else None
    return any(one.experiment == today and one.confirmed is False for one in result.methods.controller_consistency)


def has_moved(result: Outcome) -> bool:
    """Was the plant not the same throughout the record?"""
    return any(note.code is Code.CAUSE_MOVED_MEANWHILE for note in result.notes)


def is_answered(result: Outcome) -> bool:
    """Do the data tell any parameter of the plant?"""
    return any(parameter.plant is not None for element in result.elements for parameter in element.parameters)


def is_useful(parameter: Parameter) -> bool:
    """Is a value known so well that it may stand without its interval?"""
    size = max(abs(parameter.plant or 0.0), abs(parameter.model or 0.0))
    return parameter.ci is None or (parameter.ci[1] - parameter.ci[0]) / 2 <= levels.USEFUL * size


def _told(parameter: Parameter) -> str:
    """The value, or the interval where the value alone would mislead."""
    if is_useful(parameter) or parameter.ci is None:
        return f"of {_quantity(parameter.plant, parameter.unit)}"
    low, high = parameter.ci
    if not math.isfinite(low):
        return f"below {_quantity(high, parameter.unit)}"
    if not math.isfinite(high):
        return f"above {_quantity(low, parameter.unit)}"
    return f"between {number(low)} and {_quantity(high, parameter.unit)}"


def _quantity(value: float | None, unit: str) -> str:
    return f"{number(value)} {unit}".rstrip()
