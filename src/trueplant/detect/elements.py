"""From the estimates of all outputs to a verdict on each element."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from trueplant.arrays import Array
from trueplant.detect import levels
from trueplant.detect.detectable import detectable_change, worth_knowing_of
from trueplant.detect.verdict import Evidence, Verdict, judge, level_of
from trueplant.identify import (
    Budget,
    OutputEstimate,
    Rejected,
    Spec,
    Unanswered,
    WhyUnanswered,
    estimate_beside_longest_noise,
    identify_matrix,
    specs_of,
    unanswered,
)
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.lti.structure import structure_of
from trueplant.record import Segment


@dataclass(frozen=True, eq=False)
class Found:
    """One estimated element, cut out of the estimate of its output."""

    spec: Spec
    theta: Array
    covariance: Array
    joint: Array
    """The covariance for tests of the whole: without the widening of single parameters by their profiles, which
    stretches strong correlations and which the likelihood ratio makes up for."""
    beside_ratio: Array
    """`joint` without what likelihood ratios count by themselves (`OutputEstimate.beside_ratio`)."""
    covariance_by_data: Array
    """What the record alone says, without the prior: very large where it says nothing."""
    intervals: Array
    lag: float
    """How long it takes to answer, of an integrator too (`Row.lag`)."""
    reasons: Mapping[int, Unanswered]
    """Parameters that are not answered, by their place in theta."""
    model: tuple[float | None, ...]
    budget: Budget
    """What the variances in the covariance are made of."""
    rejected: Rejected | None = None
    """The structure that the record rejects, in favour of that of `spec`; None where it suffices."""
    of_model: Array | None = None
    """Covariance of what the model says of each parameter, where it was itself measured; None where it is exact."""

    @property
    def for_tests(self) -> Found:
        """With the covariances of the difference to the model."""
        if self.of_model is None:
            return self
        more = self.of_model
        joint, beside = self.joint + more, self.beside_ratio + more
        return replace(self, covariance=self.covariance + more, joint=joint, beside_ratio=beside)


def elements_found(
    model: TransferMatrix,
    estimates: Mapping[int, OutputEstimate],
    of_model: Mapping[tuple[int, int], Array] | None = None,
) -> dict[tuple[int, int], Found]:
    """Each estimated element by its place in the matrix, parameters with tau1 >= tau2 >= ...

    `of_model`: covariances of the model's own parameters, as `structure_of` orders them, where they are not exact.
    """
    found = {}
    for i, estimate in estimates.items():
        reasons = unanswered(estimate)
        joint = estimate.covariance if estimate.unprofiled is None else estimate.unprofiled
        beside = joint if estimate.beside_ratio is None else estimate.beside_ratio
        for m, (spec, part) in enumerate(zip(estimate.row.specs, estimate.row.slices, strict=True)):
            order = spec.structure.sorted(estimate.theta[part])
            index = part.start + order
            found[i, spec.column] = Found(
                spec,
                estimate.theta[index],
                estimate.covariance[np.ix_(index, index)],
                joint[np.ix_(index, index)],
                beside[np.ix_(index, index)],
                estimate.fit.covariance_by_data[np.ix_(index, index)],
                estimate.intervals[index],
                estimate.row.lag(m, estimate.theta[part]),
                {k: reasons[int(place)] for k, place in enumerate(index) if int(place) in reasons},
                _model_values(model, i, spec, spec.column in estimate.rejected),
                estimate.budget.at(index),
                estimate.rejected.get(spec.column),
                _of_model(model[i, spec.column], spec, (of_model or {}).get((i, spec.column))),
            )
    return found


def _of_model(system: TransferFunction, spec: Spec, covariance: Array | None) -> Array | None:
    """The covariance of the model's own parameters at their places among those of the element; 0 where it has none."""
    if covariance is None:
        return None
    own, names = structure_of(system)[0].names, spec.structure.names
    here = [names.index(name) for name in own if name in names]
    there = [k for k, name in enumerate(own) if name in names]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(here, here)] = covariance[np.ix_(there, there)]
    return out


def _model_values(model: TransferMatrix, i: int, spec: Spec, rejected: bool) -> tuple[float | None, ...]:
    """What the model says of each parameter; an element that it lacks has no gain and no dynamics.

    Of a structure that was rejected only the gains mean in another one what they meant.
    """
    system = model[i, spec.column]
    if system.is_zero:
        return tuple(0.0 if gain else None for gain in spec.structure.is_gain)
    own, values = structure_of(system)
    known, names = dict(zip(own.names, values, strict=True)), spec.structure.names
    told = [name in known and (gain or not rejected) for name, gain in zip(names, spec.structure.is_gain, strict=True)]
    return tuple(float(known[name]) if ok else None for name, ok in zip(names, told, strict=True))


def judge_elements(
    found: Mapping[tuple[int, int], Found],
    estimates: Mapping[int, OutputEstimate],
    confidence: float = 0.95,
    tolerance_percent: float = 0.0,
    worth_knowing: float = levels.WORTH_KNOWING,
) -> dict[tuple[int, int], Verdict]:
    """The verdict on each element, familywise over all of them: Wald's test and the likelihood have to agree."""
    places = sorted(found)
    found = {place: one.for_tests for place, one in found.items()}
    evidence = []

    @cache
    def longest(i: int) -> OutputEstimate:
        return estimate_beside_longest_noise(estimates[i], confidence)

    for p in places:
        sceptic = partial(longest, p[0])
        other, detectable = _by_likelihood(found[p], estimates[p[0]], sceptic, len(places), level_of(confidence))
        evidence.append(
            Evidence(
                found[p].model,
                found[p].theta,
                found[p].covariance,
                tuple(k not in found[p].reasons for k in range(len(found[p].theta))),
                other,
                found[p].joint,
                detectable,
                None if (rejected := found[p].rejected) is None else rejected.p_value,
                _worth_knowing(found[p], worth_knowing),
                found[p].beside_ratio,
            )
        )
    return dict(zip(places, judge(evidence, confidence, tolerance_percent, worth_knowing), strict=True))


