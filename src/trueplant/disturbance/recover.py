"""The disturbance behind a record once the plant is known: for the closed form, and to replay on other tunings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.disturbance import levels
from trueplant.disturbance.kalman import smoothed, whitened
from trueplant.disturbance.models import Part, ramps
from trueplant.disturbance.noise import Noise, Signal, fit_noise_and_jumps, with_jumps
from trueplant.errors import UsageError
from trueplant.identify import pieces_of
from trueplant.lti import TransferMatrix, sampled_response
from trueplant.record import Segment


@dataclass(frozen=True, eq=False)
class Recovered:
    """What acted on the outputs besides the plant, over one segment; all (N, n_y) but t, relative to the start.

    NaN throughout for outputs of which fewer than FEWEST_SAMPLES samples were measured.
    """

    t: Array
    """(N,) in the record's time."""
    raw: Array
    """y - G u without offset and free response: the disturbance with all measurement noise; NaN where y is."""
    value: Array
    """Smoothed: without the white noise, and without gaps."""
    std: Array
    """Standard deviation of `value`, given the plant: what the plant's own error adds is not in it."""
    declared: Array
    """The part of `value` that the declared disturbance explains; 0 where none is declared."""
    jumps: tuple[tuple[int, ...], ...]
    """For each output the samples at which a declared step was found to jump."""


def recover(
    segment: Segment,
    plant: TransferMatrix,
    declared: Mapping[int, Sequence[Part]] | None = None,
    noise: Mapping[int, Noise] | None = None,
) -> Recovered:
    """The disturbance v = y - G u at each output, by Kalman smoothing over the whole segment.

    `plant` (n_y, n_u + n_d) takes the inputs, then the measured disturbances of the segment (columns for those may be
    left out); its dead times are kept as they are. `declared` gives the parts of each output's disturbance, by its
    number; a first-order background and white noise are always there. Their sizes are found by maximum likelihood,
    unless `noise` has them (as `fit_with_disturbance` found them).

    A plant that is not right shows in v as what it gets wrong. Raises UsageError for shapes that do not fit.
    """
    n_y, columns = plant.shape
    n_u = segment.u.shape[1]
    if n_y != segment.y.shape[1] or columns not in (n_u, n_u + segment.d.shape[1]):
        raise UsageError(
            f"the plant is {n_y} by {columns}, the segment has {segment.y.shape[1]} outputs, {n_u} inputs and "
            f"{segment.d.shape[1]} measured disturbances: they must agree"
        )
    inputs = np.hstack([segment.u, segment.d])[:, :columns]
    hold = segment.holds[:columns]
    forced = sampled_response(plant, inputs - inputs[0], segment.h, hold)
    shape = segment.y.shape
    raw, value, std, known = (np.full(shape, np.nan) for _ in range(4))
    jumps: list[tuple[int, ...]] = [()] * n_y
    for i in range(n_y):
        if np.isfinite(segment.y[:, i]).sum() < levels.FEWEST_SAMPLES:
            continue
        parts = tuple((declared or {}).get(i, ()))
        signal = _signal(segment, plant, i, forced[:, i], parts)
        own = (noise or {}).get(i)
        if own is None:
            own, (signal,) = fit_noise_and_jumps(parts, [signal])
        else:
            signal = with_jumps(own, signal)
        raw[:, i], value[:, i], std[:, i], known[:, i] = _one(own, signal)
        jumps[i] = signal.jumps
    return Recovered(segment.t, raw, value, std, known, tuple(jumps))


def _signal(segment: Segment, plant: TransferMatrix, i: int, forced: Array, parts: Sequence[Part]) -> Signal:
    valid = np.isfinite(segment.y[:, i])
    row = plant.elements[i]
    columns = [np.ones(len(segment))]
    if not pieces_of([segment], i)[0].starts_at_rest:
        t = segment.h * np.arange(len(segment))
        for pole in dict.fromkeys(complex(p) for element in row for p in element.poles if p.imag >= 0 and p.real < 0):
            mode = np.exp(pole * t)
            columns += [mode.real] if pole.imag == 0 else [mode.real, mode.imag]
        dead = max((term.dead_time for element in row for term in element.terms), default=0.0)
        # what the inputs did in the last dead time before the record is not in it
        valid[: min(int(np.ceil(dead / segment.h)) + 1, len(segment) // 5)] = False
    v = np.where(valid, segment.y[:, i] - forced, 0.0)
    return Signal(segment.h, v, valid, np.column_stack(columns), (), ramps(parts))


def _one(noise: Noise, signal: Signal) -> tuple[Array, Array, Array, Array]:
    """raw, value, std and declared part (n,) of one output."""
    system = noise.system(signal.h)
    linear, own = signal.linear, signal.of_disturbance
    both, _ = whitened(system, np.column_stack([signal.v, linear]), signal.valid)
    scale = np.maximum(np.linalg.norm(both[:, 1:], axis=0), 1e-300)
    inverse = np.linalg.pinv(both[:, 1:] / scale, rcond=1e-7) / scale[:, None]
    weights = inverse @ both[:, 0]
    data = np.column_stack([np.where(signal.valid, signal.v - linear @ weights, 0.0), linear])
    states = smoothed(system, data, signal.valid)
    of_declared = np.where(np.arange(system.C.size) < noise.declared_states, system.C, 0.0)
    moved = own @ weights[signal.plain.shape[1] :]
    total = np.einsum("i,kim->km", system.C, states.value)
    declared = moved + states.value[:, :, 0] @ of_declared
    # the weights are estimates too: what an error in them does to v
    shift = np.hstack([np.zeros_like(signal.plain), own]) - total[:, 1:]
    variance = np.einsum("i,kij,j->k", system.C, states.covariance, system.C)
    variance = variance + np.sum((shift @ inverse) ** 2, axis=1)
    raw = np.where(signal.valid, signal.v - signal.plain @ weights[: signal.plain.shape[1]], np.nan)
    return raw, moved + total[:, 0], np.sqrt(np.maximum(variance, 0.0)), declared
