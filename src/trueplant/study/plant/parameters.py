"""The parameters of an estimated element as the results show them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.detect import Found, Verdict
from trueplant.result import Parameter


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
