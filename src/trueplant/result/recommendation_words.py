"""Why settings are recommended, or none, in a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from trueplant.result.controllers import BeforeAfter, TradeOff
from trueplant.result.trade_off import shown, trade_off_words


class Outlook(Enum):
    """What became of the proposals for the loops of a project."""

    NO_ANSWER = "no method had an answer"
    NONE_HOLDS = "no proposal holds the limits for the share of plants asked for"
    NO_BETTER = "those that hold the limits have a larger mu than today's settings"
    KEEP = "today's settings hold them, and none that does is worth a change"
    KEEP_UNCHANGED = "the plant is as it was, today's margins are sound, and nothing is worth a change"
    LESS_MU = "none holds the limits, and one has a smaller mu than today's settings"
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
    changes: tuple[TradeOff, ...] = ()
    """Loop by loop; empty where nothing changes or today's loops are unstable."""
    mu: float | None = None
    """Limit of mu; None where none is asked for."""
    time_unit: str = ""
    with_elements: BeforeAfter | None = None
    """mu with the declared errors of the elements beside wI; None where there are not both."""
    notes: tuple[str, ...] = ()
    """What methods without an answer say."""


def recommendation_sentence(found: Recommendation) -> str:
    """Why the settings are recommended, or why none are."""
    named = f"Ms and Mt below {found.Ms:.3g} in all loops"
    if found.mu is not None:
        named += f", and mu of robust performance below {found.mu:.3g},"
    likely = "of the plants that the record leaves possible"
    if found.outlook is Outlook.NO_ANSWER:
        return f"no method had an answer: {'; '.join(found.notes)}"
    if found.outlook is Outlook.NONE_HOLDS:
        text = (
            f"no proposal holds {named} for {_percent(found.wanted)} {likely} (the best one: {_percent(found.share)})"
        )
        return "; ".join([text, *found.notes])
    if found.outlook is Outlook.NO_BETTER:
        return f"each proposal that holds {named} for {_percent(found.wanted)} {likely} has a larger mu than today's"
    no_more = "" if found.mu is None else " with no larger mu than theirs"
    unpaid = "brings the error of a load step down by a tenth in one loop without raising it by as much in another"
    if found.outlook is Outlook.KEEP:
        text = f"today's settings hold {named} for {_percent(found.share)} {likely}"
        return f"{text}, and no proposal that does{no_more} {unpaid}: keep them"
    if found.outlook is Outlook.KEEP_UNCHANGED:
        text = "the plant is not found changed and the margins of today's settings are sound"
        text += (
            f", and no proposal that holds {named}{no_more} {unpaid} or paying for it in overshoot, settling or margin"
        )
        return f"{text}: keep them"
    if found.outlook is Outlook.LESS_MU:
        text = f"lowers mu, though no proposal holds {named} for {_percent(found.wanted)} {likely}"
        return f"{text} (this one: {_percent(found.share)}); {_changes(found)}"
    text = f"holds {named} for {_percent(found.share)} of plants drawn anew from those that the record leaves possible"
    if found.today is not None:
        text += f" (today's settings: for {_percent(found.today)})"
    return f"{text}; {_changes(found)}"


def _changes(found: Recommendation) -> str:
    if not found.changes:
        return "today's loops are not stable on the plant as estimated"
    several = len(found.changes) > 1
    said = [f"{change.input}: " * several + trade_off_words(change, found.time_unit) for change in found.changes]
    if found.with_elements is not None:
        said.append(f"with the errors of the elements mu {shown(found.with_elements)}")
    return "; ".join(said)


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
