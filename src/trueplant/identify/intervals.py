"""Confidence intervals: from the covariance, and from the profile of the likelihood where that misleads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.estimate import free_of_noise
from trueplant.identify.fit import RowFit, refitted
from trueplant.identify.likelihood import rise
from trueplant.identify.row import Row


def normal_intervals(row: Row, theta: Array, covariance: Array, confidence: float) -> Array:
    """(n, 2) intervals theta -+ z sigma, within the limits of the row's parameters."""
    half = norm.ppf(0.5 + confidence / 2) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    low, high = row.limits()
    return np.asarray(np.clip(np.column_stack([theta - half, theta + half]), low[:, None], high[:, None]))


class End(NamedTuple):
    """Where the profile likelihood of one parameter ends on one side."""

    value: float
    seen: float
    """The furthest value that was looked at and belongs to the interval: the end itself, where there is one."""
    fitted: RowFit
    """The fit held there."""


@dataclass(frozen=True, eq=False)
class Profile:
    """What the profile likelihood says of one parameter."""

    fit: RowFit
    sides: tuple[End, End]
    """Below and above."""
    quantile: float
    """Of the normal distribution, for the confidence."""

    @property
    def ends(self) -> tuple[float, float]:
        """The interval."""
        return self.sides[0].value, self.sides[1].value

    @property
    def furthest(self) -> Array:
        """(n,) by how much the parameters have moved at the further end, over the quantile: as standard errors."""
        moved = np.array([side.fitted.theta - self.fit.theta for side in self.sides])
        return np.asarray(np.abs(moved).max(axis=0) / self.quantile)

    def reach(self, ends: tuple[float, float], shift: float) -> tuple[float, float]:
        """The interval with these ends; where it has none, as far as was looked, shifted as they are."""
        low, high = (end if np.isfinite(end) else side.seen + shift for end, side in zip(ends, self.sides, strict=True))
        return low, high


def profiled(fit: RowFit) -> list[int]:
    """Dead times, and parameters that are known poorly but not hopelessly; none where all that is left is rounding."""
    if free_of_noise(fit):
        return []
    chosen = []
    sigma = np.sqrt(np.diag(fit.covariance))
    for index in np.flatnonzero(~fit.row.is_gain):
        relative = sigma[index] / max(abs(fit.theta[index]), 1e-300) if fit.free[index] else levels.PROFILED
        if (fit.row.is_dead_time[index] or relative > levels.PROFILED) and relative < levels.HOPELESS_ERROR:
            chosen.append(int(index))
    return chosen


def profile_of(fit: RowFit, index: int, confidence: float, factor: float = 1.0, rounds: int = 6) -> Profile:
    """Interval of theta[index] from the profile likelihood.

    The end points are where the deviance, minimised over everything else, has risen by `factor` times the chi-square
    quantile (Venzon and Moolgavkar 1988). An end that is not found as far as is looked (`_reach`), or lies beyond the
    parameter's bound, is the bound; one that is not found to PROFILE_TOLERANCE is a value beyond it.

    A dead time of several delayed terms has the hull of all places where the deviance is below that: where its term may
    have no gain, it may be anything.
    """
    quantile = float(norm.ppf(0.5 + confidence / 2))
    z = quantile * float(np.sqrt(factor))
    sides = []
    for side in (-1, 1):
        end = _end(fit, index, side, z, rounds)
        sides.append(_furthest(fit, index, side, z, end) if _of_several(fit, index) else end)
    return Profile(fit, (sides[0], sides[1]), quantile)


def as_wide_as(covariance: Array, index: int, variance: float, furthest: Array) -> Array:
    """The covariance with the variance of one parameter raised to at least this.

    The others follow along the ridge of the likelihood, none by more than `furthest` (n,), which is how far it was
    seen to go: what is known of them together with this one stays known. As the variance is added, nothing that is
    known of others, this one given, is narrower than it was.
    """
    own = float(covariance[index, index])
    more = np.sqrt(max(variance - own, 0.0))
    step = np.clip(covariance[:, index] / max(own, np.finfo(float).tiny) * more, -furthest, furthest)
    step[index] = more
    return np.asarray(covariance + np.outer(step, step))


