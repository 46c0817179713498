"""Settings for a plant that the data left uncertain.

Plants are drawn from what is known of the parameters. For each drawn plant the largest integral gain under the
limits is known in closed form at every kp (`integral`), so what holds for a share of the plants is a quantile: no
search over ki.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.lti import Structure
from trueplant.lti.uncertain import responses
from trueplant.tune import levels
from trueplant.tune.forms import series_ratio
from trueplant.tune.integral import Discs, Limits, best_kp, best_td, max_ki
from trueplant.tune.response import frequencies, ultimate


@dataclass(frozen=True)
class UncertainTuning:
    """Settings that hold the limits for a share of the plants, and what that costs."""

    pid: PID
    nominal: PID
    """Largest integral gain for the nominal plant alone."""
    share: float
    """Requested share of all plants."""
    confidence: float
    """Probability with which at least that share of all plants holds the limits."""
    nominal_share: float
    """Share of the second half of the draws for which the nominal tuning holds the limits."""
    price: float
    """Part of the nominal tuning's integral gain that is given up, 0 to 1 (the integrated error of a load step rises
    by the factor 1/(1 - price)); negative if the nominal plant is a pessimistic one."""


def draw_parameters(structure: Structure, mean: ArrayLike, covariance: ArrayLike, count: int, seed: int) -> Array:
    """(count, n_p) normal draws of the parameters, those outside `structure.bounds()` drawn anew.

    Gains (slopes) that change sign are drawn anew as well: no controller works for both signs.

    Raises LoopError for shapes that do not fit, a covariance that is not one, and if almost no draw is inside.
    """
    centre, spread = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    n = len(structure.names)
    if (
        centre.shape != (n,)
        or spread.shape != (n, n)
        or not (np.all(np.isfinite(centre)) and np.all(np.isfinite(spread)))
    ):
        raise LoopError(f"{structure} has {n} parameters: give {n} finite means and a {n} by {n} covariance")
    values, vectors = np.linalg.eigh((spread + spread.T) / 2)
    if np.min(values) < -1e-9 * max(float(np.max(values)), 0.0):
        raise LoopError("the covariance has a negative variance: it is not a covariance")
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    low, high = structure.bounds()
    rng = np.random.default_rng(seed)
    kept: list[Array] = []
    have = 0
    for _ in range(levels.MOST_DRAW_ROUNDS):
        draws = centre + rng.standard_normal((count, n)) @ root.T
        inside = np.all((draws >= low) & (draws <= high), axis=1)
        inside &= np.sign(_gain(structure, draws)) == np.sign(_gain(structure, centre[None, :]))
        kept.append(draws[inside])
        have += int(inside.sum())
        if have >= count:
            return np.concatenate(kept)[:count]
    raise LoopError("almost no draw has a plant that can be: the parameters are far too uncertain to tune for")


def _gain(structure: Structure, p: Array) -> Array:
    return np.asarray(np.sum(p[:, : structure.delayed], axis=1))


def holds(structure: Structure, parameters: ArrayLike, pid: PID, limits: Limits | float) -> NDArray[np.bool_]:
    """(n_plants,) whether each plant is stable under an ideal PI or PID and keeps the limits."""
    bounds = limits if isinstance(limits, Limits) else Limits(limits, limits)
    p = np.atleast_2d(np.asarray(parameters, dtype=float))
    kp, ki, _, _ = pid.parallel
    if pid.form != "ideal" or not (kp and ki):
        raise LoopError('holds() needs a PI or PID in the form "ideal": use converted(pid, "ideal")')
    sign = float(np.sign(kp))
    w = _grid(structure, p)
    discs = Discs.of(sign * responses(structure, p, w), w, bounds)
    shape = discs.shape(pid.Td, pid.alpha)
    fits = discs.proportional_limit(shape) > abs(kp)
    fits &= discs.integral_limit(shape, abs(kp)) >= abs(ki) * (1 - levels.ROUNDING)
    return np.asarray(fits & (np.sign(_gain(structure, p)) == sign))


def _grid(structure: Structure, parameters: Array) -> Array:
    """One grid for all plants, wide round the ultimate frequencies of the middle plant and of the extreme ones."""
    ends = [np.median(parameters, axis=0), parameters.min(axis=0), parameters.max(axis=0)]
    plants = [structure.transfer(p) for p in ends]
    try:
        found = 2 * np.pi / np.array([ultimate(g)[1] for g in plants])
    except LoopError:
        return frequencies(plants, per_decade=levels.UNCERTAIN_PER_DECADE)
    low, high = found.min() / levels.UNCERTAIN_BELOW, found.max() * levels.UNCERTAIN_ABOVE
    damping = float(np.min(parameters[:, structure.is_damping], initial=1.0))
    # half the width of the sharpest resonance
    density = max(levels.UNCERTAIN_PER_DECADE, 2 * np.log(10) / max(damping, levels.SHARPEST))
    return np.geomspace(low, high, int(np.ceil(density * np.log10(high / low))))


def tune_uncertain(
    structure: Structure,
    draws: ArrayLike,
    *,
    nominal: ArrayLike | None = None,
    limits: Limits | float = levels.PEAK,
    share: float = levels.SHARE,
    confidence: float = levels.CONFIDENCE,
    kind: str = "PI",
    alpha: float = levels.ALPHA,
) -> UncertainTuning:
    """PI or ideal PID with the largest integral gain that keeps the limits for a share of all plants.

    draws: (n, n_p) independent draws of the parameters, as from `draw_parameters` or a bootstrap. The first half
    chooses the settings. The second half proves them: they are slowed down, if need be, until so few plants fail
    that at least the stated share of all plants holds with the stated confidence (the binomial test behind Wilks'
    tolerance limits, Ann. Math. Stat. 12, 1941, 91-96). So the promise does not rest on the draws that made the
    choice; the more draws, the closer to the stated share. nominal: (n_p,), by default the median of the draws.
    limits: as in `max_ki`.

    Raises LoopError if there are too few draws for the promise (for 0.95 and 0.95 at least 118), plants of both signs,
    or no integral action that would keep the limits for so many.
    """
    p = np.asarray(draws, dtype=float)
    if p.ndim != 2 or p.shape[1] != len(structure.names):
        raise LoopError(f"draws must have shape (n, {len(structure.names)}), one row a plant, not {p.shape}")
    if not (0 < share < 1 and 0 < confidence < 1):
        raise LoopError("share and confidence must be between 0 and 1")
    if kind not in ("PI", "PID"):
        raise LoopError(f'kind must be "PI" or "PID", not {kind!r}')
    bounds = limits if isinstance(limits, Limits) else Limits(limits, limits)
    signs = np.sign(_gain(structure, p))
    if np.any(signs != signs[0]) or signs[0] == 0:
        raise LoopError(
            "the gain's sign differs among the draws: no controller is stable for both; get better data first"
        )
    sign = float(signs[0])
    half = p.shape[0] // 2
    rank = most_failures(p.shape[0] - half, share, confidence)
    centre = np.median(p, axis=0) if nominal is None else np.asarray(nominal, dtype=float)
    plant = structure.transfer(centre)
    w = _grid(structure, p)
    choosing, proving = (Discs.of(sign * responses(structure, part, w), w, bounds) for part in (p[:half], p[half:]))
    low = (rank + 0.5) / (p.shape[0] - half)

    def best(td: float) -> tuple[float, float]:
        shape = choosing.shape(td, alpha)
        edge = choosing.proportional_limit(shape)
        top = float(np.quantile(edge, low, method="lower"))
        if not np.isfinite(top):
            raise LoopError("these limits bound no gain of most of these plants: state a lower limit")

        def limit(kp: float) -> float:
            allowed = np.where(edge > kp, choosing.integral_limit(shape, kp), 0.0)
            ki = float(np.quantile(allowed, low, method="lower"))
            return min(ki, kp / (series_ratio(alpha) * td)) if td else ki

        return best_kp(limit, top, zooms=levels.DRAWN_ZOOMS)

    td = best_td(lambda x: best(x)[1], ultimate(plant)[1]) if kind == "PID" else 0.0
    kp, ki = _proven(proving, *best(td), proving.shape(td, alpha), rank)
    if not (ki > 0 and np.isfinite(ki)):
        raise LoopError(
            f"no integral action keeps these limits for {100 * share:g} % of the plants: allow a higher peak or a "
            "smaller share"
        )
    pid = PID(Kc=sign * kp, Ti=kp / ki, Td=td, alpha=alpha)
    today = max_ki(plant, bounds, kind, alpha)
    return UncertainTuning(
        pid=pid,
        nominal=today,
        share=share,
        confidence=confidence,
        nominal_share=float(np.mean(holds(structure, p[half:], today, bounds))),
        price=1 - pid.parallel[1] / today.parallel[1],
    )


def _proven(discs: Discs, kp: float, ki: float, shape: ComplexArray, rank: int) -> tuple[float, float]:
    """The fastest of these settings, slowed down step by step, that no more than `rank` plants fail; ki 0 if none.

    The steps are tested from the slowest on and the first failure ends it, so that testing many costs no
    confidence (fixed sequence). Slowing down keeps the damping: kp falls with the factor and ki with its square.
    """
    proven, edge = 0.0, discs.proportional_limit(shape)
    for factor in levels.ONE_ELEMENT_SLOWDOWNS:
        slower = kp * factor
        holding = (edge > slower) & (discs.integral_limit(shape, slower) >= ki * factor**2 * (1 - levels.ROUNDING))
        if np.sum(~holding) > rank:
            break
        proven = float(factor)
    return kp * (proven or 1.0), ki * proven**2


def most_failures(count: int, share: float, confidence: float) -> int:
    """The most failures among `count` plants that still prove the share with that confidence."""
    from scipy.stats import binom

    # if a smaller share held, k failures or fewer would have at most the probability P(Bin(n, 1 - share) <= k)
    k = np.arange(count)
    sure = k[binom.sf(k, count, 1 - share) >= confidence]
    if sure.size == 0:
        needed = 2 * int(np.ceil(np.log(1 - confidence) / np.log(share)))
        raise LoopError(
            f"{2 * count} draws are too few to promise {100 * share:g} % of the plants with a confidence of "
            f"{100 * confidence:g} %: give at least {needed}"
        )
    return int(sure[-1])
