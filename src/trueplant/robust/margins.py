"""Stability margins of a loop and advice on pairing.

The frequencies of crossings and peaks are found to 1e-7, dead time is exact. A sampled controller is taken by its
frequency function with its hold, up to half the scan rate; aliasing is neglected, which for a scan of a sixth of the
dead time shifts the gain margin by half a per cent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError, UnstableLoop
from trueplant.loop import Controller, unstable_poles
from trueplant.lti import TransferMatrix
from trueplant.robust import levels
from trueplant.robust.grid import crossings, follow, on_axis, peak, rates_of


@dataclass(frozen=True)
class Margins:
    """Distances of one stable loop from instability; frequencies in rad per time unit, nan where there is none."""

    gain_margin: float
    """Factor on the loop gain at which the loop becomes unstable, above 1; infinite if there is none."""
    gain_reduction: float
    """Factor below 1 at which it becomes unstable; 0 if there is none."""
    phase_margin: float
    """Degrees, of either sign of the change; infinite if the loop gain never is 1."""
    delay_margin: float
    """Additional dead time at which the loop becomes unstable, in time units; may be infinite."""
    disk_margin: float
    """1/max|S - 1/2|: the loop stands any gain within (2 - a)/(2 + a)..(2 + a)/(2 - a) and any phase change up to
    2 atan(a/2), and mixtures of both (Seiler, Packard and Gahinet 2020)."""
    Ms: float
    """Peak of |S|."""
    Mt: float
    """Peak of |T|."""
    gain_margin_frequency: float
    gain_reduction_frequency: float
    phase_margin_frequency: float
    delay_margin_frequency: float
    disk_margin_frequency: float
    Ms_frequency: float
    """Infinite if |S| rises to its largest value without a peak."""
    Mt_frequency: float
    """0 if |T| falls from its largest value on."""

    def __repr__(self) -> str:
        return (
            f"GM {self.gain_margin:.4g}, PM {self.phase_margin:.4g} deg, delay margin {self.delay_margin:.4g}, "
            f"Ms {self.Ms:.4g} at {self.Ms_frequency:.4g}, Mt {self.Mt:.4g} at {self.Mt_frequency:.4g}"
        )


def margins(plant: TransferMatrix, controller: Controller, loop: int = 0, others: str = "closed") -> Margins:
    """Margins of one loop, broken at plant input `loop` (counted from 0), the other loops closed or open.

    Raises UnstableLoop where there is no margin because the closed loop (with others = "open": this loop alone) is
    unstable, LoopError for wrong arguments.
    """
    if (controller.n_u, controller.n_y) != (plant.shape[1], plant.shape[0]):
        raise LoopError(
            f"the controller is for {controller.n_y} outputs and {controller.n_u} inputs, the plant has "
            f"{plant.shape[0]} and {plant.shape[1]}: they must agree"
        )
    if not 0 <= loop < plant.shape[1]:
        raise LoopError(f"loop {loop} does not exist: the plant has inputs 0 to {plant.shape[1] - 1}")
    if others not in ("closed", "open"):
        raise LoopError(f'others must be "closed" or "open", not {others!r}')
    if others == "open":
        plant = TransferMatrix(tuple((row[loop],) for row in plant.elements), plant.time_unit)
        own = {(0, j): entry for (i, j), entry in controller.entries.items() if i == loop}
        controller, loop = Controller(own, 1, controller.n_y), 0
    if not any(i == loop for i, _ in controller.entries):
        raise LoopError(f"no controller writes input {loop + 1}: that loop has no margins")
    poles = unstable_poles(plant, controller)
    if poles:
        raise UnstableLoop(f"the loop is unstable ({poles} unstable poles), so it has no margins")

    def broken(w: Array) -> ComplexArray:
        """-1 times the response around the loop from plant input `loop`, the others closed."""
        s = on_axis(w, plant)
        around = controller(s) @ plant(s)
        if around.shape[-1] == 1:
            return np.asarray(around[:, 0, 0])
        rest = np.delete(np.arange(around.shape[-1]), loop)
        to, back = around[:, rest, loop], around[:, loop, rest]
        inner = np.eye(rest.size) + around[:, rest[:, None], rest]
        through = np.linalg.solve(inner, to[:, :, None])[:, :, 0]
        return np.asarray(around[:, loop, loop] - np.sum(back * through, axis=1))

    rates = rates_of(plant, controller)
    w, value = follow(broken, rates.grid(), rates.dead_time)
    return _from_response(broken, w, value)


def _from_response(loop: Callable[[Array], ComplexArray], w: Array, value: ComplexArray) -> Margins:
    at_180 = crossings(
        lambda x: np.asarray(loop(x).imag, dtype=np.float64), w, np.asarray(value.imag, dtype=np.float64)
    )
    response = loop(at_180)
    # the imaginary part also changes sign through infinity, at an undamped pole
    real = (response.real < 0) & (np.abs(response.imag) < levels.REAL_CROSSING * np.abs(response.real))
    at_180, factor = at_180[real], -1 / response.real[real]
    up, w_up = _closest(factor, at_180, factor > 1, np.inf)
    down, w_down = _closest(-factor, at_180, factor < 1, 0.0)

    at_1 = crossings(lambda x: np.asarray(np.abs(loop(x)) - 1), w, np.asarray(np.abs(value) - 1))
    angle = np.angle(-loop(at_1))
    phase, w_phase = _closest(np.abs(np.degrees(angle)), at_1, np.isfinite(angle), np.inf)
    delay, w_delay = _closest(np.mod(angle, 2 * np.pi) / at_1, at_1, np.isfinite(angle), np.inf)

    def distance(x: Array) -> Array:
        return np.asarray(np.abs(1 / (1 + loop(x)) - 0.5))

    def complementary(x: Array) -> Array:
        around = loop(x)
        return np.abs(around / (1 + around))

    disk, w_disk = peak(distance, w, np.abs(1 / (1 + value) - 0.5))
    ms, w_s = peak(lambda x: 1 / np.abs(1 + loop(x)), w, 1 / np.abs(1 + value))
    mt, w_t = peak(complementary, w, np.abs(value / (1 + value)))
    return Margins(
        gain_margin=up,
        gain_reduction=abs(down),
        phase_margin=phase,
        delay_margin=delay,
        disk_margin=1 / disk,
        Ms=ms,
        Mt=mt,
        gain_margin_frequency=w_up,
        gain_reduction_frequency=w_down,
        phase_margin_frequency=w_phase,
        delay_margin_frequency=w_delay,
        disk_margin_frequency=w_disk,
        Ms_frequency=w_s,
        Mt_frequency=w_t,
    )


def _closest(value: Array, w: Array, allowed: NDArray[np.bool_], none: float) -> tuple[float, float]:
    if not np.any(allowed):
        return none, float("nan")
    k = int(np.argmin(np.where(allowed, value, np.inf)))
    return float(value[k]), float(w[k])


def _square(G0: ArrayLike) -> Array:
    gain = np.asarray(G0, dtype=float)
    if gain.ndim != 2 or gain.shape[0] != gain.shape[1] or not np.all(np.isfinite(gain)):
        raise LoopError("the relative gains need a square matrix of finite steady-state gains")
    return gain


def rga(G0: ArrayLike) -> Array:
    """Relative gain array (n, n) of the steady-state gains, G0 times its transposed inverse elementwise (Bristol 1966).

    Raises LoopError for a singular matrix.
    """
    gain = _square(G0)
    try:
        return np.asarray(gain * np.linalg.inv(gain).T)
    except np.linalg.LinAlgError as error:
        raise LoopError("the steady-state gains are singular: these outputs cannot be controlled one by one") from error


def niederlinski(G0: ArrayLike) -> float:
    """det(G0) over the product of its diagonal; negative: unstable under integral control paired on the diagonal.

    (Niederlinski 1971; for stable plants with stable diagonal loops.) Raises LoopError if the diagonal has a zero.
    """
    gain = _square(G0)
    product = float(np.prod(np.diag(gain)))
    if product == 0:
        raise LoopError("an element on the diagonal has no steady-state gain: pair that output with another input")
    return float(np.linalg.det(gain)) / product
