"""A plan of moves in words."""

from __future__ import annotations

from trueplant.result.numbers import duration, number, spoken
from trueplant.result.parameter_words import kind_of, word_of
from trueplant.result.plans import MoreData


def plan_sentence(unit: str, plan: MoreData) -> str:
    """What to move, for how long, and what the worst known parameter would then be known to; `unit` is that of time."""
    assert plan.length is not None  # a plan with moves has one
    closed = plan.moves[0].signal != "OP"
    parts = [
        f"{'the set-point' if closed else 'OP'} of {spoken(m.name)} by ±{_plain(m.size)}"
        f"{' ' + m.unit if m.unit else ''} every {_plain(m.every)} {unit}"
        for m in plan.moves
    ]
    worst = max(plan.settles, key=lambda s: (s.now is None, (s.now or 0.0) / s.wanted))
    known = f"±{number(worst.then, 2)}{' ' + worst.unit if worst.unit else ''}"
    text = f"move {' and '.join(parts)} for {duration(plan.length, unit)}: "
    name = word_of(worst.parameter) if kind_of(worst.parameter) == "tau" else spoken(worst.parameter)
    element = f"{spoken(worst.input)} -> {spoken(worst.output)}"
    text += f"the {name} of {element} would then be known to {known}"
    if worst.now is not None:
        text += f" (now ±{number(worst.now, 2)})"
    others = len(plan.settles) - 1
    if plan.suffices and others:
        text += f", and {others} other open parameter{'s' if others > 1 else ''} well enough too"
    if not plan.suffices:
        text += ". That is still not what is asked for, but longer or larger moves were not looked at"
    if plan.limited_by:
        text += f" ({plan.limited_by} limits the size)"
    if not closed:
        text += ". With the loop in manual; declare the controller to have set-point moves planned instead"
    return text


def _plain(value: float) -> str:
    return f"{value:.6g}"
