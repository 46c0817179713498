"""The verdict in a sentence for the panel: what the loop does now, whether its tuning is safe, and what to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum

from trueplant.result import levels
from trueplant.result.element import Element, Parameter
from trueplant.result.headline import has_moved, is_another, is_answered, is_lacking, is_reversed, is_useful, weight
from trueplant.result.numbers import counted, number, spoken
from trueplant.result.outcome import Outcome
from trueplant.result.parameter_words import kind_of
from trueplant.result.reason import Code
from trueplant.result.status import ElementVerdict, Status


class Action(StrEnum):
    """What is to be done about a loop."""

    NONE = "none"
    RETUNE = "retune"
    CHECK_VALVE = "check valve"
    GET_DATA = "get data"


def action(result: Outcome) -> Action:
    """What the result asks for first: a valve before tuning, tuning before more data."""
    if result.status == Status.REFUSED:
        return Action.GET_DATA
    if _sticking(result):
        return Action.CHECK_VALVE
    if is_another(result):
        return Action.GET_DATA  # on what is in the controller: all that is known of the loops is of another
    if _unsafe(result) or _misses(result) or any(loop.chosen for loop in result.controllers):
        return Action.RETUNE
    told = any(e.verdict in (ElementVerdict.CHANGED, ElementVerdict.FOUND) for e in result.elements)
    open_ones = any(e.verdict == ElementVerdict.NOT_IDENTIFIABLE for e in result.elements)
    return Action.GET_DATA if (open_ones and not told) or has_moved(result) else Action.NONE


def shift(result: Outcome) -> str:
    """One sentence for the shift, in parts that a semicolon divides."""
    parts = [_what(result), _tuning(result), _to_do(result)]
    text = "; ".join(part for part in parts if part)
    return f"{text[:1].upper()}{text[1:]}."


def _what(result: Outcome) -> str:
    """What the plant does now."""
    if result.status == Status.REFUSED:
        # that nothing can be told is no reason why
        why = next((reason.code.meaning for reason in result.reasons if reason.code is not Code.NOT_IDENTIFIABLE), "")
        return f"these data say nothing of the plant{f' ({why})' if why else ''}"
    by_verdict = {verdict: [e for e in result.elements if e.verdict == verdict] for verdict in ElementVerdict}
    if changed := sorted(by_verdict[ElementVerdict.CHANGED], key=weight):
        more = f", and {counted(len(changed) - 1, 'other answer')} changed too" if len(changed) > 1 else ""
        return f"{_answer(changed[0], _several_inputs(result))}{more}"
    if stuck := _sticking(result):
        one = len(stuck) == 1
        does = ("does" if one else "do") + " not follow OP" if _ended(result) else "sticks" if one else "stick"
        return f"{' and '.join(map(_valve, stuck))} {does}"
    if found := by_verdict[ElementVerdict.FOUND]:
        named = list(dict.fromkeys(spoken(e.output) for e in found))
        return f"a first model of {_and(named[: levels.SHOWN_FIRST])} was found"
    kept, open_ones = by_verdict[ElementVerdict.UNCHANGED], by_verdict[ElementVerdict.NOT_IDENTIFIABLE]
    if kept:
        named = list(dict.fromkeys(spoken(e.output) for e in kept))
        text = f"{_and(named)} {'answers' if len(named) == 1 else 'answer'} as the model says"
        return f"{text}, as far as these data tell" if open_ones else text
    return "these data say too little to tell whether the plant has changed"


def _answer(element: Element, several: bool) -> str:
    """How an output answers now, by the parameters that changed."""
    output = spoken(element.output)
    to = f" to {spoken(element.input)}" if several else ""
    if is_lacking(element):
        return f"{output} answers to {spoken(element.input)}, which the model does not have"
    if is_reversed(element):
        return f"{output} answers{to} in the opposite direction to what the model says"
    words = [(_size(p, element), _changed(p)) for p in element.parameters if p.changed]
    largest = max((size for size, word in words if word), default=0.0)
    said = [word for size, word in words if word and size >= levels.WORTH_SAYING * largest]
    if not said:
        return f"{output} does not answer{to} as the model says"
    return f"{output} answers {_and(said[:2])}{to} than the model says"


def _size(p: Parameter, element: Element) -> float:
    """Of a change, in percent; that of a dead time in percent of the model's dead time and lags, which may be 0."""
    if p.name != "dead_time" or p.plant is None or p.model is None:
        return abs(p.change_percent or 0.0)
    whole = sum(abs(one.model or 0.0) for one in element.parameters if kind_of(one.name) in ("tau", "dead_time"))
    return 100 * abs(p.plant - p.model) / whole if whole else 100.0


def _changed(p: Parameter) -> str:
    """Stronger, slower, later; empty for what has no plain word, or is not known well enough to be said."""
    if p.plant is None or p.model is None or not is_useful(p):
        return ""
    kind, size = kind_of(p.name), p.change_percent
    if kind in ("gain", "slope") and p.name == kind and size is not None and math.isfinite(size) and size > -100:
        return f"{abs(size):.0f} % {'stronger' if size > 0 else 'weaker'}"
    if p.name == "tau1" and size is not None and math.isfinite(size):
        return f"{abs(size):.0f} % {'slower' if size > 0 else 'faster'}"
    if p.name == "dead_time":
        return f"{number(abs(p.plant - p.model), 2)} {p.unit} {'later' if p.plant > p.model else 'earlier'}"
    return ""


