"""Plant and unmeasured disturbance told apart: prediction errors with the declared disturbance in the noise model.

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

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array, BoolArray
from trueplant.disturbance.kalman import whitened
from trueplant.disturbance.models import Part, ramps
from trueplant.disturbance.noise import Noise, Signal, criterion, fit_noise_and_jumps, reduced
from trueplant.identify import Row, RowFit
from trueplant.identify.linear_algebra import inverse

ITERATIONS = 40
ROUNDS = 3
"""Of estimating the noise for the plant and the plant for the noise."""
SETTLED = 1e-3
"""Change of -2 log likelihood at which the descent ends."""
LAGS = 25


@dataclass(frozen=True, eq=False)
class DisturbedFit:
    """A row of the plant estimated along with its disturbance."""

    row: Row
    theta: Array
    """(n,) parameters of the elements, stacked in the order of row.specs."""
    covariance: Array
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


def fit_with_disturbance(fit: RowFit, declared: Sequence[Part]) -> DisturbedFit:
    """Estimate the row of `fit` again, with the declared disturbance in its noise model.

    Starts from the fit's parameters and from the model's, and returns the better end of both.
    """
    row = replace(fit.row, pieces=tuple(replace(piece, jumps=()) for piece in fit.row.pieces))
    starts = [fit.theta]
    known = [spec.start for spec in row.specs if spec.start is not None]
    if len(known) == len(row.specs):
        starts.append(np.concatenate([np.array(start, dtype=float) for start in known]))
    ends = [_alternated(row, np.clip(start, *row.bounds()), tuple(declared)) for start in starts]
    return _finished(row, *min(ends, key=lambda end: end[3]))


def likelihood_p(found: DisturbedFit, index: Array, values: Array, largest: bool = False) -> float:
    """p-value that the parameters `index` have these values, all others free, under the disturbance that was found.

    largest: under the disturbance as large as it was declared.
    """
    noise = replace(found.noise, scale=1.0) if largest else found.noise
    held = np.ones(found.theta.size, dtype=bool)
    held[index] = False
    best = _descend(found.row, found.theta, noise, found.jumps) if largest else found.theta
    theta = best.copy()
    theta[index] = values
    theta = _descend(found.row, theta, noise, found.jumps, held)
    rise = _cost(found.row, theta, noise, found.jumps) - _cost(found.row, best, noise, found.jumps)
    return float(chi2.sf(max(rise, 0.0), index.size))


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
    for round_ in range(ROUNDS):
        noise, signals = fit_noise_and_jumps(declared, _signals(row, theta, None, ramps(declared)))
        same = round_ > 0 and jumps == tuple(s.jumps for s in signals)
        jumps = tuple(s.jumps for s in signals)
        theta = _descend(row, theta, noise, jumps)
        if same:
            break
    return theta, noise, jumps, criterion(noise, _signals(row, theta, jumps, ramps(declared)))


def _whitened_piece(
    row: Row, theta: Array, k: int, noise: Noise, jumps: tuple[int, ...], derivatives: bool
) -> tuple[Array, Array, float]:
    """Normalised errors (n,) and their derivative (n, size) for piece k, linear parts removed; sum of log variances."""
    y, valid = row.measured(k)
    unknown = row.unknown(theta, k)
    plain = unknown.columns
    if derivatives:
        response, gradient = row.response_and_gradient(theta, k)
    else:
        response, gradient = row.response(theta, k), np.zeros((y.size, 0))
    v = np.where(valid, y - response, 0.0)
    signal = Signal(row.pieces[k].h * row.stride, v, valid, plain, jumps, ramps(noise.declared))
    linear, system = signal.linear, noise.system(signal.h)
    both, logs = whitened(system, np.column_stack([v, linear, gradient]), valid)
    own = both[:, 1 : 1 + linear.shape[1]]
    jacobian = np.zeros((both.shape[0], 0))
    if derivatives:
        weights = np.linalg.lstsq(own, both[:, 0], rcond=1e-7)[0]
        of_plain = np.asarray(weights[: plain.shape[1]], dtype=float)
        moved, _ = whitened(system, unknown.gradient(of_plain), valid)
        jacobian = -reduced(both[:, 1 + linear.shape[1] :] + moved, own)
    return reduced(both[:, :1], own)[:, 0], jacobian, logs


def _cost(row: Row, theta: Array, noise: Noise, jumps: Sequence[tuple[int, ...]]) -> float:
    errors = (_whitened_piece(row, theta, k, noise, jumps[k], False)[0] for k in range(len(row.pieces)))
    return sum(float(e @ e) for e in errors)


def _normal(row: Row, theta: Array, noise: Noise, jumps: Sequence[tuple[int, ...]]) -> tuple[Array, Array, float]:
    information, slope, cost = np.zeros((theta.size, theta.size)), np.zeros(theta.size), 0.0
    for k in range(len(row.pieces)):
        e, jacobian, _ = _whitened_piece(row, theta, k, noise, jumps[k], derivatives=True)
        information += jacobian.T @ jacobian
        slope += jacobian.T @ e
        cost += float(e @ e)
    return information, slope, cost


def _descend(
    row: Row, theta: Array, noise: Noise, jumps: Sequence[tuple[int, ...]], free: BoolArray | None = None
) -> Array:
    """Levenberg-Marquardt for a given disturbance."""
    low, high = row.bounds()
    free = np.ones(theta.size, dtype=bool) if free is None else free
    positive = np.isfinite(low) & (low > 0)
    damping = 1e-3
    information, slope, cost = _normal(row, theta, noise, jumps)
    for _ in range(ITERATIONS):
        pinned = ((theta <= low) & (slope > 0)) | ((theta >= high) & (slope < 0))
        active = free & ~pinned & (np.diag(information) > 0)
        if not active.any():
            break
        scale = np.sqrt(np.diag(information)[active])
        normal = information[np.ix_(active, active)] / np.outer(scale, scale)
        for _ in range(12):
            step = np.zeros(theta.size)
            step[active] = -np.linalg.solve(normal + damping * np.eye(scale.size), slope[active] / scale) / scale
            trial = theta + step
            trial[positive] = np.clip(trial[positive], theta[positive] / 3, theta[positive] * 3)
            trial = np.clip(trial, low, high)
            after = _cost(row, trial, noise, jumps)
            if np.isfinite(after) and after <= cost:
                break
            damping = min(damping * 8, 1e8)
        else:
            break
        gain, theta, damping = cost - after, trial, max(damping / 10, 1e-9)
        information, slope, cost = _normal(row, theta, noise, jumps)
        if gain <= SETTLED:
            break
    return theta


def _finished(row: Row, theta: Array, noise: Noise, jumps: tuple[tuple[int, ...], ...], value: float) -> DisturbedFit:
    information, _, cost = _normal(row, theta, noise, jumps)
    count = sum(int(row.measured(k)[1].sum()) for k in range(len(row.pieces)))
    linear = sum(row.nuisance(theta, k).shape[1] + len(jumps[k]) for k in range(len(row.pieces)))
    ratio = cost / max(count - theta.size - linear, 1)
    without = replace(noise, declared=())
    alone = np.diag(_normal(row, theta, without, tuple(() for _ in jumps))[0])
    kept = np.divide(np.diag(information), alone, out=np.ones(theta.size), where=alone > 0)
    return DisturbedFit(
        row=row,
        theta=theta,
        covariance=max(ratio, 1.0) * inverse(information),
        noise=noise,
        jumps=jumps,
        criterion=value,
        whiteness_p=_whiteness(row, theta, noise, jumps),
        lost=np.clip(1 - kept, 0.0, 1.0),
    )


def _whiteness(row: Row, theta: Array, noise: Noise, jumps: Sequence[tuple[int, ...]]) -> float:
    products, power, count = np.zeros(LAGS), 0.0, 0
    for k in range(len(row.pieces)):
        e, _, _ = _whitened_piece(row, theta, k, noise, jumps[k], derivatives=False)
        if e.size > 2 * LAGS:
            products += [float(e[j:] @ e[:-j]) for j in range(1, LAGS + 1)]
            power, count = power + float(e @ e), count + e.size
    if power <= 0:
        return 1.0
    return float(chi2.sf(count * float(np.sum((products / power) ** 2)), LAGS - 3))
