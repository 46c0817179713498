"""Why something was refused or limited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Code(StrEnum):
    """What a `Reason` is about; other programs match these, and sentences may change."""

    meaning: str

    def __new__(cls, value: str, meaning: str) -> Code:
        member = str.__new__(cls, value)
        member._value_ = value
        member.meaning = meaning
        return member

    RECORD = "record", "a record cannot be used"
    NO_DATA = "no-data", "no usable data are left after screening"
    NO_EXCITATION = "no-excitation", "nothing moves the plant from outside, or not enough"
    TOO_LARGE = "too-large", "to estimate so many elements from so many samples would take hours"
    NOTHING_TO_ESTIMATE = "nothing-to-estimate", "no output has both an element to estimate and usable data"
    NOT_IDENTIFIABLE = "not-identifiable", "a parameter cannot be told from these data"
    REFUTED = "refuted", "the record speaks against the estimate of an output, which is not given"
    NO_POWER = "no-power", "an element was tested, and a change worth knowing could have been missed"
    NO_WINDOW = "no-window", "no stretch of a long record can be estimated"
    PILOT = "pilot", "the first estimate of a long record answers nothing"
    UNSTABLE_MODEL = "unstable-model", "the declared loop is unstable on the model"
    MISSING_ELEMENT = "missing-element", "an element that the model lacks was found"
    LOAD = "load-step", "something that nobody recorded stepped like an input"
    SPIKES = "spikes", "a PV was off for a moment, as no disturbance would be"
    SWAPPED = "swapped", "two columns look as if each stood in the other's place"
    TIME_UNIT = "time-unit", "the model's times look as if they were in another unit"
    SETPOINT_COMPUTED = "setpoint-computed", "a set-point follows PV and moves nothing from outside"
    SETPOINT_STILL = "setpoint-still", "a set-point never moves"
    SETPOINT_RANK = "setpoint-rank", "the set-points move in the same proportion"
    MANUAL = "manual", "a loop was in manual in a record of closed loops, or looks so"
    COMPRESSED = "compressed", "a historian stored only part of a signal"
    REPEATED_TIMES = "repeated-times", "many rows bear the time of the row before, as if the times had been cut"
    CONTROLLER = "controller", "a declared controller does not reproduce OP"
    SCAN = "scan", "OP was written between the recorded samples"
    HOLD = "hold", "how a measured disturbance runs between its samples"
    SHARED_DISTURBANCE = "crossed", "a disturbance reaches several outputs"
    UNEVEN_NOISE = "uneven-noise", "the noise is not of one size and colour"
    RUNS_DISAGREE = "runs-disagree", "the experiments disagree"
    ONE_EXPERIMENT = "one-experiment", "the spread between runs is not known"
    MODEL_CONVERTED = "model-converted", "the model was given as coefficients, and a transfer function stands for it"
    MODEL_STEP = "model-step", "how the model's own step response lies against the plant's band"
    STRUCTURE = "structure", "an element has another structure than its model"
    UNDERMODELLED = "undermodelled", "the structure is simpler than the plant"
    OUTSIDE_BAND = "outside-band", "the plant lies outside of the band of the estimate without a structure"
    MISMATCH_OR_DISTURBANCE = "mismatch-or-disturbance", "mismatch and disturbance cannot be told apart"
    DISTURBANCE_MODEL = "disturbance-model", "a declared disturbance does not describe the record"
    CASCADE = "cascade", "what a slave loop does"
    METHODS = "methods", "a method and the fit disagree"
    MARGINS = "margins", "a loop is unstable or has little margin on the plant"
    ROBUST_PERFORMANCE = "robust-performance", "the performance asked for does not hold on the plant"
    PAIRING = "pairing", "a relative gain is negative"
    DRAWN = "drawn", "plants that the data leave open are unstable"
    TUNING = "tuning", "nothing, or not all, can be retuned"
    MORE_DATA = "more-data", "moves that would settle what is open"
    SAME_DATA = "same-data", "two results rest on the same data"
    SAME_HOURS = "same-hours", "two results rest on different data with the same time stamps"
    ONLY_IN_ONE = "only-in-one", "an element is in one of two results"
    NOTHING_COMMON = "nothing-common", "two results answer no parameter in common"
    CAUSE_PLANT = "cause-plant", "the plant itself"
    CAUSE_SENSOR_SPAN = "cause-sensor-span", "a sensor's span"
    CAUSE_ACTUATOR_GAIN = "cause-actuator-gain", "a valve or actuator"
    CAUSE_VALVE_STICKING = "cause-valve-sticking", "a valve that sticks"
    CAUSE_VALVE_END = "cause-valve-end", "a valve that ends before OP does"
    CAUSE_VALVE_SATURATED = "cause-valve-saturated", "an actuator at its limit"
    CAUSE_OPERATING_POINT = "cause-operating-point", "a sensor's bias, or a load that came to stay"
    CAUSE_DISTURBANCE = "cause-disturbance", "the disturbance, not the plant"
    CAUSE_MOVED_MEANWHILE = "cause-moved-meanwhile", "the plant was not the same throughout the record"
    CAUSE_UNKNOWN = "cause-unknown", "the data cannot say which"


@dataclass(frozen=True)
class Reason:
    """Why something was refused or limited."""

    code: Code
    message: str
    where: str = ""


_COMMON = frozenset({Code.ONE_EXPERIMENT, Code.HOLD, Code.MODEL_STEP})
"""What holds for most records, and asks for nothing."""


def ranked(notes: Sequence[Reason]) -> list[Reason]:
    """Mistakes in the project and causes first, what holds for most records last, each else in the order given.

    A limit that OP stood at does the estimate no harm, and is not why the plant is another.
    """

    def rank(note: Reason) -> int:
        if note.code in _COMMON:
            return 2
        told = note.code in (Code.SWAPPED, Code.TIME_UNIT) or note.code.startswith("cause-")
        told &= note.code not in (Code.CAUSE_UNKNOWN, Code.CAUSE_VALVE_SATURATED)
        return 0 if told else 1

    return sorted(notes, key=rank)


def is_common(note: Reason) -> bool:
    """Does it hold for most records, and ask for nothing?"""
    return note.code in _COMMON
