"""All minima of the likelihood that a record leaves open, and what they make of an estimate.

Dead times and lags that can stand for each other, two delayed terms, a lead and a lag: there the likelihood has
several minima of nearly the same depth, and the curvature at the deepest says nothing of the others. The fit is begun
again from many places about itself and about the model. What ends lower is the estimate; what ends higher counts by its
probability in the covariance, and by less than the quantile of the likelihood ratio higher belongs to the interval,
which is the hull of all. How high each is, is asked of all the memories that the noise may have: under slow noise one
may be open that the fit's own noise model takes for closed, or closed that it takes for open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import most_moved, of_a_part
from trueplant.identify.covariance import growth_of, inflated, small_samples
from trueplant.identify.fit import RowFit, refitted
from trueplant.identify.intervals import as_wide_as
from trueplant.identify.likelihood import rise
from trueplant.identify.memory import memory_heights


@dataclass(frozen=True, eq=False)
class OpenMinima:
    """The minima of the likelihood that were found, the deepest first."""

    fits: tuple[RowFit, ...]
    rises: Array
    """(n_minima,) of -2 log likelihood above the deepest; below 0 where the noise may have a memory and it is not."""
    inflated: Array
    """(size, size) covariance at the deepest (`inflated`)."""
    quantile: float
    """Of the normal distribution, for the confidence asked for."""

    @property
    def best(self) -> RowFit:
        return self.fits[0]

    @property
    def factor(self) -> Array:
        """(size,) of the variances, for what is not known of the noise."""
        return growth_of(self.best.covariance, self.inflated)

    @cached_property
    def _widths(self) -> tuple[Array, ...]:
        """(n, n) of each its covariance, within what can be expected: parameters as large as those of the deepest.

        A lag that has grown into an integrator, or a lead that makes up for a gain, leaves a valley without end, and
        that must not make up for its height.
        """
        best = self.best
        size = np.abs(best.theta) + best.row.lag_of_dead_times(best.theta) + np.sqrt(np.diag(best.covariance))
        expected = np.diag(size**2)
        return tuple(expected @ np.linalg.solve(expected + one.covariance, one.covariance) for one in self.fits)

    @property
    def shares(self) -> Array:
        """(n_minima,) probability of each, by its depth and its width (Laplace's approximation)."""
        free = np.ix_(self.best.free, self.best.free)
        weights = (np.array([np.linalg.slogdet(width[free])[1] for width in self._widths]) - self.rises) / 2
        shares = np.exp(weights - weights.max())
        return np.asarray(shares / shares.sum())

    @property
    def added(self) -> Array:
        """(n,) what the other minima add to the variances about the deepest: where they are, and how wide."""
        shifts = np.array([one.theta for one in self.fits]) - self.best.theta
        widths = np.diagonal(self._widths, axis1=1, axis2=2) - np.diag(self._widths[0])
        return np.asarray(self.shares @ (shifts**2 + self.factor * widths))

    def widened(self, covariance: Array) -> Array:
        """The covariance (n, n) with variances that count all minima.

        The way from one to the next is curved: what is the same at all of them would not be known any more if their
        places were joined by straight lines. So parameters follow along the ridge at the deepest, the one that has
        moved furthest first; those of other elements by no more than the minima say.
        """
        before, wanted = np.diag(covariance), np.diag(covariance) + self.added
        element = np.repeat(np.arange(len(self.best.row.slices)), [p.stop - p.start for p in self.best.row.slices])
        for index in np.argsort(-self.added / np.maximum(before, np.finfo(float).tiny)):
            left = np.sqrt(np.maximum(wanted - np.diag(covariance), 0.0))
            furthest = np.where(element == element[index], np.inf, left)
            covariance = as_wide_as(covariance, int(index), float(wanted[index]), furthest)
        return covariance

    def hull(self, intervals: Array, shift: Array) -> Array:
        """(n, 2) intervals that hold those of the other minima too, shifted by as much as the estimate is (n,).

        These end where the likelihood, by its curvature there, has risen by the quantile, from the deepest on.
        """
        low, high = self.best.row.limits()
        out = intervals.copy()
        left = self.quantile**2 - np.maximum(self.rises, 0.0)
        for one, depth in zip(self.fits[1:], left[1:], strict=True):
            if depth <= 0:
                continue
            reach = np.sqrt(depth * self.factor * np.diag(one.covariance))
            out[:, 0] = np.minimum(out[:, 0], np.maximum(one.theta + shift - reach, low))
            out[:, 1] = np.maximum(out[:, 1], np.minimum(one.theta + shift + reach, high))
        return out

    def as_far_as_apart(self, covariance: Array) -> Array:
        """The covariance (n, n) with standard errors no smaller than the minima in the interval are apart."""
        inside = [one.theta for one, risen in zip(self.fits, self.rises, strict=True) if risen < self.quantile**2]
        furthest = np.abs(np.array([self.best.theta, *inside]) - self.best.theta).max(axis=0) / self.quantile
        for index in np.flatnonzero(furthest > 0):
            covariance = as_wide_as(covariance, int(index), float(furthest[index]) ** 2, furthest)
        return covariance


def open_minima(fit: RowFit, confidence: float) -> OpenMinima:
    """The minima found from many starts.

    Where the first of them all end in one, no second one is expected (Boender and Rinnooy Kan 1987). In a long record
    they are looked for in that part of it in which the inputs move most.
    """
    part = of_a_part(fit)
    like = _with_lags_in_order(fit)
    starts = _starts(part)
    found = distinct([_labelled(part, like), *(_ended(part, start, like) for start in starts[: levels.MINIMA_ALIKE])])
    if len(found) > 1:
        found = distinct([*found, *(_ended(part, start, like) for start in starts[levels.MINIMA_ALIKE :])])
    # Along a flat valley the steps are short: what is still on its way is no minimum yet.
    found = distinct([one if one.converged else _ended(one, one.theta, like) for one in found])
    if part is not fit:
        others = [_ended(fit, one.theta, like) for one in found[: levels.MINIMA_POLISHED]]
        found = distinct([_labelled(fit, like), *others])
    # The memories are not gone through for those that are so high that their probability is 0 in any case.
    found = [one for one in found if np.exp(-rise(found[0], one) / 2) > 0]
    wide, quantile = inflated(found[0], confidence), float(norm.ppf(0.5 + confidence / 2))
    rises = np.zeros(1) if len(found) == 1 else _rises(found, growth_of(found[0].covariance, wide), confidence)
    return OpenMinima(tuple(found), rises, wide, quantile)


def _rises(fits: Sequence[RowFit], factor: Array, confidence: float) -> Array:
    """`OpenMinima.rises`; of a long record, which is not gone through for each memory, less by the mean `factor`."""
    best = fits[0]
    if most_moved(best.row) is not best.row:
        return np.array([rise(best, one) for one in fits]) / float(factor[best.free].mean())
    heights = memory_heights(fits)
    return np.asarray((heights - heights[0]) / float(small_samples(best, confidence)[best.free].mean()))


def _starts(fit: RowFit) -> list[Array]:
    """The model, and places drawn about the fit and about the model."""
    low, high = fit.row.bounds()
    centres = [fit.theta]
    models = [spec.initial for spec in fit.row.specs if spec.initial is not None]
    if len(models) == len(fit.row.specs):
        centres.append(np.concatenate([np.array(model, dtype=float) for model in models]))
    rng = np.random.default_rng(levels.MINIMA_SEED)
    drawn = [
        centre * np.exp(levels.MINIMA_SPREAD * rng.standard_normal(centre.size))
        for _ in range(levels.MINIMA_STARTS // len(centres))
        for centre in centres
    ]
    return [np.where(fit.free, np.clip(start, low, high), fit.theta) for start in (*centres[1:], *drawn)]


def _ended(fit: RowFit, theta: Array, like: Array) -> RowFit:
    """Where a fit of the same row that begins elsewhere ends."""
    return _labelled(refitted(fit, theta, fit.free), like)


def _labelled(fit: RowFit, like: Array) -> RowFit:
    """The fit with its lags, leads, pairs and delayed terms in the order that they have in `like` (size,).

    Where two of them have changed places, the plant is the same.
    """
    theta = fit.theta.copy()
    for spec, part in zip(fit.row.specs, fit.row.slices, strict=True):
        own, there = (spec.structure.interchanged(p[part]) for p in (fit.theta, like))
        theta[part.start + there] = fit.theta[part.start + own]
    return fit if np.array_equal(theta, fit.theta) else refitted(fit, np.where(fit.free, theta, fit.theta), fit.free)


def _with_lags_in_order(fit: RowFit) -> Array:
    """(size,) its parameters, the longest lag of each element first."""
    parts = zip(fit.row.specs, fit.row.slices, strict=True)
    return np.concatenate([fit.theta[part][spec.structure.sorted(fit.theta[part])] for spec, part in parts])


def distinct(fits: Sequence[RowFit]) -> list[RowFit]:
    """The fits, deepest first, without those that are within their standard errors of a deeper one."""
    kept: list[RowFit] = []
    for fit in sorted(fits, key=lambda one: one.cost):
        sigma = np.sqrt(np.diag(fit.covariance))
        if all(np.any(np.abs(fit.theta - one.theta)[fit.free] > sigma[fit.free]) for one in kept):
            kept.append(fit)
    return kept
