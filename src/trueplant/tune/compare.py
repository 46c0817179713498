"""What a controller does on a plant, before and after: step responses and margins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError, UnstableLoop
from trueplant.loop import PID, Controller, simulate
from trueplant.loop.pid import Entry
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.robust import Margins, margins
from trueplant.tune import levels

Step = Literal["set-point", "load"]


@dataclass(frozen=True)
class StepMetrics:
    """A unit step of the set-point, or of a load at the plant's input; errors in units of PV, times of the plant."""

    iae: float
    """Integral of |r - y|."""
    itae: float
    """Integral of t |r - y|, t from the step on."""
    ise: float
    """Integral of (r - y)^2."""
    total_variation: float
    """Sum of all moves of OP."""
    peak: float
    """Overshoot beyond the set-point as a share of the step, at least 0; for a load the largest |y|."""
    settling: float
    """Time after which |r - y| stays within 2 % of the step, or of the peak for a load."""


@dataclass(frozen=True)
class LoopMetrics:
    """Step responses and margins of one loop."""

    setpoint: StepMetrics
    load: StepMetrics
    margins: Margins


@dataclass(frozen=True)
class Comparison:
    """One loop with two controllers on the same plant; None where that loop is unstable."""

    before: LoopMetrics | None
    after: LoopMetrics | None


def step_metrics(
    plant: TransferMatrix | TransferFunction,
    controller: Controller | Entry,
    step: Step,
    *,
    output: int = 0,
    input: int = 0,
    horizon: float | None = None,
) -> StepMetrics:
    """Measures of the step response of one loop, the others closed and at rest.

    The step is +1 in the set-point of `output`, or +1 added at the plant's `input`, at time 0. The loop is
    simulated without limits of OP, over `horizon` or until it has settled to 0.1 % of the peak; errors are
    integrated by the trapezoidal rule over 4000 points or more.

    Raises UnstableLoop, and LoopError if the response takes too long to settle.
    """
    matrix, law = _matrix(plant), _controller(controller)
    return _measured(matrix, law, margins(matrix, law, input), step, output, input, horizon)


def _measured(
    plant: TransferMatrix,
    law: Controller,
    found: Margins,
    step: Step,
    output: int,
    input: int,
    horizon: float | None,
) -> StepMetrics:
    if step not in ("set-point", "load"):
        raise LoopError(f'step must be "set-point" or "load", not {step!r}')
    h, count = _span(plant, law, found, horizon)
    while True:
        t, error, u = step_response(plant, law, step, h, count, output=output, input=input)
        size = float(np.max(np.abs(error)))
        if horizon is not None or np.max(np.abs(error[-count // 5 :])) <= levels.SETTLED * size:
            break
        if count > levels.MOST_RESPONSE_STEPS:
            raise LoopError("the step response does not settle: give a horizon; or add integral action")
        count *= 2
    if size == 0:
        return StepMetrics(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    absolute = np.abs(error)
    band = levels.SETTLING_BAND * (1.0 if step == "set-point" else size)
    outside = np.flatnonzero(absolute > band)
    settling = float(t[min(outside[-1] + 1, t.size - 1)]) if outside.size else 0.0
    peak = max(0.0, float(-np.min(error))) if step == "set-point" else size
    return StepMetrics(
        iae=float(np.trapezoid(absolute, t)),
        itae=float(np.trapezoid(t * absolute, t)),
        ise=float(np.trapezoid(error**2, t)),
        total_variation=float(np.sum(np.abs(np.diff(u, prepend=0.0)))),
        peak=peak,
        settling=settling,
    )


def step_response(
    plant: TransferMatrix, law: Controller, step: Step, h: float, count: int, *, output: int = 0, input: int = 0
) -> tuple[Array, Array, Array]:
    """t, r - y of `output` and the OP of `input` (count,) each at steps of h, after a unit step; no limits of OP.

    The other loops are closed and at rest. Raises UnstableLoop where the simulation runs away.
    """
    r, load = np.zeros((count, plant.shape[0])), np.zeros((count, plant.shape[1]))
    if step == "set-point":
        r[:, output] = 1.0
    else:
        load[:, input] = 1.0
    wide = np.tile([-np.inf, np.inf], (plant.shape[1], 1))
    done = simulate(plant, law, r, h, input_disturbance=load, limits=wide)
    return done.t, done.r[:, output] - done.y_true[:, output], done.u[:, input]


def _span(plant: TransferMatrix, law: Controller, found: Margins, horizon: float | None) -> tuple[float, int]:
    """Step and number of steps: some times of the loop, in steps short against crossover, dead times and scans."""
    slow = [entry.tracking_time for entry in law.entries.values() if isinstance(entry, PID)]
    terms = [term for row in plant.elements for element in row for term in element.terms]
    rates = np.abs(np.concatenate([np.roots(term.den) for term in terms]))
    times = [t for t in slow if np.isfinite(t)] + [t.dead_time for t in terms] + list(1 / rates[rates > 0])
    span = horizon if horizon is not None else levels.RESPONSE_SPAN * max(times, default=1.0)
    shortest = [t.dead_time / levels.DEAD_TIME_STEPS for t in terms if t.dead_time > 0]
    if np.isfinite(found.phase_margin_frequency):
        shortest.append(levels.CROSSOVER_STEP / found.phase_margin_frequency)
    h = max(min([span / levels.RESPONSE_STEPS, *shortest]), span / levels.MOST_RESPONSE_STEPS)
    scans = [entry.sample_time for entry in law.entries.values() if entry.sample_time is not None]
    if scans:
        # sampled controllers run exactly: a step that divides the scan
        h = min(scans) / np.ceil(min(scans) / h)
    return float(h), int(np.ceil(span / h)) + 1


def loop_metrics(
    plant: TransferMatrix | TransferFunction, controller: Controller | Entry, *, output: int = 0, input: int = 0
) -> LoopMetrics:
    """Set-point and load step and margins of the loop from `output` to `input`, the other loops closed.

    Raises UnstableLoop if it is unstable.
    """
    matrix, law = _matrix(plant), _controller(controller)
    found = margins(matrix, law, input)
    setpoint = _measured(matrix, law, found, "set-point", output, input, None)
    load = _measured(matrix, law, found, "load", output, input, None)
    return LoopMetrics(setpoint, load, found)


def compare(
    plant: TransferMatrix | TransferFunction,
    before: Controller | Entry,
    after: Controller | Entry,
    *,
    output: int = 0,
    input: int = 0,
) -> Comparison:
    """The same loop with the controller before and after."""

    def of(controller: Controller | Entry) -> LoopMetrics | None:
        try:
            return loop_metrics(plant, controller, output=output, input=input)
        except UnstableLoop:
            return None

    return Comparison(of(before), of(after))


def _matrix(plant: TransferMatrix | TransferFunction) -> TransferMatrix:
    return plant if isinstance(plant, TransferMatrix) else TransferMatrix(((plant,),))


def _controller(controller: Controller | Entry) -> Controller:
    return controller if isinstance(controller, Controller) else Controller.diagonal([controller])