def variance_of(ends: tuple[float, float], value: float, confidence: float) -> float:
    """The variance that an interval says, by its longer side, as the other may end at a bound.

    A dead time has a minimum of its own in every sample interval, and the curvature in one of them says little about
    how far away the others are.
    """
    longest = max(value - ends[0], ends[1] - value)
    return float(longest / norm.ppf(0.5 + confidence / 2)) ** 2


def widened(ends: Sequence[float] | Array, value: float, variance: float, confidence: float) -> tuple[float, float]:
    """An interval with further, independent variance added to each side; an end at a bound of 0 stays there."""
    extra = norm.ppf(0.5 + confidence / 2) ** 2 * variance
    low = value - np.sqrt((value - ends[0]) ** 2 + extra)
    high = value + np.sqrt((ends[1] - value) ** 2 + extra)
    return (max(float(low), 0.0) if ends[0] >= 0 else float(low)), float(high)


@dataclass(frozen=True, eq=False)
class Mixture:
    """Estimates where theta may be larger by each of several shifts.

    Mixtures of normals, one on each side of theta, as wide as the intervals say and wider.
    """

    intervals: Array
    """(n, 2)"""
    theta: Array
    """(n,)"""
    shifts: Array
    """(m, n)"""
    shares: Array
    """(m,) Their probabilities."""
    confidence: float
    """Of the intervals."""
    variances: Array
    """(m, n) By which each is wider."""

    @property
    def ends(self) -> Array:
        """(n, 2) intervals; the same where one is without end."""
        tail = (1 - self.confidence) / 2
        low, high = self._quantiles(tail), self._quantiles(1 - tail)
        known = np.isfinite(low + high)
        return np.column_stack(
            [np.where(known, side, own) for side, own in zip((low, high), self.intervals.T, strict=True)]
        )

    @property
    def medians(self) -> Array:
        """(n,) theta where its interval is without end."""
        found = self._quantiles(0.5)
        return np.where(np.isfinite(found), found, self.theta)

    def _quantiles(self, share: float) -> Array:
        """(n,) by bisection; nan where an interval is without end."""
        z = norm.ppf(0.5 + self.confidence / 2)
        widths = np.maximum(np.abs(self.intervals - self.theta[:, None]).T / z, np.sqrt(np.finfo(float).tiny))
        below, above = np.hypot(widths[:, None], np.sqrt(self.variances))
        finite = np.isfinite(below + above).all(axis=0)
        centres, furthest = self.theta + self.shifts, max(z, abs(norm.ppf(share)))
        low, high = (centres - furthest * below).min(axis=0), (centres + furthest * above).max(axis=0)
        low, high = np.where(finite, low, 0.0), np.where(finite, high, 0.0)
        rounding = 4 * np.finfo(float).eps * (high - low)
        for _ in range(np.finfo(float).nmant):
            middle = (low + high) / 2
            from_each = middle - centres
            short = self.shares @ norm.cdf(from_each / np.where(from_each < 0, below, above)) < share
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        found = (low + high) / 2
        found = np.where(np.abs(found - self.theta) <= rounding, self.theta, found)
        return np.where(finite, found, np.nan)


class _Place(NamedTuple):
    """One place of the profile."""

    distance: float
    """From the estimate."""
    root: float
    """Of what -2 log likelihood has risen by."""
    fitted: RowFit


