"""CLSRIVC and the two-stage method: instruments that the noise cannot reach, because they follow from set-points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError, Refused
from trueplant.identify import levels
from trueplant.identify.instrumental.open_loop import best_from_guesses
from trueplant.identify.instrumental.order import Order, slices
from trueplant.identify.instrumental.refine import Instruments, Refined, refine
from trueplant.identify.instrumental.result import PolynomialFit, finished
from trueplant.identify.instrumental.samples import Samples, common_sample_time, samples_of
from trueplant.identify.levels import INSTRUMENT_SETTLED
from trueplant.identify.pieces import Held
from trueplant.loop.controller import Controller
from trueplant.loop.simulate import simulate
from trueplant.lti.transfer import TransferFunction, TransferMatrix
from trueplant.record.types import Segment


def clsrivc(
    segments: Sequence[Segment],
    orders: Mapping[int, Sequence[Order]],
    controller: Controller,
    initial: Mapping[int, Array] | None = None,
    held: Mapping[int, Sequence[Held]] | None = None,
) -> dict[int, PolynomialFit]:
    """Closed-loop simplified refined instrumental variables, one result an output of `orders`.

    The instrument is the noise-free loop: set-points r driven through the declared controller and the plant as
    estimated so far. Noise cannot reach it, so that the estimate has no bias under noise of any colour, and none under
    a wrong controller either: that only makes the instrument weaker, which the covariance counts. With the right
    controller and white noise its covariance s2 (sum zeta zeta')^-1 is the least that instruments from r can have.

    `controller` is without a pv_transform (`Controller.linearised`). `orders` names the elements of every output of the
    plant: the instrument needs the whole loop. It starts from the two-stage method (that from `initial`, the
    coefficients of each output, where given), which is also what is left where the loop cannot be simulated (unstable,
    or no law that runs in time): a note says so. OP limits are ignored in the instrument. `held` elements of each
    output keep their declared value. A record in open loop has OP itself for its instrument, which no noise reaches
    there.

    Gilson, Garnier, Young and Van den Hof (2008), in Garnier and Wang (eds.), Identification of Continuous-time Models
    from Sampled Data, Springer.

    Raises Refused where r is not recorded or does not move, LoopError where outputs are missing from `orders`.
    """
    n_y, n_u = controller.n_y, controller.n_u
    if set(orders) != set(range(n_y)):
        raise LoopError(f"the instrument needs the whole loop: give orders for each of the {n_y} outputs")
    held = held or {}
    parts, samples, projected = {}, {}, {}
    for i, row in orders.items():
        parts[i], samples[i], projected[i] = _projected(
            segments, i, row, None if initial is None else initial.get(i), held.get(i, ())
        )
    notes: list[str] = []
    for _ in range(levels.CLSRIVC_ROUNDS):
        plant = _matrix(orders, {i: refined.theta for i, refined in parts.items()}, held, n_y, n_u)
        try:
            inputs = [_noise_free(plant, controller, segment) if segment.closed else segment.u for segment in segments]
        except LoopError as error:
            notes = [
                f"the declared loop could not be simulated ({error}): the instrument is the projection on set-points"
            ]
            break
        settled = True
        for i, row in orders.items():
            instruments = samples_of([replace(s, u=u) for s, u in zip(segments, inputs, strict=True)], i)
            before = parts[i].theta
            parts[i] = refine(row, before, samples[i], _always(instruments), rounds=2)
            moved, small = (
                np.abs(parts[i].theta - before),
                np.maximum(INSTRUMENT_SETTLED * parts[i].point.std, 1e-9 * np.abs(before)),
            )
            settled &= bool(np.all(moved <= small))
        if settled:
            break
    return {
        i: finished(
            "CLSRIVC", row, samples[i], replace(parts[i], converged=settled if not notes else True), notes=notes
        )
        for i, row in orders.items()
    }


def two_stage(
    segments: Sequence[Segment],
    output: int,
    orders: Sequence[Order],
    initial: Array | None = None,
    held: Sequence[Held] = (),
) -> PolynomialFit:
    """The projection method: no controller needed, only that set-points were recorded and moved.

    First each recorded input is projected on the past of all set-points (least squares on sums over blocks of lags
    that grow geometrically): what follows from r, free of noise. Then the plant is estimated with these as the
    inputs of the instrument, while the equation keeps the recorded inputs, so that what the projection misses costs
    variance and no bias. Holds for saturating, nonlinear and unknown controllers. A record in open loop has OP itself
    for its instrument.

    Van den Hof and Schrama (1993), Automatica 29, 1523-1527; Forssell and Ljung (2000), Automatica 36, 1857-1873.

    Raises Refused where set-points are not recorded or do not move.
    """
    refined, samples, notes = _projected(segments, output, orders, initial, held)
    return finished("two-stage", orders, samples, refined, notes=notes)


def _projected(
    segments: Sequence[Segment], output: int, orders: Sequence[Order], initial: Array | None, held: Sequence[Held]
) -> tuple[Refined, tuple[Samples, ...], list[str]]:
    samples = samples_of(segments, output, held)
    common_sample_time(samples, "an instrument from set-points")
    inputs, shares = projected_inputs(segments)
    instruments = samples_of([replace(s, u=u) for s, u in zip(segments, inputs, strict=True)], output)
    begun = best_from_guesses(orders, samples, initial)
    refined = refine(orders, begun.theta, samples, _always(instruments))
    said = ", ".join(f"{100 * share:.0f} %" for share in shares)
    return refined, samples, [f"set-points explain {said} of the variance of the inputs"]


def _always(instruments: Sequence[Samples]) -> Instruments:
    """Instruments that do not follow the parameters."""
    return lambda _: instruments


def projected_inputs(segments: Sequence[Segment]) -> tuple[list[Array], Array]:
    """For each segment its inputs (N, n_u) as far as they follow from past set-points, and the share that does.

    In open loop all of them, which are no answer to noise.
    """
    closed = [segment for segment in segments if segment.closed]
    if not closed:
        return [s.u - s.u[0] for s in segments], np.ones(segments[0].u.shape[1])
    if not all(np.all(np.isfinite(segment.r)) for segment in closed):
        raise Refused("an instrument from set-points needs recorded set-points: use srivc or rivc")
    if not any(np.any(np.ptp(s.setpoints, axis=0) > 0) for s in closed):
        raise Refused("no set-point moves in these records: instruments from set-points have nothing to follow")
    columns = [_blocks(s.r - s.r[0]) for s in closed]
    width = min(c.shape[1] for c in columns)
    bases = [_centred(c[:, :width]) for c in columns]
    inputs = [s.u - s.u.mean(axis=0) for s in closed]
    stacked = np.vstack(bases)
    scale = np.linalg.norm(stacked, axis=0)
    kept = scale > 1e-9 * scale.max()
    weights = np.linalg.lstsq(stacked[:, kept] / scale[kept], np.vstack(inputs), rcond=1e-10)[0]
    found = [b[:, kept] / scale[kept] @ weights for b in bases]
    power = np.sum(np.vstack(inputs) ** 2, axis=0)
    shares = np.sum(np.vstack(found) ** 2, axis=0) / np.where(power > 0, power, 1.0)
    following = iter(found)
    projected = [next(following) if s.closed else s.u - s.u[0] for s in segments]
    return projected, np.asarray(shares, dtype=float)


def _blocks(r: Array) -> Array:
    """(N, n_blocks n_r): means of each set-point over blocks of lags of growing length."""
    n = len(r)
    edges = [0]
    while edges[-1] < levels.SETPOINT_MEMORY * n:
        edges.append(max(edges[-1] + 1, int(edges[-1] * levels.LAG_GROWTH)))
    total = np.vstack([np.zeros((1, r.shape[1])), np.cumsum(r, axis=0)])
    at = np.arange(1, n + 1)

    def up_to(lag: int) -> Array:
        return np.asarray(total[np.maximum(at - lag, 0)])

    blocks = [(up_to(a) - up_to(b)) / (b - a) for a, b in pairwise(edges)]
    return np.hstack(blocks)


def _centred(x: Array) -> Array:
    return np.asarray(x - x.mean(axis=0))


def _noise_free(plant: TransferMatrix, controller: Controller, segment: Segment) -> Array:
    """OP (N, n_u) of the loop without disturbances, as deviations."""
    return simulate(plant, controller, segment.r - segment.r[0], segment.h, limits=(-np.inf, np.inf)).u


def _matrix(
    orders: Mapping[int, Sequence[Order]],
    thetas: Mapping[int, Array],
    held: Mapping[int, Sequence[Held]],
    n_y: int,
    n_u: int,
) -> TransferMatrix:
    elements = [[TransferFunction() for _ in range(n_u)] for _ in range(n_y)]
    for i, row in orders.items():
        for order, part in zip(row, slices(row), strict=True):
            elements[i][order.column] = elements[i][order.column] + order.transfer(thetas[i][part])
        for kept in held.get(i, ()):
            if kept.column < n_u:
                elements[i][kept.column] = elements[i][kept.column] + kept.system
    return TransferMatrix(tuple(tuple(row) for row in elements))
