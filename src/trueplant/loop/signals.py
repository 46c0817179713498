"""Set-points and disturbances to simulate with. Time first; the same seed gives the same signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import levels

Seed = int | np.random.Generator
"""Of random numbers: a number, or a generator that goes on from where it is."""


def channels(value: ArrayLike, n: int, name: str) -> Array:
    """(n,) from one number for all channels, or one each."""
    given = np.asarray(value, dtype=float)
    if given.shape not in ((), (1,), (n,)) or not np.all(np.isfinite(given)):
        raise LoopError(f"{name} must be a finite number, or {n} of them, one a channel, not {value!r}")
    return np.array(np.broadcast_to(given, (n,)))


def signal_of(value: ArrayLike | None, shape: tuple[int, int], name: str) -> Array:
    """(N, n) from None (zeros), a number, one value a channel or the whole signal."""
    if value is None:
        return np.zeros(shape)
    given = np.asarray(value, dtype=float)
    if given.ndim and given.shape not in (shape, shape[1:]):
        raise LoopError(f"{name} must be a number, {shape[1]} numbers or an array {shape}, not of shape {given.shape}")
    if not np.all(np.isfinite(given)):
        raise LoopError(f"{name} must be finite throughout")
    # always a writable copy: the kernel is compiled once more for read-only arrays
    return np.array(np.broadcast_to(given, shape), order="C")


def _normal(steps: int, n: int, seed: Seed, correlation: ArrayLike) -> Array:
    """(steps, n) white and normal, of standard deviation 1; correlation: one number for all pairs, or (n, n)."""
    white = np.random.default_rng(seed).standard_normal((steps, n))
    given = np.asarray(correlation, dtype=float)
    if not np.any(given):
        return white
    wanted = given if given.ndim else np.where(np.eye(n, dtype=bool), 1.0, given)
    if wanted.shape != (n, n) or np.any(wanted != wanted.T) or np.any(np.diag(wanted) != 1):
        raise LoopError(f"correlation must be a number or a symmetric ({n}, {n}) matrix with 1 on its diagonal")
    values, vectors = np.linalg.eigh(wanted)
    if values[0] < -n * np.finfo(float).eps * values[-1]:
        raise LoopError("no signals are correlated like that: the correlation matrix has an eigenvalue below 0")
    return np.asarray(white @ (vectors * np.sqrt(np.maximum(values, 0.0))).T)


def random_steps(steps: int, h: float, mean_interval: float, amplitudes: ArrayLike, seed: int) -> Array:
    """(steps, n): each channel changes sign at random instants, mean_interval apart on average.

    The changes form a Poisson process of their own in each channel, at most one a sample; the level is
    +-amplitude, its first sign random.
    """
    size = np.atleast_1d(np.asarray(amplitudes, dtype=float))
    if not mean_interval > h > 0:
        raise LoopError(f"mean_interval ({mean_interval:g}) must be longer than the sample time ({h:g})")
    rng = np.random.default_rng(seed)
    first = rng.choice([-1.0, 1.0], size.size)
    flips = rng.random((steps, size.size)) < -np.expm1(-h / mean_interval)
    flips[0] = False
    return np.asarray(size * first * np.where(np.cumsum(flips, axis=0) % 2, -1.0, 1.0))


def alternating_steps(steps: int, h: float, interval: float, amplitudes: ArrayLike) -> Array:
    """(steps, n): one channel moves at a time, every `interval`, up then back down, the channels in turn.

    Starts at 0 for one interval, so that the record begins at rest.
    """
    size = np.atleast_1d(np.asarray(amplitudes, dtype=float))
    if not interval >= h > 0:
        raise LoopError(f"interval ({interval:g}) must be at least the sample time ({h:g})")
    turn = np.floor(np.arange(steps) * h / interval * (1 + 1e-12)).astype(int) - 1
    channel = (turn // 2) % size.size
    up = (turn >= 0) & (turn % 2 == 0)
    return np.where(up[:, None] & (channel[:, None] == np.arange(size.size)), size, 0.0)


def step_disturbance(steps: int, h: float, at: float, sizes: ArrayLike) -> Array:
    """(steps, n): 0, and `sizes` from the time `at` on."""
    return np.where(
        (np.arange(steps) * h >= at - 1e-9 * h)[:, None], np.atleast_1d(np.asarray(sizes, dtype=float)), 0.0
    )


def arma(steps: int, c: ArrayLike, a: ArrayLike, std: ArrayLike, seed: Seed, correlation: ArrayLike = 0.0) -> Array:
    """(steps, n): stationary ``C(q)/A(q) e`` of the given standard deviations, c and a in powers of q^-1, a[0] = 1.

    The start is discarded until the slowest pole has decayed to 1e-6. correlation: of the channels, a number for all
    pairs or a matrix (n, n).
    """
    from scipy.signal import lfilter

    num, den = np.atleast_1d(np.asarray(c, dtype=float)), np.atleast_1d(np.asarray(a, dtype=float))
    size = np.atleast_1d(np.asarray(std, dtype=float))
    slowest = float(np.max(np.abs(np.roots(den)), initial=0.0))
    if den[0] != 1 or slowest >= 1:
        raise LoopError(
            "a must begin with 1 and have its roots inside the unit circle: the disturbance must be stationary"
        )
    before = int(np.ceil(np.log(levels.DECAYED) / np.log(slowest))) if slowest > 0 else 0
    before += num.size + den.size
    e = _normal(before + steps, size.size, seed, correlation)
    impulse = lfilter(num, den, np.eye(1, 2 * before + 1)[0])
    raw = np.asarray(lfilter(num, den, e, axis=0))[before:]
    return np.asarray(raw * (size / np.sqrt(np.sum(impulse**2))))


def ar1(steps: int, h: float, time_constant: float, std: ArrayLike, seed: Seed, correlation: ArrayLike = 0.0) -> Array:
    """(steps, n): a first-order Gauss-Markov disturbance, correlation exp(-t/time_constant) in time.

    correlation: of the channels, as of `arma`.
    """
    if not time_constant > 0:
        raise LoopError(f"time_constant must be above 0, not {time_constant:g}")
    return arma(steps, [1.0], [1.0, -np.exp(-h / time_constant)], std, seed, correlation)


def drift(steps: int, h: float, rate: ArrayLike, seed: Seed, correlation: ArrayLike = 0.0) -> Array:
    """(steps, n): random walk from 0 whose standard deviation after the time t is ``rate sqrt(t)``.

    correlation: of the channels, as of `arma`.
    """
    size = np.atleast_1d(np.asarray(rate, dtype=float))
    moves = _normal(steps, size.size, seed, correlation) * size * np.sqrt(h)
    moves[0] = 0.0
    return np.asarray(np.cumsum(moves, axis=0))
