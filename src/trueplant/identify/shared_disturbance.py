"""Disturbances that reach several outputs, and what they do to estimates with a noise model for each output.

If a disturbance shows in one output before it reaches another, the controller acts on it in time, and OP is
then correlated with the prediction errors of the other output: the direct fit is biased, and its covariance does
not show it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.budget import Budget
from trueplant.identify.covariance import scaled
from trueplant.identify.fit import RowFit
from trueplant.identify.intervals import normal_intervals, widened
from trueplant.identify.joint import fit_until_white
from trueplant.identify.output import OutputEstimate
from trueplant.identify.portmanteau import correlogram, normal_scores
from trueplant.identify.validate import weighted_errors
from trueplant.result.budget import Source


def predicted_outputs(estimates: Mapping[int, OutputEstimate]) -> dict[int, list[int]]:
    """For each output the others whose past prediction errors predict its own."""
    errors = {i: _by_experiment(found.fit) for i, found in estimates.items()}
    pairs = [(i, j) for i in estimates for j in estimates if i != j]
    found: dict[int, list[int]] = {}
    for i, j in pairs:
        if _relation_p(errors[i], errors[j]) * len(pairs) < levels.SHARED_DISTURBANCE:
            found.setdefault(i, []).append(j)
    return found


def related_at_once(estimates: Mapping[int, OutputEstimate]) -> bool:
    """Are the prediction errors of some outputs related at the same instants?"""
    errors = {i: _by_experiment(found.fit) for i, found in estimates.items()}
    pairs = [(i, j) for i in estimates for j in estimates if i < j]
    for i, j in pairs:
        own, others = _at_common_instants(errors[i], errors[j])
        e, x = (np.concatenate([np.zeros(0), *of]) for of in (own, others))
        both = np.isfinite(e) & np.isfinite(x)
        e, x = e[both], x[both]
        power = float(e @ e) * float(x @ x)
        if power and chi2.sf(e.size * float(e @ x) ** 2 / power, 1) * len(pairs) < levels.SHARED_DISTURBANCE:
            return True
    return False


def _relation_p(here: dict[int, _Errors], there: dict[int, _Errors]) -> float:
    """p-value that the errors here are unrelated to the last SHARED_LAGS values of those there."""
    own, others = _at_common_instants(here, there)
    return correlogram(own, levels.SHARED_LAGS, others).p_value() if own else 1.0


@dataclass(frozen=True, eq=False)
class _Errors:
    """Weighted prediction errors of one experiment, as `normal_scores`: outliers of two outputs may meet by chance."""

    interval: float
    """Between two of them."""
    t: Array
    e: Array


def _by_experiment(fit: RowFit) -> dict[int, _Errors]:
    found: dict[int, _Errors] = {}
    for piece, e in zip(fit.row.pieces, normal_scores(weighted_errors(fit)), strict=True):
        own = _Errors(piece.h * fit.row.stride, piece.times[:: fit.row.stride], e)
        before = found.get(piece.experiment)
        found[piece.experiment] = own if before is None else _on_end(before, own)
    return found


def _on_end(one: _Errors, other: _Errors) -> _Errors:
    return _Errors(one.interval, np.concatenate([one.t, other.t]), np.concatenate([one.e, other.e]))


def _at_common_instants(here: dict[int, _Errors], there: dict[int, _Errors]) -> tuple[list[Array], list[Array]]:
    """Prediction errors of two outputs where there are both, one vector an experiment; none if that is too seldom to
    compare them. Within one interval all is at once: PVs may be updated in turn."""
    own, others = [], []
    for experiment in sorted(here.keys() & there.keys()):
        one, other = here[experiment], there[experiment]
        interval, begin = max(one.interval, other.interval), min(one.t[0], other.t[0])
        one_of, other_of = (np.floor((of.t - begin) / interval + 1e-6) for of in (one, other))
        _, at, of = np.intersect1d(one_of, other_of, return_indices=True)
        own.append(one.e[at])
        others.append(other.e[of])
    enough = sum(e.size for e in own) >= levels.ERRORS_PER_LAG * levels.SHARED_LAGS
    return (own, others) if enough else ([], [])


def together(estimates: Mapping[int, OutputEstimate], confidence: float) -> dict[int, OutputEstimate] | None:
    """All outputs from one fit with a noise model that knows of such disturbances; None where there is none.

    What was added to the covariance of an output for other reasons stays added.
    """
    if any(found.disputed for found in estimates.values()):
        return None
    joint = fit_until_white([found.fit for found in estimates.values()])
    if joint is None:
        return None
    better = {}
    every = zip(estimates.items(), joint.theta, joint.covariance, joint.moved, strict=True)
    for row, ((i, found), theta, covariance, moved) in enumerate(every):
        own = np.diag(moved**2)
        budget = Budget.of(covariance - own).including(Source.NOISE_MODEL, own)
        before = found.covariance if found.unprofiled is None else found.unprofiled
        unprofiled = covariance + before - found.fit.covariance
        smaller = np.ones(theta.size)  # of a parameter that is held nothing else is known than before
        free = found.fit.free
        smaller[free] = np.diag(unprofiled)[free] / np.maximum(np.diag(before)[free], levels.SMALLEST)
        covariance = unprofiled + scaled(found.covariance - before, smaller)
        intervals = normal_intervals(found.row, theta, covariance, confidence)
        budget = budget.joined(found.budget.without(Source.NOISE, Source.PROFILE))
        better[i] = replace(
            found,
            theta=theta,
            covariance=covariance,
            budget=budget.including(Source.PROFILE, covariance - unprofiled),
            intervals=intervals,
            unprofiled=unprofiled,
            beside_ratio=None,
            jointly=True,
            rise=joint.rise(row),
        )
    return better


def widened_for_shared_disturbance(
    estimate: OutputEstimate, others: Sequence[int], confidence: float
) -> OutputEstimate:
    """The estimate with its standard errors and intervals as wide as such disturbances ask for."""
    extra = (levels.SHARED_FACTOR**2 - 1) * np.diag(estimate.covariance)
    intervals = np.array(
        [
            widened((float(low), float(high)), float(value), float(more), confidence)
            for (low, high), value, more in zip(estimate.intervals, estimate.theta, extra, strict=True)
        ]
    )
    covariance = estimate.covariance * levels.SHARED_FACTOR**2
    unprofiled = None if estimate.unprofiled is None else estimate.unprofiled * levels.SHARED_FACTOR**2
    return replace(
        estimate,
        covariance=covariance,
        budget=estimate.budget.including(Source.SHARED_DISTURBANCE, covariance - estimate.covariance),
        intervals=intervals,
        unprofiled=unprofiled,
        beside_ratio=None,
        predicted_by=tuple(others),
    )