def _end(fit: RowFit, index: int, side: int, z: float, rounds: int) -> End:
    """The first end on one side: steps outwards until the likelihood has fallen enough, then between the last two."""
    centre, sigma = float(fit.theta[index]), float(np.sqrt(fit.covariance[index, index]))
    bound, limit = (float(of[side > 0][index]) for of in (fit.row.bounds(), fit.row.limits()))
    furthest = min(_reach(fit, index), abs(bound - centre))
    if not np.isfinite(furthest) or furthest <= 0:
        return End(limit, centre if np.isinf(limit) else limit, fit)

    def place(distance: float, begun: RowFit) -> _Place:
        held = _constrained(fit, index, centre + side * distance, begun)
        return _Place(distance, float(np.sqrt(rise(fit, held))), held)

    # The curvature says nothing of a dead time in the next sample interval.
    beyond = fit.row.pieces[0].h * fit.row.stride if fit.row.is_dead_time[index] else 0.0
    inside = _Place(0.0, 0.0, fit)
    outside = place(min(z * sigma, furthest), fit)
    while outside.root < z:
        inside, value = outside, centre + side * outside.distance
        if inside.distance >= furthest:
            return End(limit, value, inside.fitted)
        grown = inside.distance * max(1.2, min(2.0, z / max(inside.root, 0.1)))
        outside = place(min(max(grown, inside.distance + beyond), furthest), inside.fitted)
    nearest = min(inside, outside, key=lambda one: abs(one.root - z))
    for _ in range(rounds):
        if abs(nearest.root - z) < levels.PROFILE_TOLERANCE * z:
            break
        share = (z - inside.root) / max(outside.root - inside.root, 1e-12)
        distance = inside.distance + min(max(share, 0.05), 0.95) * (outside.distance - inside.distance)
        nearest = place(distance, inside.fitted)
        inside, outside = (nearest, outside) if nearest.root < z else (inside, nearest)
    else:
        nearest = outside
    value = centre + side * nearest.distance
    return End(value, value, nearest.fitted)


def _reach(fit: RowFit, index: int) -> float:
    """How far from the estimate an end is looked for: PROFILE_FURTHEST standard errors.

    The standard error of a dead time knows of one sample interval alone: that is looked for as far as its element takes
    to answer at least.
    """
    reach = levels.PROFILE_FURTHEST * float(np.sqrt(fit.covariance[index, index]))
    if not fit.row.is_dead_time[index]:
        return reach
    m = fit.row.element_of(index)
    return max(reach, float(fit.theta[index] + fit.row.lag(m, fit.theta[fit.row.slices[m]])))


def _of_several(fit: RowFit, index: int) -> bool:
    """Is it the dead time of one of several delayed terms?"""
    return bool(fit.row.is_dead_time[index]) and fit.row.specs[fit.row.element_of(index)].structure.delayed > 1


def _furthest(fit: RowFit, index: int, side: int, z: float, first: End) -> End:
    """The last end within reach: of several valleys, or of a likelihood that is flat far away."""
    centre, bound = float(fit.theta[index]), float(fit.row.bounds()[side > 0][index])
    distance = min(_reach(fit, index), abs(bound - centre))
    if side * (first.value - bound) >= 0 or distance <= abs(first.value - centre):
        return first
    outside, outside_root = bound, np.inf
    for value in np.linspace(centre + side * distance, first.value, levels.PROFILE_PLACES, endpoint=False):
        fitted = _constrained(fit, index, float(value), fit)
        root = float(np.sqrt(rise(fit, fitted)))
        if root < z:
            share = (z - root) / (outside_root - root)
            end = float(value + share * (outside - value)) if np.isfinite(outside_root) else outside
            return End(end, float(value) if np.isinf(end) else end, fitted)
        outside, outside_root = float(value), root
    return first


def _constrained(fit: RowFit, index: int, value: float, begun: RowFit) -> RowFit:
    """The fit with theta[index] at a value, the others free and starting where they are in the one that is `begun`.

    They are not moved along the ridge first: what the data do not determine would be thrown far off by it. Where two
    lags would change places, which leads to the same plants again, both are held.
    """
    theta, free = begun.theta.copy(), fit.free.copy()
    theta[index], free[index] = value, False
    found = refitted(begun, theta, free)
    passed = _lags_passed(fit, found, index)
    if not passed.any():
        return found
    theta = np.where(passed, value, found.theta)
    return refitted(found, theta, free & ~passed)


def _lags_passed(fit: RowFit, found: RowFit, index: int) -> BoolArray:
    """(size,) other lags of the element of theta[index] that are on another side of it than in the fit."""
    if not fit.row.is_lag[index]:
        return np.zeros(fit.theta.size, dtype=bool)
    part = fit.row.slices[fit.row.element_of(index)]
    own = np.zeros(fit.theta.size, dtype=bool)
    own[part] = fit.row.is_lag[part]
    before, after = fit.theta - fit.theta[index], found.theta - found.theta[index]
    return np.asarray(own & fit.free & (before * after < 0))