def _tuning(result: Outcome) -> str:
    """Whether today's controllers stand it, or that nobody knows; empty where nothing has changed and none is known."""
    found = result.robustness
    if result.status == Status.REFUSED or not is_answered(result):
        return ""
    if found is None:
        return _unknown_tuning(result)
    if is_another(result):
        return "the controller is not the one that was declared: look up which settings are in it"
    unstable = [spoken(loop.input) for loop in found.margins.plant if not loop.stable]
    if unstable:
        return f"today's tuning of {_and(unstable)} is unstable on it"
    if _unsafe(result):
        return "today's tuning has little margin left on it"
    if _misses(result):
        return "today's tuning is stable but no longer does what is asked of it"
    still = "still " if _has_changed(result) else ""
    return f"today's tuning is {still}stable"


def _unknown_tuning(result: Outcome) -> str:
    if not _has_changed(result):
        return ""
    why = "" if result.methods.controller_consistency else ", as no controller is declared"
    return f"whether today's tuning suits that is not known{why}"


def _to_do(result: Outcome) -> str:
    """Empty where nothing can be said of it, because nobody knows what the loops do now."""
    does = action(result)
    if does is Action.CHECK_VALVE:
        return f"check {_and([_valve(name) for name in _sticking(result)])} first"
    if does is Action.RETUNE:
        chosen = [spoken(loop.input) for loop in result.controllers if loop.chosen]
        tune = f"enter the new settings of {_and(chosen)}" if chosen else "the controllers need new settings"
        # a loop that is not safe cannot wait for an instrument
        instruments = [] if _unsafe(result) else _suspects(result)
        if has_moved(result) and not _unsafe(result):
            return f"{_TRACK} first, then {tune}"
        return f"check {_and(instruments)} first: if that is in order, {tune}" if instruments else tune
    if does is Action.GET_DATA and is_another(result):
        return ""  # that its settings are what is missing is said of the tuning
    if does is Action.GET_DATA and has_moved(result):
        return _TRACK
    if does is Action.GET_DATA:
        simple = any(note.code is Code.UNDERMODELLED for note in result.notes)
        also = ", or try a richer structure of the model," if simple and result.status == Status.REFUSED else ""
        return f"get more data{also} before anything is changed"
    if result.robustness is None and _has_changed(result):
        return f"check {_and(_suspects(result))}" if _suspects(result) else ""
    return "no action now"


_TRACK = "find out what it does now, since it did not do the same throughout (trueplant track)"


def _valve(name: str) -> str:
    """An input that is called a valve needs no other word for it."""
    return f"the {spoken(name)}" if "valve" in name.lower() else f"the valve of {spoken(name)}"


def _suspects(result: Outcome) -> list[str]:
    """Instruments that may be all that has changed: settings for a wrong one are wrong once it is mended."""
    named = []
    for note in result.notes:
        for where in map(spoken, note.where.split("; ")):
            column, arrow, output = where.rpartition(" -> ")
            if note.code is Code.CAUSE_UNKNOWN and not arrow:  # of several, each as what it is
                is_valve = where.startswith("valve of ")
                named.append(_valve(where.removeprefix("valve of ")) if is_valve else f"the {where}")
                continue
            if note.code in (Code.CAUSE_SENSOR_SPAN, Code.CAUSE_UNKNOWN):
                named.append(f"the transmitter of {output}")
            if note.code in (Code.CAUSE_ACTUATOR_GAIN, Code.CAUSE_UNKNOWN):
                named.append(_valve(column or where))
    return list(dict.fromkeys(named))


def _has_changed(result: Outcome) -> bool:
    return any(e.verdict == ElementVerdict.CHANGED for e in result.elements)


def _unsafe(result: Outcome) -> bool:
    """Is a loop unstable or close to it, on the plant or on too many of those that the record leaves possible?"""
    found = result.robustness
    if found is None:
        return False
    shaky = found.drawn is not None and found.drawn.share_stable < levels.SAFE_SHARE
    return bool(found.worse) or shaky or any(not loop.stable for loop in found.margins.plant)


def _misses(result: Outcome) -> bool:
    """Does robust performance, which was asked for and held on the model, no longer hold on the plant?"""
    peaks = {} if result.robustness is None else result.robustness.peaks
    before, now = peaks.get("model"), peaks.get("plant")
    return bool(before and now and before.robust_performance_holds and now.robust_performance_holds is False)


def _sticking(result: Outcome) -> list[str]:
    """Inputs whose valves do not follow OP."""
    said = [note.where for note in result.notes if note.code in (Code.CAUSE_VALVE_STICKING, Code.CAUSE_VALVE_END)]
    return list(dict.fromkeys(where.split(" -> ")[0] for where in said if where))


def _ended(result: Outcome) -> bool:
    """Is there a valve that ends before OP does?"""
    return any(note.code is Code.CAUSE_VALVE_END for note in result.notes)


def _several_inputs(result: Outcome) -> bool:
    return len({e.input for e in result.elements}) > 1


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
