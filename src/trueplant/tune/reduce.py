"""From a plant element to the first or second order with dead time that tuning rules start from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueplant.errors import FormulaError, LoopError
from trueplant.lti import TransferFunction, structure_of
from trueplant.tune import levels
from trueplant.tune.response import ultimate


@dataclass(frozen=True)
class Reduced:
    """``K e^(-theta s)/((tau1 s + 1)(tau2 s + 1))``, or ``K' e^(-theta s)/(s (tau2 s + 1))`` if integrating.

    gain: K, or the slope K' per time unit; tau1 >= tau2 (tau1 is infinite if integrating).
    """

    gain: float
    tau1: float
    tau2: float
    dead_time: float

    @property
    def integrating(self) -> bool:
        """True if tau1 is infinite and `gain` a slope."""
        return self.tau1 == np.inf

    @property
    def slope(self) -> float:
        """Initial slope without tau2 and dead time: K/tau1 or K'."""
        return self.gain if self.integrating else self.gain / self.tau1 if self.tau1 else np.inf

    @property
    def transfer(self) -> TransferFunction:
        """As a transfer function."""
        first = [1.0, 0.0] if self.integrating else [self.tau1, 1.0]
        return TransferFunction.rational([self.gain], np.polymul(first, [self.tau2, 1.0]), self.dead_time)


def half_rule(g: TransferFunction, order: int = 1, tauc: float | None = None, scan: float = 0.0) -> Reduced:
    """Skogestad's half rule (J. Process Control 13, 2003, 291-309, section 2).

    The largest neglected lag goes half to the dead time and half to the smallest lag kept, smaller lags, zeros
    in the right half-plane and half the `scan` of a digital controller go to the dead time; zeros in the left
    half-plane cancel against a lag nearby (rules T1 to T3). Those depend on tauc, by default the effective dead time
    itself, which is then found by repetition. order: 1 or 2 lags.

    Raises LoopError for elements that the rule does not cover: several dead times, complex poles, two integrators.
    """
    if order not in (1, 2):
        raise LoopError(f"a reduced model has order 1 or 2, not {order}")
    try:
        structure, p = structure_of(g)
    except FormulaError as error:
        raise LoopError(f"the half rule does not cover this element: {error}") from error
    if structure.delayed > 1 or structure.pairs or structure.integrators > 1:
        raise LoopError(
            f"the half rule does not cover {g}: it needs real poles, one dead time and at most one integrator; "
            f"use matched()"
        )
    value = dict(zip(structure.names, p, strict=True))
    lags = [value[f"tau{k + 1}"] for k in range(structure.lags)]
    leads = [float(x) for x in p[1 + structure.lags : 1 + structure.lags + structure.leads]]
    gain = float(p[0])
    fixed = value.get("dead_time", g.terms[0].dead_time) + scan / 2 - sum(x for x in leads if x < 0)
    ahead = sorted((x for x in leads if x > 0), reverse=True)

    def at(theta: float) -> Reduced:
        factor, left = _without_leads(ahead, lags, theta, bool(structure.integrators))
        return _halved(gain * factor, left, fixed, order, bool(structure.integrators))

    if tauc is not None:
        return at(tauc)
    theta = fixed
    for _ in range(levels.HALF_RULE_ROUNDS if ahead else 1):
        model = at(theta)
        if abs(model.dead_time - theta) <= 1e-12 * max(theta, model.dead_time):
            break
        theta = model.dead_time
    return model


def _without_leads(ahead: list[float], lags: list[float], theta: float, integrating: bool) -> tuple[float, list[float]]:
    """Factor of the gain, and the lags left after each positive lead is cancelled against one."""
    factor, left = 1.0, sorted(lags, reverse=True)
    for lead in ahead:
        larger = [tau for tau in left if tau >= lead]
        smaller = [tau for tau in left if tau < lead]
        if not larger and not smaller:
            if integrating:
                raise LoopError("a lead that only an integrator could cancel cannot be reduced: use matched()")
            raise LoopError("an element with more zeros than lags cannot be reduced")
        tau = min(larger) if larger else max(smaller)
        if larger and smaller and lead / max(smaller) < min(tau / lead, levels.NEARER_LAG) * (1 - 1e-6):
            # a smaller lag that is nearer; at the very limit, as in the source's example, the larger one
            tau = max(smaller)
        left.remove(tau)
        if lead >= tau:
            if tau >= theta:
                factor *= lead / tau
            elif lead >= theta:
                factor *= lead / theta if theta else 1.0
        elif lead >= levels.FASTER_LEAD * theta:
            factor *= lead / tau
        else:
            kept = max(min(tau, levels.FASTER_LEAD * theta), lead)
            factor *= kept / tau
            if kept > lead:
                left = sorted([*left, kept - lead], reverse=True)
    return factor, left


def _halved(gain: float, lags: list[float], fixed: float, order: int, integrating: bool) -> Reduced:
    taus = [np.inf, *lags] if integrating else list(lags)
    kept, rest = taus[:order], taus[order:]
    kept += [0.0] * (order - len(kept))
    theta = fixed
    if rest:
        theta += rest[0] / 2 + sum(rest[1:])
        kept[-1] += rest[0] / 2
    tau1, tau2 = (kept[0], 0.0) if order == 1 else (max(kept), min(kept))
    return Reduced(gain, float(tau1), float(tau2), float(theta))


def matched(g: TransferFunction) -> Reduced:
    """First order with dead time that has the steady-state gain of g and its ultimate gain and period exactly.

    For any stable or integrating element, with any dead times. An integrating one becomes
    ``K' e^(-theta s)/(s (tau2 s + 1))`` with the slope of g.

    Raises LoopError where the phase never reaches -180 degrees, or the two do not fit together.
    """
    ku, pu = ultimate(g)
    wu = 2 * np.pi / pu
    gain = g.dc_gain
    integrating = bool(np.isinf(gain))
    if integrating:
        gain = (g * TransferFunction.rational([1.0, 0.0])).dc_gain
    if not np.isfinite(gain) or gain == 0:
        raise LoopError(f"{g} has no finite steady-state gain or slope to keep")
    size = abs(ku * gain) / (wu if integrating else 1.0)
    if size <= 1:
        raise LoopError(
            f"{g} is larger at its ultimate frequency than at rest: no first order with dead time is like it"
        )
    tau = float(np.sqrt(size**2 - 1)) / wu
    lag = np.arctan(wu * tau) + (np.pi / 2 if integrating else 0.0)
    theta = float(np.pi - lag) / wu
    return Reduced(float(gain), np.inf, tau, theta) if integrating else Reduced(float(gain), tau, 0.0, theta)


def reduced(g: TransferFunction, order: int = 1, scan: float = 0.0) -> Reduced:
    """By the half rule where it covers the element, else matched (first order).

    Raises LoopError where neither has an answer.
    """
    attempts: tuple[Callable[[], Reduced], ...] = (lambda: half_rule(g, order, scan=scan), lambda: matched(g))
    try:
        return attempts[0]()
    except LoopError:
        model = attempts[1]()
        return Reduced(model.gain, model.tau1, model.tau2, model.dead_time + scan / 2)
