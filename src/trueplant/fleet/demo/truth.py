"""What the loops of the demo site are, and what is wrong with each of them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

Matrix = tuple[tuple[float, ...], ...]


class Fault(StrEnum):
    """What is wrong with a loop, beside what is not."""

    NONE = "none"
    COMPRESSED = "none, stored compressed"
    BAD = "none, bad quality at times"
    STILL = "none, never moved"
    STEP = "gain or lag stepped before the window"
    DRIFT = "gain drifts"
    STICKING = "valve sticks"
    RETUNED = "controller retuned"
    MANUAL = "in manual"


WITHOUT = (Fault.NONE, Fault.COMPRESSED, Fault.BAD, Fault.STILL)
"""Loops with nothing wrong in plant, valve and controller: a finding there is a false alarm."""
FINDABLE = (Fault.STEP, Fault.DRIFT, Fault.STICKING, Fault.RETUNED)
"""Faults that an audit should find; of a loop that is still or in manual it should say that it cannot."""


@dataclass(frozen=True)
class Kind:
    """A kind of loop: the model that its engineers have, and its controllers; times in minutes.

    A real flow loop is faster: at these sample times it would not be seen.
    """

    name: str
    prefix: str
    sample_time: float
    gain: Matrix
    """Of an integrating element its slope."""
    lag: Matrix
    """0: it integrates."""
    dead_time: Matrix
    Kc: tuple[float, ...]
    Ti: tuple[float, ...]
    move: tuple[float, ...]
    """Size of usual set-point moves."""
    noise: float
    """Standard deviation of the measurement's noise, as a share of a move."""
    wander: float
    """The same of the disturbance."""
    slave: float = 0.0
    """Lag of a slave loop; 0: none."""
    unit: str = "%"


KINDS = (
    Kind("flow", "FC", 0.5, ((1.5,),), ((1.5,),), ((0.5,),), (0.5,), (1.5,), (5.0,), 0.03, 0.10, unit="m3/h"),
    Kind("pressure", "PC", 0.5, ((-0.08,),), ((4.0,),), ((1.0,),), (-15.0,), (4.0,), (0.4,), 0.02, 0.08, unit="bar"),
    Kind("level", "LC", 1.0, ((0.06,),), ((0.0,),), ((2.0,),), (3.0,), (20.0,), (4.0,), 0.03, 0.08),
    Kind("temperature", "TC", 1.0, ((1.6,),), ((18.0,),), ((4.0,),), (1.2,), (18.0,), (3.0,), 0.02, 0.06, unit="degC"),
    Kind(
        "column",
        "QC",
        1.0,
        ((12.8, -18.9), (6.6, -19.4)),
        ((16.7, 21.0), (10.9, 14.4)),
        ((1.0, 3.0), (7.0, 3.0)),
        (0.2, -0.04),
        (10.0, 20.0),
        (1.0, 1.0),
        0.02,
        0.04,
    ),
    Kind("cascade", "TCC", 1.0, ((2.2,),), ((12.0,),), ((3.0,),), (0.7,), (12.0,), (3.0,), 0.02, 0.06, 1.5, "degC"),
)
"""The column is that of Wood and Berry (1973), Chem. Eng. Sci. 28, with gentler controllers."""

LAST = {
    "flow": Fault.STILL,
    "pressure": Fault.MANUAL,
    "level": Fault.STEP,
    "temperature": Fault.STILL,
    "column": Fault.DRIFT,
    "cascade": Fault.MANUAL,
}
"""The tenth loop of each kind."""


@dataclass(frozen=True)
class Truth:
    """One loop of the demo site."""

    name: str
    kind: Kind
    fault: Fault
    seed: int


def loops(per_kind: int = 10) -> list[Truth]:
    """The loops of the site; with fewer than ten of a kind the last ones, so that every fault is there."""
    found = []
    for k, kind in enumerate(KINDS):
        step = Fault.STEP if k % 2 == 0 else Fault.DRIFT
        # a slave loop hides what its valve does: a stepped lag stands there instead
        sticking = Fault.STEP if kind.slave else Fault.STICKING
        faults = [*[Fault.NONE] * 4, Fault.COMPRESSED, Fault.BAD, step, sticking, Fault.RETUNED, LAST[kind.name]]
        own = list(enumerate(faults, 1))[-per_kind:]
        found += [Truth(f"{kind.prefix}{100 * (k + 1) + n}", kind, fault, 1000 * k + n) for n, fault in own]
    return found
