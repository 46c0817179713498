"""Why the data do not determine a parameter."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class WhyUnanswered(Enum):
    """The causes; each value says in words what it means."""

    INPUT_STANDS_STILL = "its input does not move in these data"
    FASTER_THAN_RECORD = (
        "what happens between samples is not in the record, and time constant and dead time cannot be told apart"
    )
    DEPENDS_ON_NOISE_MODEL = "it depends on the noise model"
    GAIN_NOT_TOLD_FROM_ZERO = "the gain of this element cannot be told from zero, so it has no dynamics to measure"
    TOO_UNCERTAIN = "its standard error is more than half of its size: the data say too little about it"
    CONTROLLER_FASTER_THAN_RECORD = (
        "the controller scans faster than the record, and its derivative action answers noise between the samples: "
        "export the record at the controller's scan"
    )
    CONTROLLER_SCAN_UNDECLARED = (
        "no controller that scans as the record does can have written OP, and derivative action answers noise between "
        "the samples: declare the controller's scan (sample_time), or export the record faster"
    )
    MODEL_PREDICTS_BETTER = "the model predicts the record better than this estimate does"
    NOTHING_FROM_OUTSIDE = (
        "no set-point or measured disturbance that moves shows in its input or its output: what ties the two together "
        "may be the controller that answers PV, and not the plant"
    )
    LOOP_SETTLED = "today's loop settled in the record, and would be unstable on this estimate"

    @property
    def more_data_helps(self) -> bool:
        """Would a longer record with larger moves, sampled as this one, determine the parameter?"""
        return self in (
            WhyUnanswered.INPUT_STANDS_STILL,
            WhyUnanswered.NOTHING_FROM_OUTSIDE,
            WhyUnanswered.GAIN_NOT_TOLD_FROM_ZERO,
            WhyUnanswered.TOO_UNCERTAIN,
        )


@dataclass(frozen=True)
class Unanswered:
    """A parameter that the data do not determine."""

    why: WhyUnanswered
    text: str
    """The reason in plain words, with the numbers that belong to it."""

    @classmethod
    def because(cls, why: WhyUnanswered) -> Unanswered:
        """Without numbers of its own."""
        return cls(why, why.value)
