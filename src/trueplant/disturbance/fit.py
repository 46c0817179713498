"""Plant and unmeasured disturbance estimated together, the declared disturbance in the noise model.

    y = sum_j G_j(p; theta) u_j + offset + free response + v,    v = declared disturbance + first order + white noise

A Kalman filter with plant and disturbance in its state, theta fixed, hands whatever the plant does otherwise than
theta says to the disturbance. Here theta is estimated with the filter in the loop: since u is known, the plant's part
of the state is computed outside it, dead times as they are, and the filter whitens the rest. For Gaussian disturbances
this is also where alternating between the two (smooth v with the plant, fit the plant to y - v) ends, many rounds
later. It cannot do everything: a change of the plant that the disturbance could have made too stays open, and the
covariance says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.disturbance import levels
from trueplant.disturbance.kalman import whitened
from trueplant.disturbance.models import Part, ramps
from trueplant.disturbance.noise import Noise, Signal, criterion, fit_noise_and_jumps, reduced
from trueplant.identify import Row, RowFit
from trueplant.identify.descent import Problem, descend
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.portmanteau import correlogram


@dataclass(frozen=True, eq=False)
class DisturbedFit:
    """A row of the plant estimated along with its disturbance."""

    row: Row
    theta: Array
    """(n,) parameters of the elements, stacked in the order of row.specs."""
    covariance: Array
    by_background: Array
    """(n, n) what the covariance would be if the declared disturbance were known: noise alone."""
    noise: Noise
    jumps: tuple[tuple[int, ...], ...]
    """Samples of each piece (at the row's stride) at which a declared step was found to jump."""
    criterion: float
    """-2 log likelihood up to a constant, and what the jumps cost (Bayesian criterion)."""
    whiteness_p: float
    """Ljung-Box test of the prediction errors."""
    lost: Array
    """(n,) share of the information on each parameter, others known, that the declared disturbance takes away."""

    @property
    def std_errors(self) -> Array:
        return np.sqrt(np.diag(self.covariance))

    def rise(self, index: IntArray, values: Array, largest: bool = False) -> float:
        """By how much -2 log likelihood rises when theta[index] is held at values, as far as the bounds let it be.

        All other parameters are free, the disturbance is the one that was found; `largest`: as large as declared.
        """
        noise = replace(self.noise, scale=1.0) if largest else self.noise
        likelihood = _Likelihood(self.row, noise, self.jumps)
        best = likelihood.best(self.theta) if largest else _Point(likelihood, self.theta)
        low, high = self.row.bounds()
        theta, free = best.theta.copy(), np.ones(self.theta.size, dtype=bool)
        theta[index], free[index] = np.clip(values, low[index], high[index]), False
        return max(likelihood.best(theta, free).cost - best.cost, 0.0)


def fit_with_disturbance(fit: RowFit, declared: Sequence[Part]) -> DisturbedFit:
    """Estimate the row of `fit` again, with the declared disturbance in its noise model.

    The fit's parameters and the model's are both initial guesses; the better end of the two is returned.
    """
    row = replace(fit.row, pieces=tuple(replace(piece, jumps=()) for piece in fit.row.pieces))
    guesses = [fit.theta]
    known = [spec.initial for spec in row.specs if spec.initial is not None]
    if len(known) == len(row.specs):
        guesses.append(np.concatenate([np.array(initial, dtype=float) for initial in known]))
    ends = [_alternated(row, np.clip(guess, *row.bounds()), tuple(declared)) for guess in guesses]
    return _finished(row, *min(ends, key=lambda end: end[3]))


def likelihood_p(found: DisturbedFit, index: IntArray, values: Array, largest: bool = False) -> float:
    """p-value that the parameters `index` have these values, all others free, under the disturbance that was found.

    largest: under the disturbance as large as it was declared.
    """
    return float(chi2.sf(found.rise(index, values, largest), index.size))


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """The likelihood of a row's parameters where the disturbance is known."""

    row: Row
    noise: Noise
    jumps: tuple[tuple[int, ...], ...]

    def best(self, theta: Array, free: BoolArray | None = None) -> _Point:
        """The most likely parameters, from an initial guess (n,); those that are not free stay."""
        low, high = self.row.bounds()
        free = np.ones(theta.size, dtype=bool) if free is None else free
        problem = Problem(lambda x, _: _Point(self, x), low, high, free, self.row.is_dead_time)
        return descend(problem, theta, _Point(self, theta), levels.ITERATIONS).point

    def errors(self, theta: Array) -> list[Array]:
        """Normalised prediction errors (n,) of each piece."""
        return [self._whitened(theta, k, False)[0] for k in range(len(self.row.pieces))]

    def information(self, theta: Array) -> tuple[Array, Array]:
        """Information (n, n) of theta, and half the gradient (n,) of -2 log likelihood."""
        information, slope = np.zeros((theta.size, theta.size)), np.zeros(theta.size)
        for k in range(len(self.row.pieces)):
            e, jacobian = self._whitened(theta, k, derivatives=True)
            information += jacobian.T @ jacobian
            slope += jacobian.T @ e
        return information, slope

    def _whitened(self, theta: Array, k: int, derivatives: bool) -> tuple[Array, Array]:
        """Normalised errors (n,) of piece k and their derivative (n, size), what is linear and unknown taken out."""
        row = self.row
        y, valid = row.measured(k)
        unknown = row.unknown(theta, k)
        plain = unknown.columns
        if derivatives:
            response, gradient = row.response_and_gradient(theta, k)
        else:
            response, gradient = row.response(theta, k), np.zeros((y.size, 0))
        v = np.where(valid, y - response, 0.0)
        signal = Signal(row.pieces[k].h * row.stride, v, valid, plain, self.jumps[k], ramps(self.noise.declared))
        linear, system = signal.linear, self.noise.system(signal.h)
        both, _ = whitened(system, np.column_stack([v, linear, gradient]), valid)
        own = both[:, 1 : 1 + linear.shape[1]]
        jacobian = np.zeros((both.shape[0], 0))
        if derivatives:
            weights = np.linalg.lstsq(own, both[:, 0], rcond=1e-7)[0]
            of_plain = np.asarray(weights[: plain.shape[1]], dtype=float)
            moved, _ = whitened(system, unknown.gradient(of_plain), valid)
            jacobian = -reduced(both[:, 1 + linear.shape[1] :] + moved, own)
        return reduced(both[:, :1], own)[:, 0], jacobian


@dataclass(frozen=True, eq=False)
class _Point:
    """One set of parameters: -2 log likelihood up to a constant, and its derivatives where they are asked for."""

    likelihood: _Likelihood
    theta: Array
    unit: float = 1.0

    @cached_property
    def cost(self) -> float:
        return sum(float(e @ e) for e in self.likelihood.errors(self.theta))

    @cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        return self.likelihood.information(self.theta)

    @property
    def information(self) -> Array:
        return self._derivatives[0]

    @property
    def slope(self) -> Array:
        return self._derivatives[1]


def _signals(row: Row, theta: Array, jumps: Sequence[tuple[int, ...]] | None, ramp: bool) -> list[Signal]:
    signals = []
    for k, piece in enumerate(row.pieces):
        y, valid = row.measured(k)
        v = np.where(valid, y - row.response(theta, k), 0.0)
        plain = row.nuisance(theta, k)
        signals.append(Signal(piece.h * row.stride, v, valid, plain, () if jumps is None else jumps[k], ramp))
    return signals


def _alternated(
    row: Row, theta: Array, declared: tuple[Part, ...]
) -> tuple[Array, Noise, tuple[tuple[int, ...], ...], float]:
    jumps: tuple[tuple[int, ...], ...] = ()
    for round_ in range(levels.FIT_ROUNDS):
        noise, signals = fit_noise_and_jumps(declared, _signals(row, theta, None, ramps(declared)))
        same = round_ > 0 and jumps == tuple(s.jumps for s in signals)
        jumps = tuple(s.jumps for s in signals)
        theta = _Likelihood(row, noise, jumps).best(theta).theta
        if same:
            break
    return theta, noise, jumps, criterion(noise, _signals(row, theta, jumps, ramps(declared)))


def _finished(row: Row, theta: Array, noise: Noise, jumps: tuple[tuple[int, ...], ...], value: float) -> DisturbedFit:
    point = _Point(_Likelihood(row, noise, jumps), theta)
    count = sum(int(row.measured(k)[1].sum()) for k in range(len(row.pieces)))
    linear = sum(row.nuisance(theta, k).shape[1] + len(jumps[k]) for k in range(len(row.pieces)))
    ratio = point.cost / max(count - theta.size - linear, 1)
    without = _Likelihood(row, replace(noise, declared=()), tuple(() for _ in jumps))
    background = without.information(theta)[0]
    alone = np.diag(background)
    kept = np.divide(np.diag(point.information), alone, out=np.ones(theta.size), where=alone > 0)
    errors = point.likelihood.errors(theta)
    return DisturbedFit(
        row=row,
        theta=theta,
        covariance=max(ratio, 1.0) * inverse(point.information),
        by_background=max(ratio, 1.0) * inverse(background),
        noise=noise,
        jumps=jumps,
        criterion=value,
        whiteness_p=correlogram(errors, levels.RESIDUAL_LAGS).p_value(levels.NOISE_PARAMETERS),
        lost=np.clip(1 - kept, 0.0, 1.0),
    )
