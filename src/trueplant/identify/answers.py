"""Which parameters the data do not determine, and why."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import IntArray
from trueplant.identify import levels
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.output import OutputEstimate
from trueplant.identify.unanswered import Unanswered, WhyUnanswered
from trueplant.result.budget import Source


def unanswered(estimate: OutputEstimate) -> dict[int, Unanswered]:
    """The parameters that the data do not determine, by their place in theta."""
    fit, theta = estimate.fit, estimate.theta
    if estimate.refuted is not None:
        return dict.fromkeys(range(theta.size), estimate.refuted)
    # The prior keeps every standard error finite: whether a parameter is known is for the record to say.
    sigma = np.maximum(np.sqrt(np.diag(estimate.covariance)), fit.standard_errors_by_data)
    h = fit.row.pieces[0].h
    found: dict[int, Unanswered] = {}
    for m, (spec, part) in enumerate(zip(fit.row.specs, fit.row.slices, strict=True)):
        structure, p, s = spec.structure, theta[part], sigma[part]
        lag, dead = fit.row.lag(m, p), structure.longest_dead_time(p)
        gains = np.flatnonzero(structure.is_gain)
        silent = all(not np.any(piece.inputs[spec.column]) for piece in fit.row.pieces)
        no_gain = _no_gain(estimate, part.start + gains)
        fast = not structure.integrators and lag + dead < levels.FEWEST_SAMPLES * h
        for k, gain in enumerate(structure.is_gain):
            index = part.start + k
            known = estimate.order_dependence.get(index) or estimate.withheld.get(index)
            model = abs(spec.initial[k]) if spec.initial is not None and gain else 0.0
            size = max(abs(p[k]), model, lag if structure.is_dead_time[k] else 0.0)
            if silent:
                found[index] = Unanswered.because(WhyUnanswered.INPUT_STANDS_STILL)
            elif fast and not gain:
                why = WhyUnanswered.FASTER_THAN_RECORD
                samples = round(max(lag + dead, h) / h)
                within_so_many = "one sample" if samples == 1 else f"{samples} samples"
                found[index] = Unanswered(why, f"the loop answers within about {within_so_many}: {why.value}")
            elif known is not None:
                found[index] = known
            elif not gain and no_gain:
                found[index] = Unanswered.because(WhyUnanswered.GAIN_NOT_TOLD_FROM_ZERO)
            elif s[k] > levels.TOO_UNCERTAIN * size and (not gain or model > 0 or s[k] > levels.NO_INFORMATION):
                found[index] = _too_uncertain(estimate, index, levels.TOO_UNCERTAIN * size)
    return found


def _no_gain(estimate: OutputEstimate, gains: IntArray) -> bool:
    """May the gain, or all gains of delayed terms, be zero? Of a single one its interval says so."""
    if gains.size == 1:
        low, high = estimate.intervals[gains[0]]
        return bool(low <= 0 <= high)
    told, values = estimate.covariance[np.ix_(gains, gains)], estimate.theta[gains]
    return bool(chi2.sf(values @ inverse(told) @ values, gains.size) > levels.NO_GAIN)


def _too_uncertain(estimate: OutputEstimate, index: int, most: float) -> Unanswered:
    """Why a parameter is known to no better than `most`."""
    by_noise_model = estimate.budget.parts.get(Source.NOISE_MODEL)
    if by_noise_model is None or by_noise_model[index] <= most**2:
        return Unanswered.because(WhyUnanswered.TOO_UNCERTAIN)
    why = WhyUnanswered.DEPENDS_ON_NOISE_MODEL
    here, moves = f"{estimate.theta[index]:.3g}", f"{np.sqrt(by_noise_model[index]):.2g}"
    return Unanswered(why, f"{why.value}: {here}, which another one moves by {moves}, as the structure is too simple")
