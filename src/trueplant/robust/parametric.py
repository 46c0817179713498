"""Robust performance with real parameters: the gain and the dead time of each element of the plant.

Element (i, j) is (1 + a delta) G_ij exp(-tau epsilon s) with real delta and epsilon between -1 and 1, beside weighted
complex errors at the inputs where they are asked for. At one frequency omega the dead time's factor runs over an arc
of the unit circle, which one real parameter eta gives exactly:

    exp(-j theta) = (1 - j t eta)/(1 + j t eta),   |theta| <= omega tau,   t = tan(omega tau/2)

as long as omega tau is below pi (levels.WIDEST_ARC is a little less). Beyond, the factor is taken as any complex number
not further than 2 from 1. So a peak below 1 is a proof for all plants of the set; at another size it is eta that is
scaled, not the dead time. Dead times shorter than nothing count where tau exceeds an element's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, BoolArray, ComplexArray, IntArray
from trueplant.errors import UsageError
from trueplant.loop import Controller, loop_functions, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.robust import levels
from trueplant.robust.blocks import Block, Full, Real
from trueplant.robust.generalised import Response, Weights, channels
from trueplant.robust.grid import on_axis, rates_of
from trueplant.robust.mu import mu
from trueplant.robust.performance import Robustness, judged, unstable_loop


@dataclass(frozen=True, eq=False)
class ElementErrors:
    """How far the gain (relative) and the dead time (time units) of each element may be off; 0 where they are known."""

    gain: Array
    """(n_y, n_u)"""
    dead_time: Array
    """(n_y, n_u)"""

    @classmethod
    def of(cls, plant: TransferMatrix, gain: ArrayLike = 0.0, dead_time: ArrayLike = 0.0) -> ElementErrors:
        """One number for all elements, or one for each. Raises UsageError."""
        values = []
        for name, given in (("gain", gain), ("dead time", dead_time)):
            array = np.asarray(given, dtype=float)
            if array.ndim and array.shape != plant.shape:
                raise UsageError(f"the errors of the {name} need the plant's shape {plant.shape}, not {array.shape}")
            if not np.all(np.isfinite(array) & (array >= 0)):
                raise UsageError(f"the errors of the {name} must be numbers of 0 or more")
            there = np.array([[not element.is_zero for element in row] for row in plant.elements])
            values.append(np.where(there, array, 0.0))
        if not np.any(values):
            raise UsageError("no element has an error of its gain or dead time: state one, or use robust_performance")
        return cls(*values)


@dataclass(frozen=True, eq=False)
class ParametricLoop:
    """The loop whose N is wanted at any frequency."""

    plant: TransferMatrix
    controller: Controller
    errors: ElementErrors
    performance: tuple[Response, ...]
    uncertainty: tuple[Response, ...]
    """Of each input; empty for none."""

    @property
    def gains(self) -> IntArray:
        """(k, 2) outputs and inputs of the elements with an error of the gain."""
        return np.argwhere(self.errors.gain > 0)

    @property
    def dead_times(self) -> IntArray:
        """(m, 2) the same of the dead time."""
        return np.argwhere(self.errors.dead_time > 0)

    def turns(self, w: Array) -> BoolArray:
        """(n_s, m): which dead times turn so far that a complex number stands for them."""
        tau = self.errors.dead_time[tuple(self.dead_times.T)]
        return np.asarray(w[:, None] * tau >= levels.WIDEST_ARC)

    def blocks(self, turned: BoolArray) -> tuple[Block, ...]:
        """Of the gains, the dead times (m,) and the inputs."""
        dead_times = (Full(1) if full else Real() for full in turned)
        return (*(Real() for _ in self.gains), *dead_times, *(Full(1) for _ in self.uncertainty))

    def system(self, w: Array) -> ComplexArray:
        """N (n_s, n_z + n_y, n_z + n_y), the perturbation's outputs and inputs first."""
        s = on_axis(w, self.plant)
        G = self.plant(s)
        loop = loop_functions(G, self.controller(s))
        by_input, direct, to_output = self._perturbed(w, s, G)
        wanted = np.stack([weight(s) for weight in self.performance], axis=1)[:, :, None]
        from_all = np.concatenate(
            [to_output, np.broadcast_to(np.eye(G.shape[1]), (len(s), *(G.shape[1],) * 2))], axis=2
        )
        upper = -by_input @ loop.QS @ from_all
        upper[:, :, : direct.shape[2]] += direct
        return np.asarray(np.concatenate([upper, wanted * (loop.S @ from_all)], axis=1), dtype=np.complex128)

    def _perturbed(self, w: Array, s: ComplexArray, G: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """z = by_input u + direct w and y = G u + to_output w + d.

        Of an element v = G_ij u_j: the gain takes z = a v and adds w to it; the dead time of v + w takes
        j t (2 (v + w) - w'), or 2 (v + w) where it turns too far, and its w' is subtracted.
        """
        count, (n_y, n_u) = len(w), self.plant.shape
        gains, dead_times, inputs = self.gains, self.dead_times, len(self.uncertainty)
        k, m = len(gains), len(dead_times)
        tau = self.errors.dead_time[tuple(dead_times.T)]
        turned = self.turns(w)
        t = 1j * np.tan(np.where(turned, 0.0, w[:, None] * tau / 2))
        by_input = np.zeros((count, k + m + inputs, n_u), dtype=complex)
        direct = np.zeros((count, k + m + inputs, k + m + inputs), dtype=complex)
        to_output = np.zeros((count, n_y, k + m + inputs), dtype=complex)
        at = {tuple(place): number for number, place in enumerate(gains)}
        for number, (i, j) in enumerate(gains):
            by_input[:, number, j] = self.errors.gain[i, j] * G[:, i, j]
            to_output[:, i, number] = 1.0
        for number, (i, j) in enumerate(dead_times):
            row, twice = k + number, np.where(turned[:, number], 2.0, 2 * t[:, number])
            by_input[:, row, j] = twice * G[:, i, j]
            direct[:, row, row] = -t[:, number]
            to_output[:, i, row] = -1.0
            if (i, j) in at:
                direct[:, row, at[i, j]] = twice
        # an error at an input comes before all elements
        for j in range(inputs):
            direct[:, : k + m, k + m + j] = by_input[:, : k + m, j]
            to_output[:, :, k + m + j] = G[:, :, j]
            by_input[:, k + m + j, j] = self.uncertainty[j](s)
        return by_input, direct, to_output

    def moved(self, delta: ComplexArray, frequency: float) -> TransferMatrix:
        """The plant of the set at a worst case's real parameters; complex numbers in it are left out."""
        value = np.diagonal(delta)
        turned = self.turns(np.array([frequency]))[0]
        elements = [list(row) for row in self.plant.elements]
        for number, (i, j) in enumerate(self.gains):
            elements[i][j] = elements[i][j] * float(1 + self.errors.gain[i, j] * value[number].real)
        for number, (i, j) in enumerate(self.dead_times):
            if not turned[number]:
                t = np.tan(frequency * self.errors.dead_time[i, j] / 2)
                later = 2 * np.arctan(t * value[len(self.gains) + number].real) / frequency
                elements[i][j] = _delayed(elements[i][j], float(later))
        return TransferMatrix(tuple(map(tuple, elements)), self.plant.time_unit)


def _delayed(element: TransferFunction, later: float) -> TransferFunction:
    earliest = min(term.dead_time for term in element.terms)
    if later < -earliest:
        raise UsageError(
            f"the worst case needs a dead time of {earliest + later:.3g}, which no plant has: state errors of dead "
            "times that are no longer than the dead times themselves"
        )
    parts = (TransferFunction.rational(term.num, term.den, term.dead_time + later) for term in element.terms)
    return sum(parts, TransferFunction())


def parametric_loop(
    plant: TransferMatrix,
    controller: Controller,
    errors: ElementErrors,
    performance: Weights,
    uncertainty: Weights | None = None,
) -> ParametricLoop:
    """Checked. performance: weights of the outputs; uncertainty: of complex errors at the inputs. Raises UsageError.

    A gain that is known to 20 % and a dead time to 0.8 min:

    >>> from trueplant.loop import PID
    >>> from trueplant.robust import performance_weight
    >>> plant = TransferMatrix.of([["2 exp(-3 s)/(8 s + 1)"]], "min")
    >>> controller = Controller.diagonal([PID(Kc=2 / 3, Ti=8.0)])
    >>> errors = ElementErrors.of(plant, gain=0.2, dead_time=0.8)
    >>> loop = parametric_loop(plant, controller, errors, performance_weight(0.05, 2.0))
    >>> found = parametric_performance(loop)
    >>> print(f"{found.RP.upper:.3f}", found.passes)
    1.091 False
    >>> print(loop.moved(found.worst, found.worst_frequency))
    2.36672 exp(-3.73415 s)/(8 s + 1)
    """
    asked = channels(performance, plant.shape[0], "the performance")
    own = () if uncertainty is None else channels(uncertainty, plant.shape[1], "the uncertainty")
    return ParametricLoop(plant, controller, errors, asked, own)


def parametric_performance(loop: ParametricLoop) -> Robustness:
    """NP, RS and RP under real errors of gains and dead times, over all frequencies down to omega -> 0.

    As robust_performance; mu with real parameters may jump between two frequencies, so a peak may be narrower than the
    grid shows, and the bounds lie further apart. `worst` is ordered as `loop.blocks`; loop.moved makes the plant of it.
    """
    if unstable_poles(loop.plant, loop.controller):
        return unstable_loop()
    weights = (f for f in (*loop.performance, *loop.uncertainty) if isinstance(f, TransferFunction))
    rates = rates_of(loop.plant, loop.controller, weights)
    n_y = loop.plant.shape[0]

    rest = levels.REST * rates.slowest

    def system(w: Array) -> tuple[Array, ComplexArray]:
        N = loop.system(w)
        # the limit towards 0 is real, and real parameters tell it from what is next to it
        return w, np.where((w == rest)[:, None, None], N.real, N)

    def nominal(at: tuple[Array, ComplexArray]) -> tuple[Array, Array]:
        size = np.linalg.norm(at[1][:, -n_y:, -n_y:], ord=2, axis=(1, 2))
        return size, size

    def stability(at: tuple[Array, ComplexArray]) -> tuple[Array, Array]:
        return _mu(loop, at[0], at[1][:, :-n_y, :-n_y])[:2]

    def whole(at: tuple[Array, ComplexArray]) -> tuple[Array, Array]:
        return _mu(loop, *at, Full(n_y))[:2]

    def worst(at: tuple[Array, ComplexArray]) -> ComplexArray:
        return _mu(loop, *at, Full(n_y))[2][0, :-n_y, :-n_y]

    return judged(loop.plant, loop.controller, rates, system, (nominal, stability, whole), worst)


def _mu(loop: ParametricLoop, w: Array, N: ComplexArray, *more: Block) -> tuple[Array, Array, ComplexArray]:
    """Bounds and perturbations; frequencies at which the same dead times turn too far go together."""
    lower, upper, delta = np.zeros(len(w)), np.zeros(len(w)), np.zeros(N.shape, dtype=complex)
    kinds, which = np.unique(loop.turns(w), axis=0, return_inverse=True)
    for number, kind in enumerate(kinds):
        here = np.flatnonzero(which.ravel() == number)
        found = mu(N[here], (*loop.blocks(kind), *more))
        lower[here], upper[here], delta[here] = found.lower, found.upper, found.delta
    return lower, upper, delta
