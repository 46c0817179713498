"""What is said of an element whose structure is not the declared one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trueplant.detect import Found
from trueplant.result import Code, Reason
from trueplant.study.study import Place, Study


def restructured(study: Study, found: Mapping[Place, Found]) -> tuple[Reason, ...]:
    """A note on each element whose declared structure the record rejects."""
    return tuple(
        Reason(
            Code.STRUCTURE,
            f"the plant answers with {_shape(element)}, which {element.rejected.structure} does not describe "
            f"({_chance(element.rejected.p_value)}): {element.spec.structure} was estimated in its place. Time "
            "constants and dead times of the two cannot be compared one by one",
            f"{study.columns[j]} -> {study.project.output_names[i]}",
        )
        for (i, j), element in sorted(found.items())
        if element.rejected is not None
    )


def _shape(found: Found) -> str:
    """What the response has that the declared structure lacks."""
    assert found.rejected is not None
    before, structure, theta = found.rejected.structure, found.spec.structure, found.theta
    lags = theta[structure.is_lag]
    if structure.integrators > before.integrators:
        return "a ramp that does not end (it integrates)"
    if structure.integrators < before.integrators:
        return "a new level (it does not integrate)"
    if structure.leads > before.leads:
        leads = theta[structure.is_lead]
        if leads.min() < 0:
            return "an inverse response"
        return "an overshoot" if leads.max() > lags.max(initial=0.0) else "a slow tail"
    if structure.pairs > before.pairs:
        return "an oscillation" if np.min(theta[structure.is_damping]) < 1 else "a second lag"
    return "a further lag"


def _chance(p: float) -> str:
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
