"""Why settings are recommended, or none, in a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Outlook(Enum):
    """What became of the proposals for the loops of a project."""

    NO_ANSWER = "no method had an answer"
    NONE_HOLDS = "no proposal holds the limits for the share of plants asked for"
    KEEP = "today's settings hold them, and none that does is worth a change"
    CHANGE = "a proposal holds them"


@dataclass(frozen=True)
class Recommendation:
    """The outlook, the numbers that it rests on, and the method to use for all loops, if any."""

    outlook: Outlook
    Ms: float
    """Limit of Ms and Mt."""
    share: float
    """Of plants drawn anew that the chosen proposal (or today's, or the best) holds the limits for."""
    wanted: float
    """The share asked for."""
    method: str | None = None
    today: float | None = None
    """The share that today's settings hold them for; None where that cannot be told."""
    load_changes: tuple[float, ...] = ()
    """Relative change of a load step's absolute error, loop by loop; empty where today's loops are unstable."""
    louder: float | None = None
    """How many times as much noise moves OP, where that is worth saying."""
    notes: tuple[str, ...] = ()
    """What methods without an answer say."""


def recommendation_sentence(found: Recommendation) -> str:
    """Why the settings are recommended, or why none are."""
    named = f"Ms and Mt below {found.Ms:.3g} in all loops"
    if found.outlook is Outlook.NO_ANSWER:
        return f"no method had an answer: {'; '.join(found.notes)}"
    if found.outlook is Outlook.NONE_HOLDS:
        text = (
            f"no proposal holds {named} for {_percent(found.wanted)} of the plants that the record leaves possible "
            f"(the best one: {_percent(found.share)})"
        )
        return "; ".join([text, *found.notes])
    if found.outlook is Outlook.KEEP:
        return (
            f"today's settings hold {named} for {_percent(found.share)} of the plants that the record leaves "
            "possible, and no proposal that does brings the error of a load step down by a tenth: keep them"
        )
    text = f"holds {named} for {_percent(found.share)} of plants drawn anew from those that the record leaves possible"
    if found.today is not None:
        text += f" (today's settings: for {_percent(found.today)})"
    if not found.load_changes:
        return f"{text}; today's loops are not stable on the plant as estimated"
    told = ", ".join(f"{100 * change:+.0f} %" for change in found.load_changes)
    text += f"; the absolute error of a load step, loop by loop, changes by {told}"
    if found.louder is not None:
        text += f"; noise moves OP up to {found.louder:.2g} times as much as today: a PI would be calmer"
    return text


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
