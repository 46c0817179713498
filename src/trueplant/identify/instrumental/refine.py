"""The refined instrumental variable iteration, the same for SRIVC, RIVC and CLSRIVC.

With y = sum_j B_j/A_j e^(-theta_j s) u_j + v, each round solves

    sum zeta (eps - phi' step) = 0

where eps is the simulated output error, zeta its exact gradient on the instrument's inputs, and phi the gradient
on the recorded inputs plus 1/A-filtered errors: phi' p is what the filtered record itself says of the
coefficients, which is what lets the iteration start far away. At convergence sum zeta eps = 0 whatever the hold of
the measured output between samples, so that the estimate depends on the hold of the inputs only.

Young and Jakeman (1980), Int. J. Control 31, 741-764; Young, Garnier and Gilson (2008), in Garnier and Wang (eds.),
Identification of Continuous-time Models from Sampled Data, Springer; dead time as in Chen, Garnier and Gilson (2015).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.instrumental.noise import ArmaNoise
from trueplant.identify.instrumental.order import Order, nuisance, nuisance_gradient, slices
from trueplant.identify.instrumental.samples import Samples
from trueplant.identify.linear_algebra import orthonormal

Instruments = Callable[[Array], Sequence[Samples]]
"""The records with the inputs of the instrument in place of the recorded ones, from the present parameters."""


@dataclass(frozen=True, eq=False)
class Point:
    """Everything at one set of parameters; lists have one entry a record."""

    cost: float
    count: int
    errors: list[Array]
    """Whitened output errors (N,), 0 where not usable."""
    raw: list[Array]
    """Output errors (N,) before whitening, 0 where not measured."""
    usable: list[BoolArray]
    instruments: list[Array]
    """zeta (N, n), nuisance directions taken out."""
    cross: Array
    """sum zeta psi' (n, n), psi the gradient on the recorded inputs."""
    pseudo: Array
    """sum zeta phi' (n, n)."""
    moment: Array
    """sum zeta eps (n,)."""
    power: Array
    """sum zeta zeta' (n, n)."""

    @property
    def variance(self) -> float:
        return self.cost / max(self.count - self.moment.size, 1)

    @property
    def left(self) -> float:
        """moment' power^-1 moment: what the instruments still see in the errors."""
        scale = np.sqrt(np.maximum(np.diag(self.power), 1e-300))
        inverse = np.linalg.pinv(self.power / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        levelled = self.moment / scale
        return float(levelled @ inverse @ levelled)

    @property
    def std(self) -> Array:
        """(n,) standard errors if the errors were white, against which steps are measured."""
        scale = np.sqrt(np.maximum(np.diag(self.power), 1e-300))
        inverse = np.linalg.pinv(self.power / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        return np.asarray(np.sqrt(np.maximum(self.variance * np.diag(inverse), 0.0)) / scale, dtype=float)


@dataclass(frozen=True, eq=False)
class Refined:
    theta: Array
    point: Point
    converged: bool
    rounds: int


def evaluate(
    orders: Sequence[Order],
    theta: Array,
    samples: Sequence[Samples],
    instruments: Sequence[Samples] | None = None,
    noise: ArmaNoise | None = None,
) -> Point:
    """Errors, instruments and their moments at theta; the instrument's inputs are the recorded ones unless given."""
    noise = noise or ArmaNoise()
    n = theta.size
    cross, pseudo, power, moment = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    errors, raw, usable, zetas = [], [], [], []
    for k, record in enumerate(samples):
        total, psi = _gradient(orders, theta, record)
        zeta = psi if instruments is None else _gradient(orders, theta, instruments[k])[1]
        ok = noise.usable(record.valid)
        unknown = nuisance(orders, theta, record)
        seen = noise.whiten(unknown)[ok]
        basis = orthonormal(seen)
        v = np.where(record.valid, record.y - total, 0.0)
        level = np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
        weights = np.linalg.lstsq(seen / level, noise.whiten(v)[ok], rcond=1e-7)[0] / level
        v = np.where(record.valid, v - unknown @ weights, 0.0)
        released = nuisance_gradient(orders, theta, record, weights)
        psi, zeta = psi + released, zeta + released
        filtered = np.column_stack(
            [order.output_filter(theta[part], record, v) for order, part in zip(orders, slices(orders), strict=True)]
        )
        e = noise.whiten(v)[ok]
        z = _projected(noise.whiten(zeta)[ok], basis)
        p = _projected(noise.whiten(psi)[ok], basis)
        f = _projected(noise.whiten(filtered)[ok], basis)
        cross += z.T @ p
        pseudo += z.T @ (p - f)
        power += z.T @ z
        moment += z.T @ e
        raw.append(v)
        usable.append(ok)
        errors.append(_laid(e, ok))
        zetas.append(_laid(z, ok))
    cost = float(sum(e @ e for e in errors))
    count = int(sum(ok.sum() for ok in usable))
    return Point(cost, count, errors, raw, usable, zetas, cross, pseudo, moment, power)


def refine(
    orders: Sequence[Order],
    theta: Array,
    samples: Sequence[Samples],
    instruments: Instruments | None = None,
    noise: ArmaNoise | None = None,
    rounds: int = 50,
) -> Refined:
    """Iterate from theta until steps are small against the standard errors, at most `rounds` times.

    A step that more than doubles the cost is halved; unstable poles are reflected into the left half-plane. After
    PSEUDOLINEAR_ROUNDS every step has to lower the cost (with instruments of their own: the moments they leave), as at
    dead times of whole samples, where the slope jumps and full steps would go to and fro.
    """

    def at(p: Array) -> Point:
        return evaluate(orders, p, samples, None if instruments is None else instruments(p), noise)

    def merit(p: Point) -> float:
        return p.cost if instruments is None else p.left

    theta = bounded(orders, theta, samples)
    point = at(theta)
    done = 0
    for done in range(1, rounds + 1):
        late = done > levels.PSEUDOLINEAR_ROUNDS
        step = _solve(point.cross if late else point.pseudo, point.moment)
        for _ in range(12):
            trial = bounded(orders, theta + step, samples)
            candidate = at(trial)
            if not np.isfinite(candidate.cost):
                step = step / 4
            elif (late and merit(candidate) >= merit(point)) or candidate.cost > 2 * point.cost + 1e-300:
                step = step / 2
            else:
                break
        else:
            return Refined(theta, point, late, done)
        moved = np.abs(trial - theta)
        theta, point = trial, candidate
        if np.all(moved <= np.maximum(levels.INSTRUMENT_SETTLED * point.std, 1e-9 * np.abs(theta))):
            return Refined(theta, point, True, done)
    return Refined(theta, point, False, done)


def bounded(orders: Sequence[Order], theta: Array, samples: Sequence[Samples]) -> Array:
    """theta with stable poles, and dead times inside their ranges."""
    theta = theta.copy()
    longest = levels.LONGEST_DEAD_TIME * max(s.span for s in samples)
    for order, part in zip(orders, slices(orders), strict=True):
        p = order.stable(theta[part])
        if not order.keeps_dead_time:
            p = np.append(p[:-1], np.clip(p[-1], *order.dead_time_range(longest)))
        theta[part] = p
    return theta


def _gradient(orders: Sequence[Order], theta: Array, record: Samples) -> tuple[Array, Array]:
    total, columns = np.zeros(record.t.size), []
    for order, part in zip(orders, slices(orders), strict=True):
        y, gradient = order.gradient(theta[part], record)
        total += y
        columns.append(gradient)
    return total, np.hstack(columns)


def _projected(x: Array, basis: Array) -> Array:
    return x - basis @ (basis.T @ x)


def _laid(x: Array, ok: BoolArray) -> Array:
    out = np.zeros((ok.size, *x.shape[1:]))
    out[ok] = x
    return out


def _solve(matrix: Array, right: Array) -> Array:
    """matrix^-1 right, rows and columns levelled first; directions that the data do not move stay where they are."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    solved = np.linalg.lstsq(matrix / np.outer(scale, scale), right / scale, rcond=1e-12)[0]
    return np.asarray(solved / scale, dtype=float)
