"""What tuning needs of a plant's exact frequency response: a grid, and the ultimate gain and period.

A plant is anything that answers G(s) at complex points s (n_s,): a `TransferFunction`, or one loop of several
with the others closed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.lti import TransferFunction
from trueplant.tune import levels

Plant = Callable[[ComplexArray], ComplexArray]


def axis(w: Array) -> ComplexArray:
    """The points j w."""
    return np.asarray(1j * w, dtype=np.complex128)


def frequencies(elements: Iterable[TransferFunction], per_decade: int = levels.PER_DECADE) -> Array:
    """Grid (n_w,) in rad per time unit, 0.001 times the slowest rate to 50 times the fastest, more at resonances."""
    terms = [term for g in elements for term in g.terms]
    roots = np.concatenate([np.zeros(0, complex), *(np.roots(p) for t in terms for p in (t.num, t.den))])
    delays = np.array([t.dead_time for t in terms if t.dead_time > 0])
    rates = np.concatenate([np.abs(roots), 1 / delays])
    rates = rates[rates > 0]
    if rates.size == 0:
        rates = np.ones(1)
    low, high = levels.SLOWEST * rates.min(), levels.FASTEST * rates.max()
    w = np.geomspace(low, high, int(np.ceil(per_decade * np.log10(high / low))))
    light = roots[np.abs(roots.real) < levels.LIGHT_DAMPING * roots.imag]
    offset = np.abs(light.real)[:, None] * np.geomspace(*levels.AROUND_RESONANCE, 30)
    near = np.concatenate([light.imag[:, None] + offset, light.imag[:, None] - offset]).ravel()
    return np.unique(np.concatenate([w, near[(near > low) & (near < high)]]))


def ultimate(plant: Plant, w: Array | None = None) -> tuple[float, float]:
    """Ultimate gain, signed like the plant, and ultimate period: P control at that gain oscillates for ever.

    Exact with dead time: the first -180 degrees are found on the grid and sharpened by bisection of the phase. The
    sign is that of the response at the lowest frequency (for integrators: of its slope). w: grid, needed
    unless plant is a `TransferFunction`.

    Raises LoopError if the phase does not reach -180 degrees: then no gain is too high.
    """
    w = grid_for(plant, w)
    sign = sign_of(plant)
    value = sign * plant(axis(w))
    # Through the negative real axis, wherever: an undamped pole's jump is no crossing
    turning = (value.imag[:-1] < 0) != (value.imag[1:] < 0)
    at = np.flatnonzero(turning & (value.real[:-1] < 0) & (value.real[1:] < 0))
    if at.size == 0:
        raise LoopError(
            "the phase never reaches -180 degrees, so there is no ultimate gain: rules built on it do not fit"
        )
    low, high = w[at], w[at + 1]
    below = value.imag[at] < 0
    for _ in range(60):
        middle = (low + high) / 2
        stays = ((sign * plant(axis(middle))).imag < 0) == below
        low, high = np.where(stays, middle, low), np.where(stays, high, middle)
    wu = (low + high) / 2
    gains = np.abs(plant(axis(wu)))
    # the loop that is stable at low gain is first lost where the response is largest
    k = int(np.argmax(gains))
    return float(sign / gains[k]), float(2 * np.pi / wu[k])


def sign_of(plant: Plant) -> float:
    """Sign of the plant at rest: of its gain, or of its slope if it integrates.

    Raises LoopError where it cannot be told, or for a plant with no effect at rest.
    """
    if isinstance(plant, TransferFunction):
        value = np.array([plant.dc_gain])
        if plant.is_zero or np.isnan(value[0]) or value[0] == 0:
            raise LoopError(f"{plant} has no gain at rest: an integrating controller cannot hold it anywhere")
        return float(np.sign(value[0]))
    near = np.real(plant(np.array([1e-9 + 0j])))
    if not np.isfinite(near[0]) or near[0] == 0:
        raise LoopError("the sign of the plant's gain at rest cannot be told")
    return float(np.sign(near[0]))


def grid_for(plant: Plant, w: Array | None) -> Array:
    """The grid given, or the transfer function's own."""
    if w is not None:
        return w
    if not isinstance(plant, TransferFunction):
        raise LoopError("give a grid of frequencies w together with a plant that is not a TransferFunction")
    poles = plant.poles
    if np.any(poles.real > levels.UNSTABLE * np.abs(poles)):
        raise LoopError(f"{plant} is unstable in open loop: this tuning is for plants that are stable or integrate")
    return frequencies([plant])
