"""The same loop on many plants, again and again: plants are discretised once, then only laws and steps differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.loop.controller import Controller
from trueplant.loop.kernel import Terms, run_loop, terms_of
from trueplant.loop.law import law_of, law_setpoints, rest
from trueplant.loop.valve import Valve, parameters_of
from trueplant.lti.transfer import TransferMatrix


@dataclass(frozen=True, eq=False)
class Bank:
    """Plants (n_y, n_u) for steps of h, exact as in `simulate`."""

    h: float
    shape: tuple[int, int]
    terms: tuple[Terms, ...]

    @classmethod
    def of(cls, plants: Sequence[TransferMatrix], h: float) -> Bank:
        """At least one plant, all of one shape. Raises LoopError for improper elements."""
        return cls(h, plants[0].shape, tuple(terms_of(plant, h) for plant in plants))

    def run(
        self, controller: Controller, r: Array, load: Array, *, y0: Array, u0: Array, limits: Array
    ) -> tuple[Array, Array]:
        """PV (count, N, n_y) and OP (count, N, n_u) of every plant, from rest at (y0, u0), without noise.

        r (N, n_y) set-points and load (N, n_u) added behind OP, held over each step; limits (n_u, 2) of OP. What runs
        away is not finite. Raises LoopError for a controller that cannot be run at this step.
        """
        steps, (n_y, n_u) = len(r), self.shape
        law = law_of(controller, self.h)
        r_mean, r_end = law_setpoints(controller, law, r, self.h, y0)
        x, integral = rest(law, y0[law.j], y0[law.j], u0, limits)
        nothing, quantum, valves = np.zeros((steps, n_y)), np.zeros(n_y), parameters_of([Valve()] * n_u)
        y, u = np.empty((len(self.terms), steps, n_y)), np.empty((len(self.terms), steps, n_u))
        with np.errstate(over="ignore", invalid="ignore"):
            for k, terms in enumerate(self.terms):
                u[k], y[k], _ = run_loop(
                    terms, law, r_mean, r_end, nothing, nothing, nothing, quantum, load, limits, u0, y0, valves,
                    x.copy(), integral.copy(),
                )  # fmt: skip
        return y, u
