"""What becomes of a question: answered or refused, and what is said of an element."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """What became of an analysis, a check, a record's track or one window of it."""

    OK = "ok"
    """It has an answer."""
    REFUSED = "refused"
    """It has none, for the reasons beside it."""


class ElementVerdict(StrEnum):
    """What the data say of one element beside the model."""

    UNCHANGED = "unchanged"
    """It was tested, and no change was found."""
    CHANGED = "changed"
    """It is not what the model says."""
    FOUND = "found"
    """Nobody said whether it is there, and the data show it."""
    NONE_FOUND = "none found"
    """Nobody said whether it is there, and the data do not show it."""
    NOT_IDENTIFIABLE = "not identifiable"
    """The data cannot say, for the reason beside it."""
