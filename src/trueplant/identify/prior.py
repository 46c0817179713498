"""What is known of a plant before its record is looked at: it is somewhere near its model.

The prior is weak, normal in the logarithm: what the record determines it does not move, however far that is from the
model. What the record does not determine, such as a lag that a lead cancels, stays near the model instead of wandering
to where rounding or chance takes it; and a plant a hundred times slower than its model has to explain more of the
record than a drift that happens to look like one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled
from trueplant.identify import levels
from trueplant.lti.structure import Structure


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal distributions of logarithms, about the model's values.

    Of what may be negative it is asinh(value / unit): proportional to the value where that is small, a logarithm with
    its sign where it is large.
    """

    model: Array
    """(n,)"""
    unit: Array
    """(n,) infinite where nothing is known."""
    positive: BoolArray
    """(n,) True where the logarithm itself is distributed so."""

    @classmethod
    def about(cls, structure: Structure, model: Array | None, undeclared: Sequence[int] = ()) -> Prior:
        """That of an element: relative to the model's gain, time constants, and dead time plus lag.

        Nothing is known of the parameters at the places `undeclared`, nor without a model.
        """
        n = len(structure.names)
        if model is None:
            return cls(np.zeros(n), np.full(n, np.inf), np.zeros(n, dtype=bool))
        lag = structure.lag(model)
        size = np.abs(model)
        size = np.where(structure.is_lead, np.maximum(size, lag), size)
        size = np.where(structure.is_dead_time, size + lag, size)
        size[list(undeclared)] = np.inf
        positive = (structure.is_lag | structure.is_frequency | structure.is_damping) & (model > 0)
        return cls(model, np.where(size > 0, size, np.inf), positive & np.isfinite(size))

    @classmethod
    def joined(cls, parts: list[Prior]) -> Prior:
        """That of several elements, one after the other."""
        return cls(
            np.concatenate([np.zeros(0), *(p.model for p in parts)]),
            np.concatenate([np.zeros(0), *(p.unit for p in parts)]),
            np.concatenate([np.zeros(0, dtype=bool), *(p.positive for p in parts)]),
        )

    def penalty(self, theta: Array) -> float:
        """-2 log density at theta (n,), relative to the model's."""
        distance, _ = self.errors(theta)
        return float(distance @ distance)

    def normal_equations(self, theta: Array) -> tuple[Array, Array]:
        """Diagonal (n,) of the information and half of the gradient (n,) of the penalty."""
        distance, slope = self.errors(theta)
        return slope**2, distance * slope

    def errors(self, theta: Array) -> tuple[Array, Array]:
        """(n,) distances from the model in standard deviations, and (n,) their derivatives."""
        value, slope = _logarithm(theta, self.unit, self.positive)
        return (value - self._centre) / levels.PRIOR_SPREAD, slope / levels.PRIOR_SPREAD

    @cached_property
    def _centre(self) -> Array:
        centre: Array = _logarithm(self.model, self.unit, self.positive)[0]
        return centre


@compiled
def _logarithm(theta: Array, unit: Array, positive: BoolArray) -> tuple[Array, Array]:
    """And its derivative; zeros where nothing is known."""
    value, slope = np.empty(theta.size), np.empty(theta.size)
    for k in range(theta.size):
        if positive[k]:
            above = max(theta[k], levels.SMALLEST)
            value[k], slope[k] = np.log(above), 1 / above
        else:
            share = theta[k] / unit[k]
            value[k], slope[k] = np.arcsinh(share), 1 / (unit[k] * np.sqrt(1 + share**2))
    return value, slope
