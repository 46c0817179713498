"""What today's controller does on the model, on the plant, and on the plants that the data leave open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueplant.result.codec import ABSENT


@dataclass(frozen=True)
class LoopMargins:
    """Margins of one loop, the others closed; None is no limit, or an unstable loop."""

    input: str
    stable: bool
    gain_margin: float | None = None
    phase_margin: float | None = None
    """Degrees."""
    delay_margin: float | None = None
    Ms: float | None = None
    Mt: float | None = None
    message: str = field(default="", metadata=ABSENT)
    """Why there are none."""


@dataclass(frozen=True)
class Margins:
    """Loop by loop, on the model and on the plant as estimated."""

    model: tuple[LoopMargins, ...]
    plant: tuple[LoopMargins, ...]


@dataclass(frozen=True)
class Peak:
    """Bounds of a structured singular value at its peak over frequency (0 for the limit towards 0)."""

    lower: float
    upper: float
    frequency: float


@dataclass(frozen=True)
class WorstElement:
    """One element of the plant under the worst perturbation."""

    output: str
    input: str
    tf: str


@dataclass(frozen=True)
class SystemPeaks:
    """Nominal performance, robust stability and robust performance of one system; those that were asked for."""

    stable: bool
    robust_performance_holds: bool | None
    NP: Peak | None = field(default=None, metadata=ABSENT)
    RS: Peak | None = field(default=None, metadata=ABSENT)
    RP: Peak | None = field(default=None, metadata=ABSENT)
    worst_plant: tuple[WorstElement, ...] = field(default=(), metadata=ABSENT)


@dataclass(frozen=True)
class Pairing:
    """Steady-state relative gains of one system, and the inputs in loops of the wrong sign."""

    rga: tuple[tuple[float, ...], ...]
    """[output][input]"""
    niederlinski: float
    wrong_sign: tuple[str, ...]


@dataclass(frozen=True)
class DrawnLoop:
    """One loop on the plants drawn from the estimate."""

    input: str
    share: float
    """Stable with Ms below the limit."""
    Ms_q50: float | None
    Ms_q95: float | None


@dataclass(frozen=True)
class DrawnStability:
    """Today's controller on plants drawn from the estimate."""

    count: int
    seed: int
    share_stable: float
    Ms_limit: float
    loops: tuple[DrawnLoop, ...]
    share_performance: float | None = field(default=None, metadata=ABSENT)
    """Stable and within wP."""


@dataclass(frozen=True)
class LoopRobustness:
    """All that is found about today's loops."""

    controller_of: str
    """The experiment whose controller stands for today's."""
    margins: Margins
    worse: tuple[str, ...]
    """Inputs whose loops are unstable or close to it on the plant."""
    peaks: Mapping[str, SystemPeaks] = field(default_factory=dict, metadata=ABSENT)
    """"model" and "plant" under the declared uncertainty, "estimate" under that of the parameters."""
    pairing: Mapping[str, Pairing] = field(default_factory=dict, metadata=ABSENT)
    """"model" and "plant"."""
    drawn: DrawnStability | None = field(default=None, metadata=ABSENT)
