"""The elements of one output, estimated with everything that says how far they can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial

import numpy as np

from trueplant.arrays import Array, IntArray
from trueplant.identify import levels
from trueplant.identify.between_experiments import Runs, compare_runs
from trueplant.identify.blocks import in_blocks
from trueplant.identify.budget import Budget
from trueplant.identify.covariance import small_samples
from trueplant.identify.dead_times import without_unseen_dead_times
from trueplant.identify.estimate import Options, estimate_row
from trueplant.identify.fit import RowFit
from trueplant.identify.intervals import (
    Mixture,
    as_wide_as,
    normal_intervals,
    profile_of,
    profiled,
    variance_of,
    widened,
)
from trueplant.identify.joint import JointRise
from trueplant.identify.joint_plant import JointPlant
from trueplant.identify.likelihood import at_model, held_at, ratio_p, rise, without_element
from trueplant.identify.minima import OpenMinima, open_minima
from trueplant.identify.noise_order import order_dependence
from trueplant.identify.pieces import Held, pieces_of
from trueplant.identify.row import Row, Spec
from trueplant.identify.sandwich import sandwich_covariance, uneven
from trueplant.identify.strides import Sampling
from trueplant.identify.unanswered import Unanswered, WhyUnanswered
from trueplant.identify.uncounted import parts_uncounted
from trueplant.identify.validate import ResidualTests, Validation, residual_tests, validate
from trueplant.lti.structure import Structure
from trueplant.record.types import Segment
from trueplant.result.budget import Source


@dataclass(frozen=True)
class Rejected:
    """The structure of an element that the record rejects."""

    structure: Structure
    p_value: float
    """That it suffices: with what a search over all elements and structures finds in noise taken off."""


@dataclass(frozen=True, eq=False)
class OutputEstimate:
    """One output: parameters, covariance and intervals, and what limits them."""

    output: int
    fit: RowFit
    theta: Array
    """(size,)"""
    covariance: Array
    """(size, size)"""
    uncounted: Mapping[Source, Array]
    """(size, size) each: parts of it that no likelihood counts, whatever noise it takes, and none is spared."""
    budget: Budget
    """What the variances in it are made of."""
    intervals: Array
    """(size, 2); infinite where nothing is known."""
    runs: Runs | None
    order_dependence: Mapping[int, Unanswered]
    """Parameters that another order of the noise model moves by more than chance and more than a third."""
    tests: ResidualTests
    validation: Validation | None
    halves: Runs | None = None
    """How far the halves of one experiment differ, where no structure describes the plant (`halves`)."""
    predicted_by: tuple[int, ...] = ()
    """Other outputs whose past prediction errors predict this one's (`shared_disturbance`); the covariance knows."""
    unprofiled: Array | None = None
    """The covariance before it was widened to the profile intervals: wider single parameters would misstate strong
    correlations between them. Joint tests use this one beside the likelihood ratio; None: `covariance` itself."""
    beside_ratio: Array | None = None
    """`unprofiled` without what likelihood ratios count by themselves: other minima, and what another noise model says
    (`longest_noise`). None: with it."""
    factor: Array = field(default_factory=lambda: np.ones(1))
    """(size,) of the variances, for what the record does not say of the noise (`inflation`)."""
    ratio_factor: Array = field(default_factory=lambda: np.ones(1))
    """(size,) of likelihood ratios, for what is not known of an autoregression (`small_samples`): what noise that
    remembers longer could explain is for the largest noise model to say."""
    freedom: Callable[[IntArray], float] | None = None
    """Degrees of freedom of the noise for a test of theta[index], which make F-tests of likelihood ratios; None:
    `ratio_factor` counts them."""
    jointly: bool = False
    """Was it estimated with all outputs together (`joint`)? Then `fit` is still the fit of this output alone."""
    open_valves: Callable[[RowFit | JointPlant], float] | None = None
    """By how much -2 log likelihood of a fit falls where valves that may not follow OP do as is likeliest beside it."""
    rise: Callable[[IntArray, Array], float] | None = None
    """The likelihood that belongs to theta: by how much -2 log likelihood rises when theta[index] is held at values and
    the others are free. None: that of `fit`."""
    withheld: Mapping[int, Unanswered] = field(default_factory=dict)
    """Parameters that are not given for reasons that are not in the fit."""
    refuted: Unanswered | None = None
    """Why nothing of it is given: the record speaks against it (`gate`)."""
    structure_p: Array = field(default_factory=lambda: np.ones(0))
    """(n_columns,) p-value that the structure of each element suffices; empty: not tested."""
    rejected: Mapping[int, Rejected] = field(default_factory=dict)
    """By column: structures that did not suffice and were replaced."""
    kept: tuple[int, ...] = ()
    """Columns whose structures do not suffice either, and were kept as they were asked for (`kept_structures`)."""

    @property
    def undermodelled(self) -> bool:
        """Is the structure simpler than what the prediction errors show of the plant?"""
        return bool(min(np.min(self.cross_p), np.min(self.structure_p, initial=1.0)) < levels.UNDERMODELLED)

    @property
    def cross_p(self) -> Array:
        """(n_columns,) that the prediction errors, of single experiments if there are more, follow no input."""
        return self.tests.cross_p if self.runs is None else self.runs.cross_p

    @property
    def row(self) -> Row:
        return self.fit.row

    @property
    def uneven(self) -> bool:
        """Do the prediction errors change their size, or is colour left in them?"""
        return uneven(self.tests)

    def likelihood_ratio_p(self, index: IntArray, values: Array, doubting: bool = False, enough: float = 0.0) -> float:
        """p-value that the parameters theta[index] have these values, by the likelihood that belongs to theta.

        `doubting`: with all the others sought from their model as well, and whatever valves may do. Below `enough` it
        need not be known: what valves gain beside theta would only lower it, and is not looked for.
        """
        held = cache(partial(self._held_at, index, values, doubting))
        return self._restricted_p(held, index, values, len(index), enough if doubting else None)

    def absence_p(self, m: int, doubting: bool = False, enough: float = 0.0) -> float:
        """p-value that element m of the row is absent, likewise."""
        part = self.row.slices[m]
        index, none = np.arange(part.start, part.stop), np.where(self.row.is_gain, 0.0, self.theta)[part]
        without, freedom = cache(partial(without_element, self.fit, m)), levels.SEARCHED_FREEDOM + index.size
        return self._restricted_p(without, index, none, freedom, enough if doubting else None)

    def _restricted_p(
        self, held: Callable[[], RowFit], index: IntArray, values: Array, freedom: int, enough: float | None
    ) -> float:
        """That of theta[index] at values, with the fit of this output alone `held` there; None: not doubting."""
        there: Callable[[], RowFit | JointPlant] = held
        if isinstance(self.rise, JointRise):
            there = cache(partial(self.rise.held, index, values))
            risen = self.rise.of(there())
        else:
            risen = rise(self.fit, held()) if self.rise is None else self.rise(index, values)
        if enough is None or self.open_valves is None:
            return self._ratio_p(index, risen, freedom)
        risen -= self.open_valves(there())
        p = self._ratio_p(index, risen, freedom)
        return p if p < enough else self._ratio_p(index, risen + self._gained_by_valves, freedom)

    def _held_at(self, index: IntArray, values: Array, doubting: bool) -> RowFit:
        every = (self.fit, at_model(self.fit)) if doubting else (self.fit,)
        return min((held_at(fit, index, values) for fit in every), key=lambda one: one.deviance)

    @cached_property
    def _gained_by_valves(self) -> float:
        there = self.rise.end if isinstance(self.rise, JointRise) else self.fit
        return 0.0 if self.open_valves is None else self.open_valves(there)

    def _ratio_p(self, index: IntArray, risen: float, freedom: int) -> float:
        if self.rise is not None:
            return ratio_p(risen, freedom)
        left = np.inf if self.freedom is None else self.freedom(index)
        return ratio_p(risen / float(self.ratio_factor[index].mean()), freedom, left)

    def without_answers(self, why: WhyUnanswered, text: str) -> OutputEstimate:
        """The same estimate, refuted: no parameter and no structure of it is given."""
        return replace(self, refuted=Unanswered(why, text), rejected={})

    def moved(self, shift: Array) -> OutputEstimate:
        """The same estimate at parameters larger by `shift` (size,), as sure of them."""
        low, high = self.row.limits()
        theta, intervals = self.theta + shift, self.intervals + shift[:, None]
        return replace(self, theta=np.clip(theta, low, high), intervals=np.clip(intervals, low[:, None], high[:, None]))

    @property
    def disputed(self) -> bool:
        """Do the experiments disagree?"""
        return self.runs is not None and not self.runs.agree


