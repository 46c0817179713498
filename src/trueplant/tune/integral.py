"""The largest integral gain that keeps the peaks of S and T below their limits, exactly with dead time.

Largest ki means least integrated error after a load disturbance (Astrom, Panagopoulos and Hagglund, Automatica 34,
1998, 585-601). At each frequency |S| <= Ms and |T| <= Mt both keep the controller's response C(jw) out of a disc:
round -1/G with radius 1/(Ms |G|), and round -Mt^2/((Mt^2 - 1) G) with radius Mt/((Mt^2 - 1) |G|). With
C = kp shape(jw) - j ki/w each disc forbids an interval of ki, so the limit of ki at a given kp is a minimum over
frequency, no search. All of it runs for many plants at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.compiled import compiled
from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.tune import levels
from trueplant.tune.forms import series_ratio
from trueplant.tune.response import Plant, axis, grid_for, sign_of, ultimate


@dataclass(frozen=True)
class Limits:
    """Largest allowed peaks of |S| and |T|; Mt of None sets no limit on T."""

    Ms: float = levels.PEAK
    Mt: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("Ms", self.Ms), ("Mt", self.Mt)):
            if value is not None and not (np.isfinite(value) and value > 1):
                raise LoopError(f"the limit on {name} must be above 1, not {value:g}")


@dataclass(frozen=True, eq=False)
class Discs:
    """Where the response of the controller may not be, for many plants: n_w frequencies for each limit, in a row."""

    w: Array
    """(n,) rad per time unit; n is n_w times the number of limits."""
    centre: ComplexArray
    """(n_plants, n)"""
    radius: Array
    """(n_plants, n)"""

    @classmethod
    def of(cls, response: ComplexArray, w: Array, limits: Limits) -> Discs:
        """From G (n_plants, n_w), of positive sign at rest, on the grid w."""
        inverse = 1 / np.atleast_2d(response)
        size = np.abs(inverse)
        centre, radius = [-inverse], [size / limits.Ms]
        if limits.Mt is not None:
            scale = 1 / (limits.Mt**2 - 1)
            centre.append(-inverse * (limits.Mt**2 * scale))
            radius.append(size * (limits.Mt * scale))
        return cls(np.tile(w, len(centre)), np.concatenate(centre, axis=1), np.concatenate(radius, axis=1))

    def shape(self, td: float, alpha: float) -> ComplexArray:
        """``1 + Td s/(alpha Td s + 1)`` at s = j w (n,): what kp multiplies."""
        return _shape(self.w, td, alpha)

    def proportional_limit(self, shape: ComplexArray) -> Array:
        """Smallest kp (n_plants,) without integral action that reaches a limit, infinite if none does."""
        along = np.real(np.conj(shape) * self.centre)
        square = np.abs(shape) ** 2
        inside = along**2 - square * (np.abs(self.centre) ** 2 - self.radius**2)
        hit = (inside > 0) & (along > 0)
        first = (along - np.sqrt(np.where(hit, inside, 0.0))) / square
        return np.asarray(np.min(np.where(hit, first, np.inf), axis=1))

    def integral_limit(self, shape: ComplexArray, kp: float) -> Array:
        """Largest ki (n_plants,) at kp such that all smaller ki hold the limits too; 0 where even ki -> 0 does not.

        Only meant for kp below `proportional_limit`, and plants that are stable but for integrators: then all of these
        loops are stable, since they are joined to the open loop without touching -1.
        """
        return np.asarray(_integral_limits(self.centre, self.radius, self.w, kp * shape))


def _shape(w: Array, td: float, alpha: float) -> ComplexArray:
    s = axis(w)
    return np.asarray(1 + td * s / (alpha * td * s + 1))


@compiled
def _integral_limits(centre: ComplexArray, radius: Array, w: Array, free: ComplexArray) -> Array:
    least = np.full(centre.shape[0], np.inf)
    for p in range(centre.shape[0]):
        for k in range(w.size):
            x = free[k].real - centre[p, k].real
            room = radius[p, k] ** 2 - x * x
            if room > 0:
                # Im C = Im(free) - ki/w lies in the disc for ki between these
                y, half = free[k].imag - centre[p, k].imag, np.sqrt(room)
                if y + half > 0:
                    least[p] = min(least[p], max(w[k] * (y - half), 0.0))
    return least


def best_kp(limit: Callable[[float], float], top: float, zooms: int = levels.KP_ZOOMS) -> tuple[float, float]:
    """kp in (0, top] with the largest ki limit(kp), by zooming into a grid; and that ki."""
    low, high = 0.0, top
    best, at = -np.inf, top
    for _ in range(zooms):
        points = np.linspace(low, high, levels.KP_POINTS)[1:]
        values = np.array([limit(float(kp)) for kp in points])
        k = int(np.argmax(values))
        if values[k] > best:
            best, at = float(values[k]), float(points[k])
        step = (high - low) / (levels.KP_POINTS - 1)
        low, high = max(at - step, 0.0), min(at + step, top)
    return at, best


def max_ki(
    plant: Plant,
    limits: Limits | float = levels.PEAK,
    kind: str = "PI",
    alpha: float = levels.ALPHA,
    w: Array | None = None,
) -> PID:
    """PI or ideal PID with the largest integral gain whose peaks of S and T stay within the limits.

    limits: a number limits both Ms and Mt. A PID is kept to Ti/Td for which it has a series form too (4.2 with
    alpha 0.1); without this the largest ki gives an oscillating loop. plant: stable but for integrators; a
    `TransferFunction`, or a response with its grid w.

    Raises LoopError where the limits never bind (no dead time and few lags): no gain is largest there; and for a plant
    that is unstable in open loop.
    """
    if kind not in ("PI", "PID"):
        raise LoopError(f'kind must be "PI" or "PID", not {kind!r}')
    bounds = limits if isinstance(limits, Limits) else Limits(limits, limits)
    coarse = grid_for(plant, w)
    sign = sign_of(plant)

    def tuned(td: float, w: Array) -> tuple[float, float]:
        discs = Discs.of(sign * plant(axis(w)), w, bounds)
        shape = discs.shape(td, alpha)
        top = float(discs.proportional_limit(shape)[0])
        if not np.isfinite(top):
            raise LoopError("these limits bound no gain of this plant: state a lower limit, or use simc with a tauc")

        def limit(kp: float) -> float:
            ki = float(discs.integral_limit(shape, kp)[0])
            return min(ki, kp / (series_ratio(alpha) * td)) if td else ki

        return best_kp(limit, top)

    td = 0.0
    kp, ki = tuned(td, coarse)
    if kind == "PID":
        td = best_td(lambda x: tuned(x, coarse)[1], ultimate(plant, coarse)[1])
        kp, ki = tuned(td, coarse)
    # kp is far more sensitive to the grid than ki: once more, with many points where the limits bind
    loop = sign * plant(axis(coarse)) * (kp * _shape(coarse, td, alpha) + ki / axis(coarse))
    near = levels.NEAR_LIMIT / np.abs(1 + loop) > bounds.Ms
    if bounds.Mt is not None:
        near |= levels.NEAR_LIMIT * np.abs(loop / (1 + loop)) > bounds.Mt
    if np.any(near):
        low, high = levels.AROUND_NEAR
        dense = np.geomspace(low * coarse[near][0], high * coarse[near][-1], levels.NEAR_POINTS)
        kp, ki = tuned(td, np.concatenate([coarse, dense]))
    if not (ki > 0 and np.isfinite(ki)):
        raise LoopError("no integral action keeps these limits on this plant: allow a higher peak")
    return PID(Kc=sign * kp, Ti=kp / ki, Td=td, alpha=alpha)


def best_td(value: Callable[[float], float], period: float) -> float:
    """Derivative time with the largest value: a coarse grid relative to the ultimate period, then golden section."""
    from scipy.optimize import minimize_scalar

    grid = period * np.geomspace(*levels.TD_RANGE, levels.TD_POINTS)
    k = int(np.argmax([value(float(td)) for td in grid]))
    low, high = grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]
    found = minimize_scalar(
        lambda td: -value(float(td)), bounds=(low, high), method="bounded", options={"xatol": levels.TD_PRECISION * low}
    )
    return float(found.x)
