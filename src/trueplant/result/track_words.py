"""A track in words."""

from __future__ import annotations

from typing import Protocol

from trueplant.calendar import Calendar
from trueplant.result.changes import Change, ChangeKind, ElementHistory, Moved, TrackedElement, Window
from trueplant.result.element import Parameter
from trueplant.result.numbers import counted, number, percentage, spoken
from trueplant.result.reason import Reason
from trueplant.result.status import ElementVerdict, Status

AS_A_WHOLE = "as a whole, though no single parameter {} for certain"
"""Of an element whose parameters were tested together and then one by one."""


class Tracked(Protocol):
    """The parts of a `Track` that its words speak of."""

    @property
    def status(self) -> Status: ...
    @property
    def reasons(self) -> tuple[Reason, ...]: ...
    @property
    def calendar(self) -> Calendar: ...
    @property
    def elements(self) -> tuple[TrackedElement, ...]: ...
    @property
    def changes(self) -> tuple[Change, ...]: ...
    @property
    def windows(self) -> tuple[Window, ...]: ...


def headline(track: Tracked) -> str:
    """What changed and since when, in a sentence or two for the person at the panel."""
    if track.status == Status.REFUSED:
        why = track.reasons[0].message if track.reasons else "the data do not say enough"
        return f"Nothing can be followed: {why.rstrip('.')}."
    text = " ".join(change_sentence(change, track.calendar) for change in track.changes[:3])
    if len(track.changes) > 3:
        text += f" {len(track.changes) - 3} more changes were found."
    steady = [e for e in track.elements if e.history == ElementHistory.CONSTANT]
    unknown = [e for e in track.elements if e.history == ElementHistory.NOT_IDENTIFIABLE]
    if not track.changes and steady:
        whole = "any of the " if len(steady) > 1 and not unknown else ""
        count = f"{whole}{counted(len(steady), 'element')}"
        as_modelled = all(e.standing and e.standing.verdict == ElementVerdict.UNCHANGED for e in steady)
        text = f"No change over time was found in {count}{', and no difference from the model' if as_modelled else ''}."
    elif steady:
        text += f" {counted(len(steady), 'element')} without a change."
    text += "".join(f" {sentence}" for e in steady if (sentence := standing_sentence(e)))
    open_ = [e for e in steady if not e.standing or e.standing.verdict == ElementVerdict.NOT_IDENTIFIABLE]
    if open_:
        text += f" Whether the model holds cannot be told of {counted(len(open_), 'element')}."
    if unknown:
        text += f" {counted(len(unknown), 'element')} cannot be followed in this record."
    return text.strip()


def word_of(element: TrackedElement) -> str:
    """Its history in a word or two, with whether what is constant is off the model."""
    if element.history == ElementHistory.UNDECIDED:
        return "step or drift"
    return f"{element.history}, off the model" if standing_sentence(element) else element.history


def holds(track: Tracked) -> bool | None:
    """Does the model hold: nothing changed, and nothing is off it all the time? None where that is not known of all."""
    if track.changes or any(map(standing_sentence, track.elements)):
        return False
    known = all(e.standing and e.standing.verdict == ElementVerdict.UNCHANGED for e in track.elements)
    return True if known else None


def told_reasons(track: Tracked) -> list[Reason]:
    """The reasons that the headline does not say."""
    return [reason for reason in track.reasons if reason.message.rstrip(".") not in headline(track)]


def standing_sentence(element: TrackedElement) -> str:
    """Such as: reflux -> top is constant, but 29 % off the model: gain 16.5 (16.1 to 16.9), model 12.8.

    Empty unless the element is constant and off the model beyond chance.
    """
    standing = element.standing
    if element.history != ElementHistory.CONSTANT or not standing or standing.verdict != ElementVerdict.CHANGED:
        return ""
    where = f"{spoken(element.input)} -> {spoken(element.output)}"
    off = [p for p in standing.parameters if p.changed and p.plant is not None and p.model is not None and p.ci]
    if not off:
        return f"{where} is constant, but off the model {AS_A_WHOLE.format('is')}."
    worst = max(abs(p.change_percent or 0.0) for p in off)
    size = f"{worst:.0f} % off the model" if worst else "off the model"
    return f"{where} is constant, but {size}: {', '.join(map(off_words, off))}."


def off_words(p: Parameter) -> str:
    """Such as: gain 16.5 (16.1 to 16.9), model 12.8."""
    low, high = p.ci or (None, None)
    unit = f" {p.unit}" if p.unit else ""
    return f"{spoken(p.name)} {number(p.plant)} ({number(low)} to {number(high)}){unit}, model {number(p.model)}{unit}"


def change_sentence(change: Change, calendar: Calendar) -> str:
    """Such as: reflux -> top temperature changed in a step at 412 min (401 to 420 min): gain 3.2 -> 4.1 (+28 %)."""
    where = f"{spoken(change.input)} -> {spoken(change.output)}"
    moved = what_moved(change)
    span = calendar.span(*change.interval)
    if change.kind == ChangeKind.STEP:
        return f"{where} changed in a step at {calendar.text(change.time)} ({span}): {moved}."
    if change.kind == ChangeKind.DRIFT:
        return f"{where} drifted from {span}: {moved}."
    return f"{where} changed within {span}, in a step or little by little (not told apart): {moved}."


def what_moved(change: Change) -> str:
    """The parameters that changed; of an element that did, there may be none that did so for certain."""
    return ", ".join(moved_words(p) for p in change.parameters if p.changed) or AS_A_WHOLE.format("did")


def moved_words(p: Moved) -> str:
    percent = "" if p.change_percent is None else f" ({percentage(p.change_percent, 0)})"
    unit = f" {p.unit}" if p.unit else ""
    return f"{spoken(p.name)} {number(p.before)} -> {number(p.after)}{unit}{percent}"


def refused_stretches(track: Tracked) -> list[tuple[str, str, str, str]]:
    """(outputs, experiment, when, reason) of the refused windows: a line for what one reason refused in an experiment.

    When is said output by output where it differs.
    """
    refused: dict[tuple[str, str], dict[str, list[str]]] = {}
    places = {
        output: k
        for k, output in enumerate(
            dict.fromkeys([*(e.output for e in track.elements), *(w.output for w in track.windows)])
        )
    }
    windows = (w for w in track.windows if w.status == Status.REFUSED)
    for w in sorted(windows, key=lambda w: (w.experiment, places[w.output], w.start)):
        spans = refused.setdefault((w.experiment, w.reason), {})
        spans.setdefault(spoken(w.output), []).append(track.calendar.span(w.start, w.end))
    lines = []
    for (experiment, reason), by_output in refused.items():
        whens = {name: ", ".join(spans) for name, spans in by_output.items()}
        alike = len(set(whens.values())) == 1
        when = next(iter(whens.values())) if alike else "; ".join(f"{name} {spans}" for name, spans in whens.items())
        lines.append((", ".join(whens), experiment, when, reason))
    return lines