def identify_output(
    segments: Sequence[Segment],
    output: int,
    specs: Sequence[Spec],
    held: Sequence[Held] = (),
    *,
    confidence: float = 0.95,
    sampling: Sampling | None = None,
    time_scale: float | None = None,
    options: Options | None = None,
) -> OutputEstimate | None:
    """Estimate the elements `specs` of one output; None where this output has no usable data.

    Time unit and shapes are those of the segments. `held` elements are fixed at their declared value. `time_scale` is
    the initial guess of the lags of elements that the model lacks.
    """
    sampling = sampling or Sampling()
    row = row_of(segments, output, specs, held, sampling)
    if row is None:
        return None
    time_scale = time_scale or row.guessed_time_scale
    full, minima = _fitted(estimate_row(row, time_scale, options), confidence)
    fit = minima.best
    if fit.count <= fit.row.nuisance_count:
        return None
    tests, factor = residual_tests(fit, confidence), minima.factor
    runs = compare_runs(fit, factor)
    # A dead time that was left out may be there, too small to be seen: then the others are as the fit with it has them.
    left_out = np.where(fit.free, full.theta - fit.theta, 0.0)
    uncounted = parts_uncounted(fit, runs, left_out, sampling, segments)
    more, budget = _beyond_likelihood(fit, minima.inflated, uncounted)
    shift = np.zeros(row.size) if runs is None else runs.shift
    theta, covariance = np.clip(fit.theta + shift, *row.bounds()), minima.inflated + more
    alone, follows = ([fit], tests.cross_p) if runs is None else (runs.fits, runs.cross_p)
    moved, shifts = order_dependence(fit, covariance, follows, alone)
    added = np.zeros_like(covariance)
    for source, variances in (
        (Source.NOISE_MODEL, np.outer(shifts, shifts)),  # how far another one moves a parameter counts as its error
        (Source.LEFT_OUT, uncounted[Source.LEFT_OUT]),
        (Source.ROUNDING, uncounted[Source.ROUNDING]),
    ):
        added, budget = added + variances, budget.including(source, variances)
    covariance = covariance + added
    unprofiled = minima.widened(covariance)
    beside_ratio = fit.covariance + more + uncounted[Source.LEFT_OUT] + uncounted[Source.ROUNDING]
    covariance, budget = unprofiled, budget.including(Source.MINIMA, unprofiled - covariance)
    intervals, covariance = _intervals(minima, full, theta, shift, covariance, added + more, confidence)
    return OutputEstimate(
        output=output,
        fit=fit,
        theta=theta,
        covariance=covariance,
        uncounted=uncounted,
        budget=budget.including(Source.PROFILE, covariance - unprofiled),
        intervals=intervals,
        runs=runs,
        order_dependence=moved,
        tests=tests,
        validation=validate(fit),
        unprofiled=unprofiled,
        beside_ratio=beside_ratio,
        factor=factor,
        ratio_factor=small_samples(fit, confidence),
    )


