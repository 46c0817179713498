"""What a published plant comes with."""

from __future__ import annotations

from dataclasses import dataclass

from trueplant.loop import Controller
from trueplant.lti import TransferFunction, TransferMatrix

Limits = tuple[float, float]


@dataclass(frozen=True)
class Case:
    """A published model, what its plant became, and the controller it ran under.

    Tuples over outputs and inputs have the order of the matrices; `outputs` and `inputs` hold (name, unit).
    """

    name: str
    reference: str
    model: TransferMatrix
    plant: TransferMatrix | None
    """The plant after its change, None where none is published."""
    controller: Controller | None
    time_unit: str
    outputs: tuple[tuple[str, str], ...]
    inputs: tuple[tuple[str, str], ...]
    output_nominal: tuple[float, ...] | None = None
    input_nominal: tuple[float, ...] | None = None
    output_limits: tuple[Limits, ...] | None = None
    input_limits: tuple[Limits, ...] | None = None
    disturbance: TransferMatrix | None = None
    """Measured disturbances to outputs."""
    uncertainty: TransferFunction | None = None
    """Weight wI of the relative uncertainty of each input channel, where the reference gives one."""
    performance: TransferFunction | None = None
    """Weight wP of the sensitivity in each output channel."""
