"""Equation error, SRIVC and RIVC: estimates from the recorded inputs and one output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import Refused
from trueplant.identify import levels
from trueplant.identify.instrumental.initial import (
    by_equation_error,
    filtered_regression,
    initial_guesses,
    scan,
    solve_instrumental,
)
from trueplant.identify.instrumental.noise import (
    ArmaNoise,
    choose_arma,
    colour,
    coloured_moment,
    fit_arma,
    without_noise_directions,
)
from trueplant.identify.instrumental.order import Order, slices
from trueplant.identify.instrumental.refine import Point, Refined, bounded, evaluate, refine
from trueplant.identify.instrumental.result import PolynomialFit, finished, instrument_covariance
from trueplant.identify.instrumental.samples import Samples, common_sample_time, samples_of
from trueplant.identify.pieces import Held
from trueplant.record.types import Segment


def state_variable_filter(
    segments: Sequence[Segment],
    output: int,
    order: Order,
    lam: float | None = None,
    held: Sequence[Held] = (),
    *,
    instrument: bool = False,
) -> PolynomialFit:
    """Equation error with the filter 1/(s + lam)^n; with `instrument`, its instrumental-variable refinement.

    Linear in the coefficients, no iteration, one element. Without lam (rad per time unit, somewhat above the fastest
    pole that matters) the one whose model simulates best is used; a dead time is searched on a grid and then kept.
    Least squares is biased by noise in the output, at any length of the record, and its covariance does not count the
    bias. The instrument is the response of the least-squares model to the same inputs: no bias, but the filter is not
    matched to the plant, so that the variance is above SRIVC's.

    Young (1970), Automatica 6, 271-287; Garnier, Mensler and Richard (2003), Int. J. Control 76, 1337-1357.

    Raises Refused where output or input do not move.
    """
    samples = samples_of(segments, output, held)
    _check_inputs([order], samples)
    if not order.keeps_dead_time:
        order = replace(order, dead_time=float(scan(order, samples)[0][1][-1]))
    found = by_equation_error(order, samples, lam)
    regressors, targets = filtered_regression(order, samples, found.lam)
    zetas = regressors
    bias = ""
    notes = [f"state-variable filter at {found.lam:.4g} rad per time unit"]
    if instrument:
        modelled = [order.simulate(found.theta, s) for s in samples]
        zetas, _ = filtered_regression(order, samples, found.lam, modelled)
    else:
        bias = "least squares is biased by noise in the output; its standard errors do not count that"
    zeta, phi, target = np.vstack(zetas), np.vstack(regressors), np.concatenate(targets)
    solution = solve_instrumental(zeta if instrument else phi, phi, target)
    errors = [y - x @ solution for x, y in zip(regressors, targets, strict=True)]
    cost, count = float(sum(e @ e for e in errors)), target.size
    moment, _ = coloured_moment(zetas, errors, [np.ones(e.size, dtype=bool) for e in errors])
    covariance = instrument_covariance(zeta.T @ phi, moment, zeta.T @ zeta)
    return PolynomialFit(
        "state-variable filter, instrument" if instrument else "equation error",
        (order,),
        solution[:-1],
        covariance[:-1, :-1],
        cost / max(count - solution.size, 1),
        cost,
        count,
        ArmaNoise(),
        True,
        1,
        tuple(filter(None, [*notes, bias])),
        bias,
    )


def srivc(
    segments: Sequence[Segment],
    output: int,
    orders: Sequence[Order],
    initial: Array | None = None,
    held: Sequence[Held] = (),
) -> PolynomialFit:
    """Simplified refined instrumental variables: the least output error, as an iteration of linear problems.

    `orders` has one entry an element of the row, each with its own denominator and dead time. It starts from equation
    errors and a grid over dead times, or from `initial` (stacked coefficients). `held` elements keep their value.
    Unbiased in open loop whatever the noise, and efficient if that is white (Young, Garnier and Gilson 2008). In closed
    loop it is unbiased only if the noise is white: use rivc or clsrivc there. Sample times need not be constant.

    Covariance: s2 (sum zeta zeta')^-1 for white errors, else with their autoregressive covariance between two of these.

    Raises Refused where the output was not measured or does not answer, LoopError for orders that make no sense.
    """
    samples = samples_of(segments, output, held)
    _check_inputs(orders, samples)
    refined = best_from_guesses(orders, samples, initial)
    return finished("SRIVC", orders, samples, refined, bias=_closed_loop_bias(segments, refined.point))


def rivc(
    segments: Sequence[Segment],
    output: int,
    orders: Sequence[Order],
    noise_order: tuple[int, int] | None = None,
    initial: Array | None = None,
    held: Sequence[Held] = (),
) -> PolynomialFit:
    """Refined instrumental variables with a noise model: SRIVC with a prefilter D/C for noise v = C(q)/D(q) e.

    noise_order (p, q), p of D and q of C, is chosen by the Bayesian criterion from a short list where not given; noise
    and plant are estimated in turn. Efficient if noise of that order is right, in closed loop too, where a noise model
    that is not right biases the plant. Needs a constant sample time.

    Young and Jakeman (1980), Int. J. Control 31, 741-764; Young, Garnier and Gilson (2008).
    """
    samples = samples_of(segments, output, held)
    common_sample_time(samples, "a discrete noise model")
    _check_inputs(orders, samples)
    refined = best_from_guesses(orders, samples, initial)
    noise = ArmaNoise()
    valid = [s.valid for s in samples]
    for _ in range(levels.NOISE_ROUNDS):
        if noise_order is None:
            noise = choose_arma(refined.point.raw, valid)
            noise_order = noise.d.size, noise.c.size
        else:
            noise = fit_arma(refined.point.raw, valid, *noise_order)
        before = refined.theta
        refined = _polished(orders, samples, refine(orders, refined.theta, samples, noise=noise), noise)
        if np.all(np.abs(refined.theta - before) <= levels.NOISE_SETTLED * refined.point.std):
            break
    point = refined.point
    zetas = without_noise_directions(noise, point.instruments, point.raw, point.errors, point.usable)
    information = sum((z.T @ z for z in zetas), np.zeros_like(point.power))
    joint = replace(refined, point=replace(point, instruments=zetas, cross=information, power=information))
    return finished("RIVC", orders, samples, joint, noise, [f"noise model {noise}"])


def best_from_guesses(orders: Sequence[Order], samples: Sequence[Samples], initial: Array | None = None) -> Refined:
    """The least cost from all initial guesses, its dead times compared with those of neighbouring sample intervals."""
    if initial is not None and len(initial) != slices(orders)[-1].stop:
        raise Refused(
            f"initial must have {slices(orders)[-1].stop} coefficients, not {len(initial)}: one a name of each order"
        )
    candidates = [np.asarray(initial, dtype=float)] if initial is not None else initial_guesses(orders, samples)
    found = [refine(orders, theta, samples) for theta in candidates]
    best = min(found, key=lambda refined: refined.point.cost)
    return _polished(orders, samples, best, None)


def _polished(
    orders: Sequence[Order], samples: Sequence[Samples], refined: Refined, noise: ArmaNoise | None
) -> Refined:
    """Lower minima in the sample intervals beside that of each dead time, where held inputs give each its own."""
    step = min(float(np.median(np.diff(s.t))) for s in samples)
    for order, part in zip(orders, slices(orders), strict=True):
        if order.keeps_dead_time:
            continue
        trials = []
        for shift in levels.NEIGHBOUR_INTERVALS:
            theta = refined.theta.copy()
            theta[part.stop - 1] = (np.floor(theta[part.stop - 1] / step) + shift + 0.5) * step
            trials.append(evaluate(orders, bounded(orders, theta, samples), samples, noise=noise))
            if trials[-1].cost < refined.point.cost * (1 + 20 / max(refined.point.count, 1)):
                rival = refine(orders, theta, samples, noise=noise, rounds=20)
                if rival.point.cost < refined.point.cost * (1 - 1e-9):
                    refined = rival
    return refined


def _check_inputs(orders: Sequence[Order], samples: Sequence[Samples]) -> None:
    for order in orders:
        if not any(np.any(s.inputs[order.column]) for s in samples):
            raise Refused(
                f"input {order.column + 1} does not move in these records: nothing can be said of its element"
            )


def _closed_loop_bias(segments: Sequence[Segment], point: Point) -> str:
    if not any(segment.closed for segment in segments) or colour(point.errors, point.usable) == 0:
        return ""
    return "coloured noise in a closed loop biases SRIVC, which its standard errors do not count: see rivc, clsrivc"