def row_of(
    segments: Sequence[Segment], output: int, specs: Sequence[Spec], held: Sequence[Held], sampling: Sampling
) -> Row | None:
    """The row of an output; None where there is nothing to estimate, or PV does not move."""
    pieces = pieces_of(segments, output, held, sampling.update)
    if not specs or not any(piece.spread for piece in pieces):
        return None
    if sampling.block is not None:
        pieces = in_blocks(pieces, sampling.block, sampling.stride)
    per_look = max(sampling.stride // sampling.update, 1) if any(segment.closed for segment in segments) else 1
    return Row(tuple(specs), pieces, sampling.stride, per_look=per_look)


def _beyond_likelihood(fit: RowFit, inflated: Array, uncounted: Mapping[Source, Array]) -> tuple[Array, Budget]:
    """What neither the curvature of the likelihood nor its profiles count (size, size), and the budget with it."""
    plain = fit.covariance
    budget = Budget.of(plain).including(Source.SLOW_NOISE, inflated - plain)
    colour = sandwich_covariance(fit) - plain
    counted = {source: uncounted[source] for source in (Source.START, Source.EXPERIMENTS) if source in uncounted}
    for source, one in {Source.START: plain, Source.COLOUR: colour, **counted}.items():
        budget = budget.including(source, one)
    return sum(counted.values(), colour), budget


def _intervals(
    minima: OpenMinima, full: RowFit, theta: Array, shift: Array, covariance: Array, beyond: Array, confidence: float
) -> tuple[Array, Array]:
    """Intervals (size, 2), and the covariance with standard errors as large as the likelihood's valleys are wide.

    `beyond` (size, size) is what profiles do not count.
    """
    fit, profiles = minima.best, {}
    for index in profiled(fit):
        # A dead time that is fixed at 0 may still be as large as the data allow.
        own = fit if fit.free[index] else full
        profile = profile_of(own, index, confidence, float(minima.factor[index]))
        ends, value = np.add(profile.ends, shift[index]), float(theta[index])
        profiles[index] = low, high = widened(ends, value, beyond[index, index], confidence)
        variance = variance_of(profile.reach((low, high), shift[index]), value, confidence)
        covariance = as_wide_as(covariance, index, variance, profile.furthest)
    intervals = normal_intervals(fit.row, theta, covariance, confidence)
    for index, both in profiles.items():
        intervals[index] = both
    return minima.hull(intervals, shift), minima.as_far_as_apart(covariance)


def _fitted(found: RowFit, confidence: float) -> tuple[RowFit, OpenMinima]:
    """The deepest minimum, and the minima where dead times that neither model nor record shows are fixed at 0."""
    minima = open_minima(found, confidence)
    fit = without_unseen_dead_times(minima.best)
    return minima.best, minima if fit is minima.best else open_minima(fit, confidence)


def averaged(
    estimate: OutputEstimate,
    shifts: Array,
    shares: Array,
    confidence: float,
    source: Source,
    spreads: Array | None = None,
) -> OutputEstimate:
    """The estimate, where theta may be larger by each of `shifts` (m, size) with the probabilities `shares` (m,).

    Each is known that much less well: by `spreads` (m, size, size). `source` is what leaves that open. The estimate
    stays in its interval, whatever the probabilities are.
    """
    spreads = np.zeros((*shifts.shape, shifts.shape[1])) if spreads is None else spreads
    more = (shifts.T * shares) @ shifts + np.tensordot(shares, spreads, axes=1)
    low, high = estimate.row.limits()
    variances = np.maximum(np.diagonal(spreads, axis1=1, axis2=2), 0.0)  # differences: rounding may leave them below
    ends = Mixture(estimate.intervals, estimate.theta, shifts, shares, confidence, variances).ends
    ends = np.column_stack([np.minimum(ends[:, 0], estimate.theta), np.maximum(ends[:, 1], estimate.theta)])
    return replace(
        estimate,
        covariance=estimate.covariance + more,
        budget=estimate.budget.including(source, more),
        unprofiled=None if estimate.unprofiled is None else estimate.unprofiled + more,
        beside_ratio=None if estimate.beside_ratio is None else estimate.beside_ratio + more,
        intervals=np.clip(ends, low[:, None], high[:, None]),
    )


def at_median(
    estimate: OutputEstimate, shifts: Array, shares: Array, confidence: float, source: Source
) -> OutputEstimate:
    """`averaged`, about the median of each parameter, where the record says how probable each of the shifts is.

    Unlike a mean it lies near places that are probable, however far off another one is. What is at a limit
    stays there.
    """
    low, high = estimate.row.limits()
    between = (low < estimate.theta) & (estimate.theta < high)
    medians = Mixture(estimate.intervals, estimate.theta, shifts, shares, confidence, np.zeros_like(shifts)).medians
    moved = estimate.moved(np.where(between, medians - estimate.theta, 0.0))
    return averaged(moved, shifts - (moved.theta - estimate.theta), shares, confidence, source)
