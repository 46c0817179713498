"""What a method answered beside the direct fit: its rows in result.json, and whether the two agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.disturbance.fit import DisturbedFit
from trueplant.identify import OutputEstimate, Spec, unanswered
from trueplant.mismatch import FrequencyResponse
from trueplant.result import MethodElement, MethodParameter
from trueplant.result.numbers import number
from trueplant.study import levels
from trueplant.study.study import Place, Study


@dataclass(frozen=True, eq=False)
class Estimated:
    """Parameters and covariance of the elements that a method answered."""

    parameters: Mapping[tuple[int, int], Array]
    covariance: Mapping[tuple[int, int], Array]
    response: FrequencyResponse | None = None
    notes: tuple[str, ...] = ()
    """What to know of it."""

    @classmethod
    def by_fits(cls, fits: Mapping[int, OutputEstimate | DisturbedFit]) -> Estimated:
        """What fits of single outputs say, element by element."""
        parameters, covariance = {}, {}
        for i, fit in fits.items():
            for spec, part in zip(fit.row.specs, fit.row.slices, strict=True):
                parameters[i, spec.column] = fit.theta[part]
                covariance[i, spec.column] = fit.covariance[part, part]
        return cls(parameters, covariance)

    def hopeless(self, place: tuple[int, int]) -> bool:
        return bool(np.sqrt(self.covariance[place][0, 0]) > levels.HOPELESS * abs(self.parameters[place][0]))


@dataclass(frozen=True)
class Difference:
    """One parameter by the fit and by another method, and the p-value that both estimate the same."""

    output: int
    column: int
    label: str
    fit: float
    other: float
    p: float


def rows_of(
    study: Study, specs: Mapping[Place, Spec], answer: Estimated, apart: Sequence[Difference]
) -> tuple[MethodElement, ...]:
    """The elements that a method answered, as the result has them; `apart` are its `clear_differences`."""
    differs = {(one.output, one.column, one.label) for one in apart}
    z = norm.ppf(0.5 + study.project.analysis.confidence / 2)
    rows = []
    for (i, j), p in sorted(answer.parameters.items()):
        structure = specs[i, j].structure
        if answer.hopeless((i, j)):
            continue
        order = structure.sorted(p)
        errors = np.sqrt(np.diag(answer.covariance[i, j]))
        parameters = (
            _parameter(name, float(p[k]), float(errors[k]), z, (i, j, name) in differs)
            for name, k in zip(structure.names, order, strict=True)
        )
        rows.append(MethodElement(study.project.output_names[i], study.columns[j], tuple(parameters)))
    return tuple(rows)


def _parameter(name: str, value: float, error: float, z: float, differs: bool) -> MethodParameter:
    """As the result has it; without an error where the method gives none."""
    if not np.isfinite(error):
        return MethodParameter(name, value, None, None)
    return MethodParameter(name, value, error, (value - z * error, value + z * error), differs)


def clear_differences(
    study: Study, estimates: Mapping[int, OutputEstimate], answer: Estimated
) -> tuple[Difference, ...] | None:
    """Where a method and the fit differ beyond both their uncertainties; None where nothing can be compared."""
    compared = _differences(estimates, answer)
    level = 1 - study.project.analysis.confidence
    return tuple(one for one in compared if one.p * len(compared) < level) if compared else None


def disagreements(
    study: Study, apart: Mapping[str, Sequence[Difference] | None], biases: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """For each method that can be compared: where it and the fit differ, if they do, in words.

    The text is empty where they agree. To one that is known to be biased, and need not agree, that is added.
    """
    return {
        name: _disagreement(study, name, clear, biases.get(name, ())) if clear else ""
        for name, clear in apart.items()
        if clear is not None
    }


def in_sentences(said: Mapping[str, str]) -> tuple[str, ...]:
    """One sentence for all that agree with the fit, then those of the others (as `disagreements` has them)."""
    agree = [name for name, apart in said.items() if not apart]
    apart = tuple(sentence for sentence in said.values() if sentence)
    if not agree:
        return apart
    *others, last = agree
    who = f"{', '.join(others)} and {last} agree" if others else f"{last} agrees"
    return (f"{who} with the fit within their uncertainties", *apart)


def _differences(estimates: Mapping[int, OutputEstimate], answer: Estimated) -> list[Difference]:
    """Every parameter that both the fit and the method answer."""
    found = []
    for i, estimate in estimates.items():
        open_ones = unanswered(estimate)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            place = (i, spec.column)
            if place not in answer.parameters or answer.hopeless(place):
                continue
            theta, variance = estimate.theta[part], np.diag(estimate.covariance)[part]
            other, other_variance = answer.parameters[place], np.diag(answer.covariance[place])
            for k, label in enumerate(spec.structure.names):
                if part.start + k in open_ones or not np.isfinite(other_variance[k]):
                    continue
                z = abs(theta[k] - other[k]) / np.sqrt(variance[k] + other_variance[k])
                found.append(Difference(*place, label, float(theta[k]), float(other[k]), float(2 * norm.sf(z))))
    return found


def _disagreement(study: Study, name: str, clear: Sequence[Difference], biases: Sequence[str]) -> str:
    named = "; ".join(
        f"{one.label.replace('_', ' ')} of {study.columns[one.column]} -> {study.project.output_names[one.output]}: "
        f"{number(one.fit)} by the fit, {number(one.other)} by {name}"
        for one in clear[: levels.MOST_NAMED]
    )
    more = f" and {len(clear) - levels.MOST_NAMED} more" if len(clear) > levels.MOST_NAMED else ""
    known = "".join(f" ({bias})" for bias in biases)
    return f"{name} and the fit disagree beyond their uncertainties: {named}{more}{known}"
