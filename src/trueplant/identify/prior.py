"""What is known of a plant before its record is looked at: it is somewhere near its model.

The prior is weak and has heavy tails (Cauchy): what the record determines it does not move, however far that is from
the model. What the record does not determine, such as a lag that a lead cancels, stays near the model instead of
wandering to where rounding or chance takes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.lti.structure import Structure


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent Cauchy distributions of some parameters, about the model's values."""

    centre: Array
    """(n,)"""
    scale: Array
    """(n,) half of the mass lies within it; infinite where nothing is known."""
    logarithmic: BoolArray
    """(n,) True where the logarithm is distributed so, and centre and scale are its own."""

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
        logarithmic = (structure.is_lag | structure.is_frequency | structure.is_damping) & (model > 0)
        scale = np.where(logarithmic, 1.0, size) * levels.PRIOR_SCALE
        centre = np.where(logarithmic, np.log(np.where(logarithmic, model, 1.0)), model)
        scale[list(undeclared)] = np.inf
        return cls(centre, np.where(scale > 0, scale, np.inf), logarithmic)

    @classmethod
    def joined(cls, parts: list[Prior]) -> Prior:
        """That of several elements, one after the other."""
        return cls(
            np.concatenate([np.zeros(0), *(p.centre for p in parts)]),
            np.concatenate([np.zeros(0), *(p.scale for p in parts)]),
            np.concatenate([np.zeros(0, dtype=bool), *(p.logarithmic for p in parts)]),
        )

    def penalty(self, theta: Array) -> float:
        """-2 log density at theta (n,), relative to the model's."""
        return float(2 * np.sum(np.log1p(self._distance(theta)[0] ** 2)))

    def normal_equations(self, theta: Array) -> tuple[Array, Array]:
        """Diagonal (n,) of the information and half of the gradient (n,) of the penalty, as of reweighted squares."""
        distance, slope = self._distance(theta)
        weight = 2 / (1 + distance**2)
        return weight * slope**2, weight * distance * slope

    def _distance(self, theta: Array) -> tuple[Array, Array]:
        """From the centre in units of the scale, and its derivative."""
        positive = np.where(self.logarithmic, np.maximum(theta, levels.SMALLEST), 1.0)
        value = np.where(self.logarithmic, np.log(positive), theta)
        return (value - self.centre) / self.scale, np.where(self.logarithmic, 1 / positive, 1.0) / self.scale
