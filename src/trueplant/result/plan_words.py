"""A plan of moves in words."""

from __future__ import annotations

from collections.abc import Sequence

from trueplant.calendar import duration
from trueplant.result import levels
from trueplant.result.numbers import counted, number, spoken
from trueplant.result.parameter_words import kind_of, word_of
from trueplant.result.plans import MoreData, NotWorth


def plan_sentence(unit: str, plan: MoreData) -> str:
    """What to move, for how long, and what the worst known parameter would then be known to; `unit` is that of time."""
    assert plan.length is not None  # a plan with moves has one
    closed = plan.moves[0].signal != "OP"
    parts = [
        f"{'the set-point' if closed else 'OP'} of {spoken(m.name)} by ±{_plain(m.size)}"
        f"{' ' + m.unit if m.unit else ''} every {_plain(m.every)} {unit}"
        for m in plan.moves
    ]
    waited = [one for one in plan.settles if one.matters]
    # of what the first of two tests hardly touches nothing is foretold
    told = [one for one in waited if one.now is None or one.then < levels.TOLD * one.now] or waited
    worst = max(told, key=lambda s: (s.now is None, (s.now or 0.0) / s.wanted))
    known = f"±{number(worst.then, 2)}{' ' + worst.unit if worst.unit else ''}"
    there = "where they were" if len(parts) > 1 else "where it was"
    text = f"move {' and '.join(parts)} for {duration(plan.length, unit)}, then back to {there}: "
    name = word_of(worst.parameter) if kind_of(worst.parameter) == "tau" else spoken(worst.parameter)
    element = f"{spoken(worst.input)} -> {spoken(worst.output)}"
    text += f"the {name} of {element} would then be known to {known}"
    if worst.now is not None:
        beside = ", with times as in the model, as the record does not tell them" if worst.as_modelled else ""
        text += f" (now ±{number(worst.now, 2)}{beside})"
    others = len(told) - 1
    if others:
        text += f", and {counted(others, 'other open parameter')} better too"
    if plan.suffices:
        text += ", which is enough for these loops" if closed else ", which is enough"
        text += f", though grade A takes ±{number(worst.wanted, 2)}" if worst.then > worst.wanted else ""
    if plan.limited_by:
        text += f" ({_signal(plan.limited_by)} limits the size)"
    if plan.first_of_two:
        text += ". It is the first of two tests: too little is known yet to plan larger moves, so analyse both records "
        text += "together afterwards, and the second test is planned on what they show"
    if plan.assumed_limits:
        text += f". No limits are declared for {_listed(plan.assumed_limits)}: the range that the records show, and as "
        text += "much to each side, counts as allowed. Declare limits to have more or less"
    if not closed:
        text += ". With the loop in manual; declare the controller to have set-point moves planned instead"
    return text


def not_worth_sentence(unit: str, plan: MoreData) -> str:
    """Why there is no test to be made, and what to do instead; `unit` is that of time."""
    assert plan.longest is not None  # said with every plan that was looked for
    if plan.not_worth is NotWorth.MATTERS_LITTLE:
        return "no test is needed: what is still open of the plant as estimated makes little difference to the loops"
    if plan.not_worth is NotWorth.NO_LIMITS:
        return (
            "no test can be planned, because an OP that has not moved would have to, and nothing says how far it may: "
            "declare the limits of each OP"
        )
    if plan.not_worth is NotWorth.LIMITS_TOO_NEAR and plan.limited_by in plan.assumed_limits:
        return (
            f"no test can be planned, because no limits are declared for {_signal(plan.limited_by)}, and the range "
            "that the records show, with as much to each side, leaves no room for a move beside the disturbance: "
            "declare its limits"
        )
    if plan.not_worth is NotWorth.LIMITS_TOO_NEAR:
        return (
            f"no test can be planned, because {_signal(plan.limited_by)} is so near its limits, with what the "
            "disturbance does to it, that no move can be made: move it away from them first, or declare wider limits"
        )
    limited = f", as {_signal(plan.limited_by)} keeps the moves small" if plan.limited_by else ""
    records = "give more records together in which the set-points or OPs move, as far as operation allows"
    if plan.needs is None:
        return f"no length of a test would settle what is open{limited}: {records}"
    return (
        f"a test that settles what is open would take {duration(plan.needs, unit)}{limited}, and a test may take "
        f"{duration(plan.longest, unit)} (longest_test in [analysis]): allow a longer one, or {records}"
    )


def _signal(name: str) -> str:
    """ "PV of top_temperature" as one says it."""
    return spoken(name)


def _listed(names: Sequence[str]) -> str:
    *first, last = map(_signal, names)
    return f"{', '.join(first)} and {last}" if first else last


def _plain(value: float) -> str:
    return f"{value:.6g}"
