"""Nominal performance, robust stability and robust performance of a loop, (29) and (30)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.loop import Controller, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.robust import levels
from trueplant.robust.blocks import Block, Full
from trueplant.robust.generalised import (
    Weights,
    channels,
    generalised_plant,
    uncertainty_blocks,
    weighted_channels,
)
from trueplant.robust.grid import Rates, on_axis, rates_of
from trueplant.robust.mu import mu
from trueplant.robust.peaks import Peak, loop_grid, sharpened


@dataclass(frozen=True, eq=False)
class Robustness:
    """What the uncertainty does to a loop. Each test is passed with an upper bound below 1 in a stable loop."""

    stable: bool
    """Of the nominal loop. If it is not, the peaks are infinite."""
    NP: Peak
    """Nominal performance: sigma_max(wP S)."""
    RS: Peak
    """Robust stability: mu of the uncertainty's own loop."""
    RP: Peak
    """Robust performance: mu of all of N."""
    w: Array
    """(n_s,) frequencies of the curves; the first stands for the limit omega -> 0."""
    nominal: Array
    """(n_s,) sigma_max(wP S)."""
    stability: Array
    """(n_s, 2) lower and upper bound of mu for robust stability."""
    performance: Array
    """(n_s, 2) lower and upper bound of mu for robust performance."""
    worst: ComplexArray
    """Delta of the uncertainty, of size 1/RP.lower, under which the weighted error reaches RP.lower at the frequency
    `worst_frequency`; perturbed_plant makes a plant of it. Empty where the loop is unstable."""
    worst_frequency: float

    @property
    def passes(self) -> bool:
        """Robust performance is achieved."""
        return self.stable and self.RP.upper < 1

    def __repr__(self) -> str:
        state = "stable" if self.stable else "unstable"
        return f"{state}; NP {self.NP}; RS {self.RS}; RP {self.RP}"


def robust_performance(
    plant: TransferMatrix,
    controller: Controller,
    uncertainty: Weights,
    performance: Weights,
    structure: str = "input",
) -> Robustness:
    """NP, RS and RP of the loop under weighted uncertainty, over all frequencies down to omega -> 0.

    Weights are transfer functions, formulas, numbers or functions of s, one for all channels or one a channel; see
    generalised_plant for the structures. Peaks are sharpened to 1e-6 of their value. A peak is infinite where the
    performance weight integrates and the loop does not. Raises UsageError and LoopError for what does not fit.
    """
    n_y = plant.shape[0]
    own = channels(uncertainty, weighted_channels(plant, structure), "the uncertainty")
    asked = channels(performance, n_y, "the performance")
    if unstable_poles(plant, controller):
        return unstable_loop()
    blocks = uncertainty_blocks(plant.shape, structure)
    n_z, n_w = sum(b.columns for b in blocks), sum(b.rows for b in blocks)
    all_blocks: Sequence[Block] = (*blocks, Full(n_y))

    def system(w: Array) -> ComplexArray:
        return generalised_plant(plant, controller, own, asked, on_axis(w, plant), structure)

    def nominal(N: ComplexArray) -> tuple[Array, Array]:
        size = np.linalg.norm(N[:, n_z:, n_w:], ord=2, axis=(1, 2))
        return size, size

    def stability(N: ComplexArray) -> tuple[Array, Array]:
        result = mu(N[:, :n_z, :n_w], blocks)
        return result.lower, result.upper

    def whole(N: ComplexArray) -> tuple[Array, Array]:
        result = mu(N, all_blocks)
        return result.lower, result.upper

    def worst(N: ComplexArray) -> ComplexArray:
        return mu(N, all_blocks).delta[0, :n_w, :n_z]

    rates = rates_of(plant, controller, (f for f in (*own, *asked) if isinstance(f, TransferFunction)))
    return judged(plant, controller, rates, system, (nominal, stability, whole), worst)


def unstable_loop() -> Robustness:
    """What is said of a nominal loop that is unstable."""
    nowhere = Peak(np.inf, np.inf, np.nan)
    empty, none = np.zeros((0, 2)), np.zeros((0, 0), dtype=np.complex128)
    return Robustness(False, nowhere, nowhere, nowhere, np.zeros(0), np.zeros(0), empty, empty, none, np.nan)


def judged(
    plant: TransferMatrix,
    controller: Controller,
    rates: Rates,
    system: Callable[[Array], Any],
    tests: Sequence[Callable[[Any], tuple[Array, Array]]],
    worst: Callable[[Any], ComplexArray],
) -> Robustness:
    """The bounds that three tests (nominal, stability, performance) have of system(w), over all frequencies."""
    w = loop_grid(plant, controller, rates)
    rest = levels.REST * rates.slowest
    w = np.concatenate([[rest], w])
    N = system(w)
    curves, peaks = [], []
    for bounds in tests:
        lower, upper = bounds(N)
        grows = bounds(system(np.array([100 * rest])))[1][0]
        if upper[0] > levels.GROWS_AT_REST * grows and upper[0] > 1:
            peaks.append(Peak(np.inf, np.inf, 0.0))
        else:
            peaks.append(sharpened(bounds, system, w, lower, upper))
        curves.append(np.stack([lower, upper], axis=1))
    frequency = peaks[2].frequency or rest
    return Robustness(
        stable=True,
        NP=peaks[0],
        RS=peaks[1],
        RP=peaks[2],
        w=w,
        nominal=curves[0][:, 1],
        stability=curves[1],
        performance=curves[2],
        worst=worst(system(np.array([frequency]))),
        worst_frequency=frequency,
    )
