"""The parameters of an estimated element as the results show them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.detect import Found, Verdict
from trueplant.result import Parameter, ParameterBudget, VariancePart


def parameters_of(found: Found, verdict: Verdict, units: Sequence[str]) -> tuple[Parameter, ...]:
    """One entry a parameter: value, interval and verdict; `plant` is None where the data do not answer."""
    parameters = []
    for k, name in enumerate(found.spec.structure.names):
        told = k not in found.reasons
        value, model, judged = float(found.theta[k]), found.model[k], verdict.parameters[k]
        low, high = (float(x) for x in found.intervals[k])
        parameters.append(
            Parameter(
                name=name,
                unit=units[k],
                model=model,
                plant=value if told else None,
                std_error=float(np.sqrt(found.covariance[k, k])) if told else None,
                ci=(low, high) if told and np.isfinite([low, high]).any() else None,
                change_percent=100 * (value - model) / model if told and model else None,
                p_value=judged.p_value,
                p_adjusted=judged.p_adjusted,
                changed=judged.changed,
                reason=found.reasons[k].text if k in found.reasons else "",
            )
        )
    return tuple(parameters)


def budgets_of(found: Found) -> tuple[ParameterBudget, ...]:
    """What the variance of each answered parameter is made of; sources without a part in it are left out."""
    told = [k for k in range(found.theta.size) if k not in found.reasons]
    return tuple(ParameterBudget(found.spec.structure.names[k], _shares(found, k)) for k in told)


def _shares(found: Found, k: int) -> tuple[VariancePart, ...]:
    shares = {source: float(more[k] / found.covariance[k, k]) for source, more in found.budget.parts.items()}
    return tuple(VariancePart(source, x) for source, x in shares.items() if abs(x) > np.finfo(float).eps)
