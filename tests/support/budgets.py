"""Budgets that must add up."""

from __future__ import annotations

import numpy as np

from trueplant import Result
from trueplant.identify import OutputEstimate
from trueplant.result import Source


def parts_of(estimate: OutputEstimate) -> dict[Source, np.ndarray]:
    """The parts of an estimate's variances, which sum to them to rounding.

    None is negative beyond that but for other minima, which may be narrower than the deepest.
    """
    parts = dict(estimate.budget.parts)
    variances = np.diag(estimate.covariance)
    np.testing.assert_allclose(sum(parts.values()), variances, rtol=1e-9)
    assert all(np.all(part >= -1e-9 * variances) for source, part in parts.items() if source is not Source.MINIMA)
    return parts


def sources_of(result: Result) -> set[Source]:
    """The sources that any answered parameter names; each of these has a budget, and its shares sum to 1."""
    found = set()
    for element in result.elements:
        assert [b.parameter for b in element.budget] == [p.name for p in element.parameters if p.plant is not None]
        for budget in element.budget:
            assert abs(sum(part.share for part in budget.parts) - 1) < 1e-9
            assert all(part.share > -1e-9 for part in budget.parts if part.source is not Source.MINIMA)
            found |= {part.source for part in budget.parts}
    return found
