"""Disturbances that reach several outputs, and what they do to estimates with a noise model for each output.

If a disturbance shows in one output before it reaches another, the controller acts on it in time, and OP is
then correlated with the prediction errors of the other output: the direct fit is biased, and its covariance does
not show it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.budget import Budget
from trueplant.identify.covariance import scaled
from trueplant.identify.intervals import normal_intervals, widened
from trueplant.identify.joint import fit_until_white
from trueplant.identify.output import OutputEstimate
from trueplant.identify.portmanteau import correlogram
from trueplant.result.budget import Source


def predicted_outputs(estimates: Mapping[int, OutputEstimate]) -> dict[int, list[int]]:
    """For each output the others whose past prediction errors predict its own."""
    pairs = [(i, j) for i in estimates for j in estimates if i != j]
    found: dict[int, list[int]] = {}
    for i, j in pairs:
        here, there = estimates[i].tests, estimates[j].tests
        if _relation_p(here.t, here.e, there.t, there.e) * len(pairs) < levels.SHARED_DISTURBANCE:
            found.setdefault(i, []).append(j)
    return found


def related_at_once(estimates: Mapping[int, OutputEstimate]) -> bool:
    """Are the prediction errors of some outputs related at the same instants?"""
    pairs = [(estimates[i].tests, estimates[j].tests) for i in estimates for j in estimates if i < j]
    for here, there in pairs:
        e, x = _at_common_instants(here.t, here.e, there.t, there.e)
        both = np.isfinite(e) & np.isfinite(x)
        e, x = e[both], x[both]
        power = float(e @ e) * float(x @ x)
        if e.size and power and chi2.sf(e.size * float(e @ x) ** 2 / power, 1) * len(pairs) < levels.SHARED_DISTURBANCE:
            return True
    return False


def _relation_p(t: Array, e: Array, s: Array, x: Array) -> float:
    """p-value that e is unrelated to the last SHARED_LAGS values of x, taken at the same instants."""
    e, x = _at_common_instants(t, e, s, x)
    return correlogram([e], levels.SHARED_LAGS, [x]).p_value() if e.size else 1.0


def _at_common_instants(t: Array, e: Array, s: Array, x: Array) -> tuple[Array, Array]:
    """e, of the instants t, and x, of s, where there are both; empty if that is too seldom to compare them."""
    common, at, of = np.intersect1d(np.round(t, 9), np.round(s, 9), return_indices=True)
    enough = common.size >= levels.ERRORS_PER_LAG * levels.SHARED_LAGS
    return (e[at], x[of]) if enough else (np.zeros(0), np.zeros(0))


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
    for (i, found), theta, covariance, moved in every:
        own = np.diag(moved**2)
        budget = Budget.of(covariance - own).including(Source.NOISE_MODEL, own)
        before = found.covariance if found.unprofiled is None else found.unprofiled
        unprofiled = covariance + before - found.fit.covariance
        smaller = np.diag(unprofiled) / np.maximum(np.diag(before), levels.SMALLEST)
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