def _by_likelihood(
    found: Found, estimate: OutputEstimate, sceptic: Callable[[], OutputEstimate], elements: int, level: float
) -> tuple[float | None, float]:
    """p-value of the element by the likelihood, and the change that would have been found.

    A change has to show beside the largest noise model as well, unless a disturbance is declared or a joint noise model
    says what is slow: what slow noise does would pass for the plant. Where it does not, that estimate says what would
    have been found.
    """
    detectable = _detectable(estimate, found, elements, level)
    p = _by_one(estimate, found, level, elements)
    if p is None or p >= level or estimate.rise is not None or estimate.predicted_by:
        return p, detectable
    doubted = max(p, _by_one(sceptic(), found, level, elements) or 0.0)
    if doubted < level:
        return doubted, detectable
    part = estimate.row.slices[_place(estimate, found)]
    index = part.start + found.spec.structure.sorted(sceptic().theta[part])
    less = replace(found, theta=sceptic().theta[index], joint=sceptic().covariance[np.ix_(index, index)])
    return doubted, max(detectable, _detectable(estimate, less, elements, level))


def _by_one(estimate: OutputEstimate, found: Found, level: float, elements: int) -> float | None:
    """p-value of the element by one likelihood, which has to hold in doubt."""
    p = _other_p(estimate, found)
    if p is None or p >= level:
        return p
    return max(p, _other_p(estimate, found, doubting=True, enough=level / elements) or 0.0)


def _worth_knowing(found: Found, share: float) -> Array | None:
    """As `worth_knowing_of`; 0 of what is not answered for reasons that are not in the covariance.

    An element whose gain cannot be told from zero has no dynamics to judge, however its covariance may look. Of one
    that the model lacks any gain is worth knowing.
    """
    if _lacking(found):
        return None
    worth = worth_knowing_of(found.spec.structure, found.theta, found.model, share, found.lag)
    in_covariance = (WhyUnanswered.INPUT_STANDS_STILL, WhyUnanswered.TOO_UNCERTAIN)
    worth[[k for k, reason in found.reasons.items() if reason.why not in in_covariance]] = 0.0
    return worth


def _lacking(found: Found) -> bool:
    """Does the model lack the element?"""
    return all(value in (0.0, None) for value in found.model)


def _detectable(estimate: OutputEstimate, found: Found, elements: int, level: float) -> float:
    """What would have been seen; of an element that the model lacks as a share of all that PV does.

    Infinite where another noise model would say something else: that is in no covariance.
    """
    if any(reason.why is WhyUnanswered.DEPENDS_ON_NOISE_MODEL for reason in found.reasons.values()):
        return np.inf
    scale = None
    if _lacking(found):
        piece = max(estimate.row.pieces, key=lambda piece: piece.y.size)
        moves = float(piece.input_spread[found.spec.column])
        scale = piece.spread / moves if moves > 0 else 0.0
    of = found.spec.structure
    return detectable_change(of, found.theta, found.joint, elements, level, found.lag, scale, found.model)


def _other_p(estimate: OutputEstimate, found: Found, doubting: bool = False, enough: float = 0.0) -> float | None:
    """The same question by the likelihood: is the whole element still the model's, is it absent?

    All parameters that the model has are set back at once, answered or not: what is not known by itself would
    otherwise stay where the estimate has put it, and could not be there with the others at their old values.
    """
    m = _place(estimate, found)
    if found.spec.initial is None:
        return estimate.absence_p(m, doubting, enough)
    told = [k for k, value in enumerate(found.model) if value is not None]
    if not told:
        return None
    index = estimate.row.slices[m].start + np.array(told)
    values = np.array([found.model[k] for k in told], dtype=float)
    return estimate.likelihood_ratio_p(index, values, doubting, enough)


def _place(estimate: OutputEstimate, found: Found) -> int:
    """Of the element among those of its output."""
    return next(m for m, spec in enumerate(estimate.row.specs) if spec is found.spec)


def verdicts(
    segments: Sequence[Segment],
    model: TransferMatrix,
    specs: Mapping[tuple[int, int], Spec] | None = None,
    *,
    confidence: float = 0.95,
    tolerance_percent: float = 0.0,
    worth_knowing: float = levels.WORTH_KNOWING,
) -> dict[tuple[int, int], Verdict]:
    """Which elements of the plant are no longer the model's: {(output, input): verdict}, from segments alone.

    `model` (n_y, n_u) in the segments' time unit; `specs` are the elements to estimate, by default all that the
    model has. This is the test that `trueplant run` makes, for Python users and for studies over many records.
    """
    asked = specs_of(model) if specs is None else specs
    estimates = identify_matrix(segments, model, asked, confidence=confidence)
    return judge_elements(elements_found(model, estimates), estimates, confidence, tolerance_percent, worth_knowing)
