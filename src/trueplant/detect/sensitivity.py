"""Nominal sensitivity: what the loop would have done with the model for its plant."""

from __future__ import annotations

import numpy as np

from trueplant.detect.correlation import largest_correlation
from trueplant.detect.signals import Detection, NotApplicable, Signals, centred, flagged, model_error
from trueplant.errors import LoopError
from trueplant.loop import Controller, simulate
from trueplant.lti import TransferMatrix


def nominal_sensitivity(
    signals: Signals, model: TransferMatrix, controller: Controller, level: float = 0.05
) -> Detection:
    """After Botelho, Trierweiler, Farenzena and Duraiski (2015), Ind. Eng. Chem. Res. 54, 12072.

    y0 = y - Shat (y - Ghat u) is the output of the nominal loop. y - y0 = Shat e is found by a simulation of that loop
    with the model's error for its disturbance. The reference compares y with y0 and judges the difference as a
    disturbance or a mismatch from its statistics; the statistic here is the largest correlation of y - y0 with the past
    of the OP that the nominal loop would have written for the set-points alone: a disturbance is unrelated to it. Shat
    spreads a mismatch over all outputs of the loop: the row is a hint, no more.

    `controller` is without a pv_transform. Raises NotApplicable in open loop, and where the nominal loop cannot be
    simulated.
    """
    segment = signals.segment
    if not segment.closed or not np.isfinite(segment.r).all():
        raise NotApplicable("the nominal loop needs a closed-loop record with all set-points")
    n_u = signals.u.shape[1]
    plant = model.columns(0, n_u)
    error, y = model_error(segment, model)
    free = np.tile([-np.inf, np.inf], (n_u, 1))
    try:
        disturbed = simulate(plant, controller, np.zeros_like(y), segment.h, v=error - error[0], limits=free)
        nominal = simulate(plant, controller, segment.r - segment.r[0], segment.h, limits=free)
    except LoopError as problem:
        raise NotApplicable(f"the nominal loop cannot be simulated: {problem}") from None
    difference, driven = centred(disturbed.y[signals.pick]), centred(nominal.u[signals.pick])
    found = largest_correlation(difference, driven, signals.lags, level, False)
    return flagged("nominal-sensitivity", *found, "the nominal loop spreads a mismatch over its outputs and inputs")
