"""Initial guesses of the iterations: equation errors with state-variable filters, dead times on a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import Refused
from trueplant.identify import levels
from trueplant.identify.instrumental.order import Order, nuisance, slices
from trueplant.identify.instrumental.refine import refine
from trueplant.identify.instrumental.samples import Samples
from trueplant.identify.instrumental.several import step_records
from trueplant.identify.linear_algebra import orthonormal


def filter_range(samples: Sequence[Samples]) -> Array:
    """(FILTER_CUTOFFS,) cut-off frequencies from a few periods a record to a quarter of the sampling frequency."""
    span = max(s.span for s in samples)
    step = min(float(np.median(np.diff(s.t))) for s in samples)
    fastest = np.pi / step / 4
    return np.geomspace(min(30 / span, fastest), fastest, levels.FILTER_CUTOFFS)


@dataclass(frozen=True, eq=False)
class EquationError:
    """One element by least squares on the filtered differential equation."""

    theta: Array
    lam: float
    cost: float
    """Sum of squares of the simulated output error."""


def filtered_regression(
    order: Order, samples: Sequence[Samples], lam: float, outputs: Sequence[Array] | None = None
) -> tuple[list[Array], list[Array]]:
    """For each record the regressors (N, n + 1) and target (N,) of an order whose dead time is kept:

        s^n y = -a1 s^(n-1) y - ... + b0 s^m u + ... + constant,    all filtered by 1/(s + lam)^n

    u exactly for its hold, y as running linearly between measured samples, from the mean of its first ones (the
    constant stands for what is wrong with that). A record that starts in motion is used from 5/lam on. `outputs` (N,)
    stand in for y: those of a model give the instrument.
    """
    n, den = order.poles, np.poly(np.full(order.poles, -lam)).astype(float)
    of_y = np.eye(n + 1)[: order.lags + 1]
    of_u = np.eye(n + 1)[n - order.zeros :]
    regressors, targets = [], []
    for k, record in enumerate(samples):
        if outputs is None:
            y = np.interp(record.t, record.t[record.valid], record.y[record.valid])
            y = y - np.mean(y[: max(3, y.size // 200)])
        else:
            y = outputs[k]
        filtered = record.respond(of_y, den, 0.0, y, "linear").T
        driven = record.respond(
            of_u, den, order.delay(np.zeros(0)), record.inputs[order.column], record.hold[order.column]
        ).T
        keep = record.valid & (record.at_rest | (record.t > min(5 / lam, record.span / 2)))
        regressors.append(np.hstack([-filtered[:, 1:], driven, np.ones((y.size, 1))])[keep])
        targets.append(filtered[keep, 0])
    return regressors, targets


def solve_instrumental(zeta: Array, phi: Array, target: Array) -> Array:
    """(zeta' phi)^-1 zeta' target with levelled columns; least squares where zeta is phi."""
    own, scale = np.linalg.norm(zeta, axis=0), np.linalg.norm(phi, axis=0)
    if np.any(scale == 0) or np.any(own == 0):
        raise Refused("an input or the output does not move in these records: nothing can be estimated")
    if zeta is phi:
        solved = np.linalg.lstsq(phi / scale, target, rcond=1e-13)[0]
    else:
        solved = np.linalg.lstsq((zeta / own).T @ (phi / scale), (zeta / own).T @ target, rcond=1e-13)[0]
    return np.asarray(solved / scale, dtype=float)


def by_equation_error(order: Order, samples: Sequence[Samples], lam: float | None = None) -> EquationError:
    """One element whose dead time is kept, from the filter whose model simulates the record best, or the given one."""
    best: EquationError | None = None
    for value in filter_range(samples) if lam is None else [lam]:
        regressors, targets = filtered_regression(order, samples, float(value))
        phi = np.vstack(regressors)
        theta = order.stable(solve_instrumental(phi, phi, np.concatenate(targets))[:-1])
        left = simulation_cost([order], theta, samples)
        if np.isfinite(left) and (best is None or left < best.cost):
            best = EquationError(theta, float(value), left)
    if best is None:
        raise Refused(f"no stable model of {order.poles} poles from input {order.column + 1} could be found: lower it")
    return best


def simulation_cost(orders: Sequence[Order], theta: Array, samples: Sequence[Samples]) -> float:
    """Sum of squares of the output error, the operating point and free responses fitted."""
    total = 0.0
    for record in samples:
        y = np.zeros(record.t.size)
        for order, part in zip(orders, slices(orders), strict=True):
            y += order.simulate(theta[part], record)
        if not np.all(np.isfinite(y)):
            return np.inf
        v = (record.y - y)[record.valid]
        basis = orthonormal(nuisance(orders, theta, record)[record.valid])
        total += float(v @ v - np.sum((basis.T @ v) ** 2))
    return total


def scan(order: Order, samples: Sequence[Samples], share: float | None = None) -> list[tuple[float, Array]]:
    """(cost, parameters) at the lowest minima over dead time, best first, one element alone.

    The cost of a dead time has several minima where the response oscillates or the input does; at each value on a
    grid over the whole range (up to a share of the record, where none is declared) the coefficients are fitted anew.
    """
    longest = (levels.LONGEST_DEAD_TIME if share is None else share) * max(s.span for s in samples)
    low, high = order.dead_time_range(longest)
    step = min(float(np.median(np.diff(s.t))) for s in samples)
    count = 1 if high <= low else int(np.clip(np.ceil((high - low) / step) + 1, 2, levels.DEAD_TIME_GRID))
    tried = [replace(order, dead_time=float(dead_time)) for dead_time in np.linspace(low, high, count)]
    looks = [
        look for fixed in tried[:: levels.DEAD_TIME_COARSE] if (look := _attempt(fixed, samples, None)) is not None
    ]
    if not looks:
        raise Refused(f"no dead time of input {order.column + 1} gave a stable model: lower the order")
    lam = min(looks, key=lambda look: look.cost).lam
    found: list[tuple[float, Array]] = []
    for fixed in tried:
        begun = _attempt(fixed, samples, lam)
        if begun is None:
            continue
        better = refine([fixed], begun.theta, samples, rounds=levels.SCAN_ROUNDS if count > 1 else 10)
        p = better.theta if order.keeps_dead_time else np.append(better.theta, fixed.delay(better.theta))
        found.append((better.point.cost, p))
    if not found:
        raise Refused(f"no dead time of input {order.column + 1} gave a stable model: lower the order")
    costs = np.array([cost for cost, _ in found])
    padded = np.r_[np.inf, costs, np.inf]
    lowest = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    near = lowest[costs[lowest] <= levels.HOPELESS * costs.min()]
    return [found[k] for k in sorted(near, key=lambda k: costs[k])[: levels.MINIMA_KEPT]]


def _attempt(order: Order, samples: Sequence[Samples], lam: float | None) -> EquationError | None:
    try:
        return by_equation_error(order, samples, lam)
    except Refused:
        return None


def initial_guesses(orders: Sequence[Order], samples: Sequence[Samples]) -> list[Array]:
    """Parameters of all elements from which to refine.

    One element: the minima over its dead time. Several: each from the step response that a long ARX model of the row
    gives it, so that each may have its own denominator and dead time, in closed loop too.
    """
    if len(orders) == 1:
        return [p for _, p in scan(orders[0], samples)]
    alone = step_records(orders, samples)
    return [np.concatenate([scan(order, [s], share=0.5)[0][1] for order, s in zip(orders, alone, strict=True)])]
