"""All that acts on an output besides the plant, and how it is found: declared parts, background, single jumps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from trueplant.arrays import Array, BoolArray
from trueplant.disturbance import levels
from trueplant.disturbance.kalman import smoothed, whitened
from trueplant.disturbance.models import Part, System, ramps, system_of


@dataclass(frozen=True)
class Noise:
    """The declared disturbance, as large as the record shows it, with a background of white noise and a first order.

    A declared std is an upper limit: `scale` (0..1) multiplies all of them. The background has
    standard deviation `std` and time constant `time_constant`; `white` is the standard deviation of the white noise.
    """

    declared: tuple[Part, ...]
    scale: float
    white: float
    std: float
    time_constant: float

    def system(self, h: float) -> System:
        """Sampled at h; the states of the declared parts come first."""
        own = [replace(part, std=self.scale * part.std) for part in self.declared]
        return system_of([*own, Part("ar1", self.std, self.time_constant)], self.white, h)

    @property
    def step_states(self) -> list[int]:
        """States of the declared parts that are steps."""
        states, at = [], 0
        for part in self.declared:
            if part.kind == "step":
                states.append(at)
            at += 2 if part.kind == "drift" else 1
        return states

    @property
    def declared_states(self) -> int:
        return sum(2 if part.kind == "drift" else 1 for part in self.declared)


@dataclass(frozen=True, eq=False)
class Signal:
    """An output error, and what is linear in it."""

    h: float
    v: Array
    """(n,), 0 where not valid."""
    valid: BoolArray
    plain: Array
    """(n, n_z): offset and free responses of the plant."""
    jumps: tuple[int, ...] = ()
    """Samples from which on the disturbance has another level."""
    ramp: bool = False

    @property
    def of_disturbance(self) -> Array:
        """(n, n_d): columns that belong to the disturbance, a slope at the start and a step for each jump."""
        k = np.arange(self.v.size)
        columns = [k * self.h] if self.ramp else []
        columns += [(k >= jump).astype(float) for jump in self.jumps]
        return np.column_stack(columns) if columns else np.zeros((self.v.size, 0))

    @property
    def linear(self) -> Array:
        return np.hstack([self.plain, self.of_disturbance])


def reduced(data: Array, z: Array) -> Array:
    """data without what the columns z explain."""
    scale = np.linalg.norm(z, axis=0)
    u, s, _ = np.linalg.svd(z / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = u[:, s > 1e-7 * s[0]]
    left: Array = data - basis @ (basis.T @ data)
    return left


def deviance(noise: Noise, signals: Sequence[Signal]) -> float:
    """-2 log likelihood of the signals, their linear parts at their best, up to a constant."""
    total = 0.0
    for signal in signals:
        linear = signal.linear
        both, logs = whitened(noise.system(signal.h), np.column_stack([signal.v, linear]), signal.valid)
        # on equal scales and without the bulk of v the normal equations are accurate enough here, and fast
        own = both[:, 1:] / np.maximum(np.linalg.norm(both[:, 1:], axis=0), 1e-300)
        first = both[:, 0]
        for _ in range(2):
            moment = own.T @ first
            first = first - own @ np.linalg.lstsq(own.T @ own, moment, rcond=1e-12)[0]
        total += float(first @ first) + logs
    return total


def fit_noise(declared: Sequence[Part], signals: Sequence[Signal], before: Noise | None = None) -> Noise:
    """Sizes of the declared parts (up to what was declared) and of the background by maximum likelihood."""
    h = signals[0].h
    moves = np.concatenate([np.diff(s.v[s.valid]) for s in signals])
    # a few jumps must not count as noise
    typical = max(1.48 * float(np.median(np.abs(moves - np.median(moves)))), 1e-9 * float(np.ptp(moves)), 1e-12)
    longest = max(s.v.size for s in signals) * h

    def noise(x: Array) -> Noise:
        white, std, tau, scale = np.exp(x)
        return Noise(tuple(declared), float(scale) if declared else 1.0, float(white), float(std), float(tau))

    white, background = levels.WHITE_RANGE, levels.BACKGROUND_RANGE
    low = np.log([white[0] * typical, background[0] * typical, h / 3, levels.LEAST_SCALE])
    high = np.log([white[1] * typical, background[1] * typical, longest, 1.0])

    def cost(x: Array) -> float:
        # a wall that rises keeps the simplex from folding up at the limits
        beyond = float(np.sum(np.maximum(low - x, 0) + np.maximum(x - high, 0)))
        return deviance(noise(np.clip(x, low, high)), signals) + 10 * beyond

    if before is None:
        initial = np.log([typical / 2, typical, 5 * h, 1.0])
    else:
        initial = np.log([before.white, before.std, before.time_constant, before.scale])
    size = 4 if declared else 3
    steps = np.diag([1.0, 0.7, 0.7, -1.0])[:size]
    simplex = initial[:size] + np.vstack([np.zeros(size), steps[:, :size]])
    fixed = np.zeros(4 - size)
    found = minimize(
        lambda x: cost(np.concatenate([x, fixed])),
        initial[:size],
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": levels.SIMPLEX_TOLERANCE,
            "fatol": levels.SIMPLEX_TOLERANCE,
            "maxiter": 200,
        },
    )
    return noise(np.clip(np.concatenate([found.x, fixed]), low, high))


def with_jumps(noise: Noise, signal: Signal) -> Signal:
    """The signal with the jumps of its declared steps found, one after the other, the clearest first.

    A random walk spreads a single large change over all its samples, and takes the low frequencies from everything
    else. A jump of its own costs one parameter.
    """
    signal = replace(signal, jumps=())
    states = noise.step_states
    if not states:
        return signal
    threshold = norm.isf(levels.FALSE_JUMP / (2 * signal.v.size))
    system = noise.system(signal.h)
    while len(signal.jumps) < levels.MOST_JUMPS:
        linear = signal.linear
        both, _ = whitened(system, np.column_stack([signal.v, linear]), signal.valid)
        weights = np.linalg.lstsq(both[:, 1:], both[:, 0], rcond=1e-7)[0]
        left = np.where(signal.valid, signal.v - linear @ weights, 0.0)
        t = np.abs(smoothed(system, left[:, None], signal.valid).shock[1:, states[0], 0])
        t[[k - 1 for k in signal.jumps]] = 0.0
        best = int(np.argmax(t))
        if t[best] < threshold:
            break
        signal = replace(signal, jumps=tuple(sorted((*signal.jumps, best + 1))))
    return signal


def fit_noise_and_jumps(declared: Sequence[Part], signals: Sequence[Signal]) -> tuple[Noise, list[Signal]]:
    """Noise and jumps of given output errors, each found with the other, or no jumps if they do not earn their keep.

    The first jumps are looked for with a small random walk: one that was fitted without them has made up for them.
    """
    signals = [replace(s, jumps=(), ramp=ramps(declared)) for s in signals]
    noise = fit_noise(declared, signals)
    best = criterion(noise, signals), noise, signals
    if not noise.step_states:
        return best[1:]
    trial = replace(noise, scale=min(noise.scale, levels.QUIET_STEP))
    for _ in range(levels.JUMP_ROUNDS):
        found = [with_jumps(trial, s) for s in signals]
        if [s.jumps for s in found] == [s.jumps for s in signals]:
            break
        signals, trial = found, fit_noise(declared, found, noise)
        value = criterion(trial, signals)
        if value < best[0]:
            best = value, trial, signals
    return best[1:]


def criterion(noise: Noise, signals: Sequence[Signal]) -> float:
    """Bayesian criterion: each jump has to be worth its size and its instant."""
    count = sum(int(s.valid.sum()) for s in signals)
    return deviance(noise, signals) + 2 * float(np.log(count)) * sum(len(s.jumps) for s in signals)
