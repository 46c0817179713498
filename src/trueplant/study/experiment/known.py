"""What is known of each output before a test: the fit that a plan starts from, also of what is not answered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import OutputEstimate, RowFit, Spec, Unanswered, fit_row, unanswered
from trueplant.lti import Structure
from trueplant.study import levels


@dataclass(frozen=True, eq=False)
class Known:
    """One output. What is not answered of an element without answered dynamics is as its model has it; without a model
    its times are such as the others have, and its gain is what the record shows then."""

    estimate: OutputEstimate
    fit: RowFit
    covariance: Array
    """(n, n) of fit.theta."""
    reasons: Mapping[int, Unanswered]
    """Of what is not answered."""

    @classmethod
    def of(cls, estimate: OutputEstimate, slowest: float) -> Known:
        """`slowest`: lag and dead time of the slowest element that is known."""
        fit, reasons, theta = estimate.fit, unanswered(estimate), estimate.theta.copy()
        gains = np.zeros(theta.size, dtype=bool)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            places = np.arange(part.start, part.stop)
            if not _without_dynamics(spec, part, reasons):
                continue
            if spec.initial is None:
                theta[part] = _unknown(spec.structure, slowest)
                gains[part] = spec.structure.is_gain
            else:
                theta[part] = np.where([k in reasons for k in places], spec.initial, theta[part])
        theta = np.clip(theta, *fit.row.bounds())
        if np.array_equal(theta, estimate.theta):
            return cls(estimate, replace(fit, theta=theta), estimate.covariance, reasons)
        shown = fit_row(
            fit.row, theta, fit.ar, weights=fit.weights, free=gains, reweight=False, iterations=levels.GAIN_STEPS
        )
        there = fit_row(fit.row, shown.theta, fit.ar, weights=fit.weights, reweight=False, iterations=0)
        covariance = there.covariance * (fit.variance / there.variance) * float(np.max(estimate.factor))
        return cls(estimate, replace(there, variance=fit.variance), covariance, reasons)

    @property
    def elements(self) -> list[tuple[Spec, slice]]:
        """With the places of their parameters."""
        return list(zip(self.fit.row.specs, self.fit.row.slices, strict=True))

    @property
    def as_modelled(self) -> bool:
        """Do times of the model stand where the record tells none?"""
        return not np.array_equal(self.fit.theta, self.estimate.theta)

    @property
    def data_can_help(self) -> bool:
        """Not where runs of the plant differ, or the structure is too simple: there more of the same tells nothing."""
        return not self.estimate.disputed and not self.estimate.undermodelled

    def without_dynamics(self, spec: Spec, part: slice) -> bool:
        """Is nothing answered of the element but, at best, its gain?"""
        return _without_dynamics(spec, part, self.reasons)

    def hopeless(self, part: slice) -> BoolArray:
        """(n_p,) parameters of the element that more data would not tell either."""
        places = range(part.start, part.stop)
        return np.array([k in self.reasons and not self.reasons[k].why.more_data_helps for k in places])


def known_of(estimates: Mapping[int, OutputEstimate], h: float) -> tuple[dict[int, Known], float]:
    """By output, and the time that the slowest element takes which is known, or declared."""
    times = [levels.SHORTEST_SLOWEST * h]
    for estimate in estimates.values():
        reasons = unanswered(estimate)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            unknown = np.array([k in reasons for k in range(part.start, part.stop)])
            p = estimate.theta[part] if spec.initial is None else np.where(unknown, spec.initial, estimate.theta[part])
            if spec.initial is not None or not unknown[~spec.structure.is_gain].any():
                times.append(spec.structure.lag(p) + spec.structure.longest_dead_time(p))
    slowest = float(max(times))
    return {i: Known.of(estimate, slowest) for i, estimate in estimates.items()}, slowest


def _without_dynamics(spec: Spec, part: slice, reasons: Mapping[int, Unanswered]) -> bool:
    places = np.arange(part.start, part.stop)
    dynamics = places[~spec.structure.is_gain]
    return all(k in reasons for k in (dynamics if dynamics.size else places))


def _unknown(structure: Structure, slowest: float) -> Array:
    """An element with times like those of the others, before its gain is looked for."""
    lag = slowest / (structure.lags + structure.pairs + 1)
    return structure.parameters(0.0, lag, 1 / lag, levels.USUAL_DAMPING, 0.0, lag)
