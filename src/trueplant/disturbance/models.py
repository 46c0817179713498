"""Models of disturbances at the outputs, sampled exactly.

    step    random walk: integrated white noise, the usual model of loads that change and stay
    drift   its integral: the slope is a random walk
    ar1     first order: white noise through 1/(T s + 1), stationary

Parts of one output add up. A step and a drift begin at 0: their level at the start belongs to the operating point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import UsageError

KINDS = ("step", "drift", "ar1")


@dataclass(frozen=True)
class Part:
    """One disturbance at one output.

    std, in the unit of the output: of "step" the standard deviation of its change within one time unit, of "drift" that
    of the change of its slope (per time unit) within one time unit, of "ar1" its own, with `time_constant`.
    Raises UsageError for what makes no sense.
    """

    kind: str
    std: float
    time_constant: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"a disturbance is one of {', '.join(KINDS)}, not {self.kind!r}")
        if not (np.isfinite(self.std) and self.std > 0):
            raise UsageError(f"std of a disturbance must be a number above 0, not {self.std:g}")
        tau = self.time_constant
        if (self.kind == "ar1") != (tau is not None) or not (tau is None or (np.isfinite(tau) and tau > 0)):
            raise UsageError('a disturbance of kind "ar1", and no other, has a time_constant above 0')

    def sampled(self, h: float) -> tuple[Array, Array, Array]:
        """State matrix (n, n), covariance of what is added each step, and covariance at the start; output: x[0]."""
        if self.kind == "step":
            return np.eye(1), np.full((1, 1), self.std**2 * h), np.zeros((1, 1))
        if self.kind == "drift":
            added = self.std**2 * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
            return np.array([[1.0, h], [0.0, 1.0]]), added, np.zeros((2, 2))
        assert self.time_constant is not None
        a = np.exp(-h / self.time_constant)
        stationary = np.full((1, 1), self.std**2)
        return np.full((1, 1), a), stationary * -np.expm1(-2 * h / self.time_constant), stationary


@dataclass(frozen=True, eq=False)
class System:
    """Parts put together: x[k+1] = A x[k] + w, cov w = Q, cov x[0] = P; v = C x, measured with white noise."""

    A: Array
    Q: Array
    P: Array
    C: Array
    noise: float
    """Variance of the measurement noise."""


def system_of(parts: Sequence[Part], noise_std: float, h: float) -> System:
    """The sampled system (n states over all parts) of one output."""
    blocks = [part.sampled(h) for part in parts]
    n = sum(a.shape[0] for a, _, _ in blocks)
    A, Q, P, C = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    at = 0
    for a, q, p in blocks:
        own = slice(at, at + a.shape[0])
        A[own, own], Q[own, own], P[own, own] = a, q, p
        C[at] = 1.0
        at += a.shape[0]
    return System(A, Q, P, C, noise_std**2)


def ramps(parts: Sequence[Part]) -> bool:
    """Does a slope at the start have to be estimated?"""
    return any(part.kind == "drift" for part in parts)
