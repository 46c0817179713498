"""Today's controllers and what to enter instead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueplant.result.codec import ABSENT

KEEP = "keep"
"""Recommended where today's settings are best left as they are."""


@dataclass(frozen=True)
class ControllerSettings:
    """The keys of a [[controller]] table; a law that is no PID has its formula `tf` alone."""

    form: str | None = None
    Kc: float | None = None
    Ti: float | None = None
    """None: no integral action."""
    Td: float | None = None
    alpha: float | None = None
    Kp: float | None = None
    Ki: float | None = None
    Kd: float | None = None
    Tf: float | None = None
    action: str | None = None
    tf: str | None = None
    others: Mapping[str, str] = field(default_factory=dict)
    """Formulas of the laws from other outputs to the same input."""

    def json_fields(self) -> tuple[str, ...]:
        """The keys of its form; those that may be left out only where they are given."""
        always = {"parallel": ("Kp", "Ki", "Kd"), None: ("tf",)}.get(self.form, ("Kc", "Ti", "Td"))
        given = [name for name in ("alpha", "Tf", "action", "others") if getattr(self, name)]
        given += [name for name in ("alpha", "Tf") if getattr(self, name) == 0]
        return ("form", *always, *given) if self.form else (*always, *given)

    @property
    def values(self) -> dict[str, float | str | None]:
        """Key to value, without the laws from other outputs."""
        return {name: getattr(self, name) for name in self.json_fields() if name != "others"}


@dataclass(frozen=True)
class FaceplateSettings:
    """The numbers as the vendor shows them."""

    gain: float
    integral: float | None
    derivative: float | None
    derivative_filter: float | None
    action: str | None


@dataclass(frozen=True)
class StepResponseMetrics:
    """What a unit step does to the loop."""

    iae: float
    itae: float
    ise: float
    total_variation: float
    """Of OP."""
    settling: float
    overshoot: float | None = field(default=None, metadata=ABSENT)
    """Of a set-point step, as a share."""
    peak: float | None = field(default=None, metadata=ABSENT)
    """Of a load step."""


@dataclass(frozen=True)
class NoiseMetrics:
    """What measurement noise makes of OP."""

    pv_std: float
    op_std: float
    op_variation: float
    """Total variation per time unit."""


@dataclass(frozen=True)
class ReplayMetrics:
    """The loop under the disturbance recovered from a record."""

    experiment: str
    span: float
    iae: float
    pv_rms: float
    op_std: float
    op_variation: float


@dataclass(frozen=True)
class MuPeak:
    """Robust performance under the declared weights."""

    lower: float
    upper: float
    frequency: float


@dataclass(frozen=True)
class LoopMetrics:
    """One loop under one set of controllers, the others closed; None where it is unstable or without limit."""

    stable: bool
    message: str = field(default="", metadata=ABSENT)
    Ms: float | None = None
    Mt: float | None = None
    gain_margin: float | None = None
    phase_margin: float | None = None
    delay_margin: float | None = None
    crossover: float | None = None
    setpoint: StepResponseMetrics | None = None
    load: StepResponseMetrics | None = None
    noise: NoiseMetrics | None = None
    replay: ReplayMetrics | None = None
    mu: MuPeak | None = None


@dataclass(frozen=True)
class MetricsOfBoth:
    """On the model and on the plant as estimated."""

    model: LoopMetrics
    plant: LoopMetrics


@dataclass(frozen=True)
class MsQuantiles:
    """Of the sensitivity peak over the drawn plants; None where unstable."""

    q05: float | None
    q50: float | None
    q95: float | None


@dataclass(frozen=True)
class DrawnShares:
    """One loop on plants drawn anew from what the record leaves possible."""

    count: int
    seed: int
    share: float
    """Ms and Mt of this loop within the limit."""
    share_all: float
    """Those of all loops."""
    stable: float
    Ms: MsQuantiles
    mu_share: float | None
    """Stable and mu within its limit."""


@dataclass(frozen=True)
class CurrentSettings:
    """Today's controller of a loop, and what it does."""

    settings: ControllerSettings | None
    shown: FaceplateSettings | None
    metrics: MetricsOfBoth
    drawn: DrawnShares | None


@dataclass(frozen=True)
class ProposedSettings:
    """What one method proposes for a loop, and what it would do; None where it has no answer."""

    method: str
    note: str
    settings: ControllerSettings | None = None
    shown: FaceplateSettings | None = None
    metrics: MetricsOfBoth | None = None
    drawn: DrawnShares | None = None


@dataclass(frozen=True)
class BeforeAfter:
    """From today's settings to others."""

    before: float
    after: float

    @property
    def ratio(self) -> float | None:
        """None from 0."""
        return self.after / self.before if self.before else None


@dataclass(frozen=True)
class TradeOff:
    """What the recommended settings change of a loop on the plant; None where either side has no such number."""

    input: str
    load_error: BeforeAfter | None
    """Absolute error of a load step, integrated."""
    overshoot: BeforeAfter | None
    """Of a set-point step, as a share."""
    settling: BeforeAfter | None
    """Likewise, in time units."""
    Ms: BeforeAfter | None
    op_moves: BeforeAfter | None
    """Total variation of OP after a set-point step."""
    op_noise: BeforeAfter | None
    """Total variation per time unit that noise of PV makes of OP."""
    mu: BeforeAfter | None
    """Of robust performance, all loops together."""


@dataclass(frozen=True)
class RetuningLimits:
    """What a retuned loop has to keep."""

    Ms: float
    mu: float | None
    share: float
    crossover: float | None
    why: str
    """What sets the highest crossover, or why nothing can be tuned."""


@dataclass(frozen=True)
class Notation:
    """What the faceplate's numbers are written in."""

    gain: str
    integral: str
    derivative_filter: str
    time_unit: str


@dataclass(frozen=True)
class LoopRetuning:
    """One loop: today's settings, the proposals, and the one to enter."""

    input: str
    output: str
    controller_of: str
    form: str
    gain_unit: str
    time_unit: str
    notation: Notation
    limits: RetuningLimits
    assumptions: tuple[str, ...]
    current: CurrentSettings
    proposals: tuple[ProposedSettings, ...]
    recommended: str | None
    """The method whose settings are recommended; KEEP: today's are."""
    reason: str
    price: float | None
    """Integral gain given up for certainty, as a share."""
    trade_off: TradeOff | None = None
    """Of the recommended settings against today's."""

    @property
    def chosen(self) -> ProposedSettings | None:
        """The recommended proposal."""
        return next((p for p in self.proposals if p.method == self.recommended), None)
