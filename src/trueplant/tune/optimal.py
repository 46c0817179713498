"""The settings with the least integral error, found on the exact plant with its dead time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError, UnstableLoop
from trueplant.loop import PID, Controller, simulate, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.tune import levels
from trueplant.tune.integral import Limits
from trueplant.tune.reduce import reduced
from trueplant.tune.response import axis, frequencies
from trueplant.tune.rules import simc

_WEIGHTS: dict[str, Callable[[Array, Array], Array]] = {
    "IAE": lambda t, e: np.abs(e),
    "ISE": lambda t, e: e**2,
    "ITAE": lambda t, e: t * np.abs(e),
}


def optimal(
    g: TransferFunction,
    criterion: str = "IAE",
    step: str = "load",
    kind: str = "PI",
    limits: Limits | None = None,
    alpha: float = levels.ALPHA,
) -> PID:
    """PI or ideal PID with the least IAE, ISE or ITAE after a unit step of "set-point" or "load".

    The loop is simulated; Nelder and Mead's simplex starts from SIMC, in the logarithms of Kc, Ti and Td. limits:
    peaks of S and T that must not be passed (on a grid of frequencies); without them the optimum is often too
    oscillatory to be used (Ms about 2 and more for load steps).

    Raises LoopError for a plant without effective dead time, whose errors have no least value.
    """
    if criterion not in _WEIGHTS or step not in ("load", "set-point") or kind not in ("PI", "PID"):
        raise LoopError('criterion must be "IAE", "ISE" or "ITAE", step "load" or "set-point", kind "PI" or "PID"')
    model = reduced(g)
    if not model.dead_time > 0:
        raise LoopError("without effective dead time a higher gain is always better: there is no optimum; use simc")
    first = simc(model)
    kp, ki, *_ = first.parallel
    # a pure dead time starts from a PI with a short integral time
    ti = kp / ki if kp else model.dead_time / 3
    sign = float(np.sign(ki))
    size = abs(kp) or abs(ki) * ti
    start = [np.log(size), np.log(ti)] + ([np.log(0.4 * model.dead_time + model.tau2)] if kind == "PID" else [])
    run = _Run(g, step, _WEIGHTS[criterion], levels.OPTIMAL_SPAN * (ti + 4 * model.dead_time), limits)

    def pid_of(x: Any) -> PID:
        td = float(np.exp(x[2])) if kind == "PID" else 0.0
        return PID(Kc=sign * float(np.exp(x[0])), Ti=float(np.exp(x[1])), Td=td, alpha=alpha)

    from scipy.optimize import minimize

    # SIMC may itself pass the limits: lower its gain until it does not
    while not np.isfinite(run(pid_of(start))):
        start[0] -= levels.LOWER_GAIN
        if start[0] < np.log(size) - levels.LOWEST_GAIN:
            raise LoopError("no settings were found that keep these limits: allow a higher peak")
    simplex = np.array([start] + [[v - 0.25 * (i == j) for i, v in enumerate(start)] for j in range(len(start))])
    options = {"xatol": 1e-3, "fatol": 1e-5, "maxiter": 400}
    x = np.array(start)
    # once more from where it stopped: a simplex may collapse along the border of the limits
    for _ in range(2):
        found = minimize(
            lambda v: run(pid_of(v)), x, method="Nelder-Mead", options={**options, "initial_simplex": simplex}
        )
        x = found.x
        simplex = np.vstack([x, x - 0.1 * np.eye(x.size)])
    pid = pid_of(x)
    if unstable_poles(TransferMatrix(((g,),)), Controller.diagonal([pid])):
        raise LoopError("no stable settings with a least error were found for this plant: use max_ki or simc")
    return pid


class _Run:
    """The integral error of a loop with given settings; infinite outside the limits."""

    def __init__(
        self,
        g: TransferFunction,
        step: str,
        weight: Callable[[Array, Array], Array],
        span: float,
        limits: Limits | None,
    ) -> None:
        self.plant = TransferMatrix(((g,),))
        self.h = span / levels.OPTIMAL_STEPS
        self.t: Array = np.asarray(np.arange(levels.OPTIMAL_STEPS) * self.h, dtype=np.float64)
        one, none = np.ones((levels.OPTIMAL_STEPS, 1)), np.zeros((levels.OPTIMAL_STEPS, 1))
        self.r, self.load = (one, none) if step == "set-point" else (none, one)
        self.weight, self.limits = weight, limits
        self.w = frequencies([g], per_decade=levels.OPTIMAL_PER_DECADE)
        self.response = g(axis(self.w))

    def __call__(self, pid: PID) -> float:
        if self.limits is not None:
            loop = self.response * pid.feedback(axis(self.w))
            far = 1 / np.abs(1 + loop)
            complementary = np.max(np.abs(loop) * far)
            if np.max(far) > self.limits.Ms or (self.limits.Mt is not None and complementary > self.limits.Mt):
                return np.inf
        try:
            done = simulate(self.plant, Controller.diagonal([pid]), self.r, self.h, input_disturbance=self.load)
        except UnstableLoop:
            return np.inf
        error = done.r[:, 0] - done.y_true[:, 0]
        return float(np.trapezoid(self.weight(self.t, np.asarray(error)), self.t))
