"""What a planned record would tell: moves simulated on the plant as estimated, and the information in them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array
from trueplant.identify import OutputEstimate, RowFit
from trueplant.identify.levels import SHARED_FACTOR
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.identify.pieces import Piece
from trueplant.loop import Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.study import levels
from trueplant.study.study import Study


@dataclass(frozen=True, eq=False)
class Bench:
    """The loop on which plans are tried out, in deviations from today's operating point."""

    plant: TransferMatrix
    """(n_y, n_u)"""
    controller: Controller | None
    """None: OP is moved by hand, in open loop."""
    h: float
    every: int
    """Steps of the simulator in one sample."""
    noise: Array
    """(N, n_y) disturbance as the noise models say, long enough to see how far it moves PV and OP."""

    @property
    def channels(self) -> int:
        return self.plant.shape[0 if self.controller else 1]

    def run(self, moves: Array, noise: Array | None = None) -> tuple[Array, Array]:
        """(y, u) at the samples; moves (N, channels) of the set-points, of OP in open loop."""
        n_y, n_u = self.plant.shape
        free = np.tile([-np.inf, np.inf], (n_u, 1))
        fine = np.repeat(moves, self.every, axis=0)
        v = None if noise is None else np.repeat(noise, self.every, axis=0)
        h = self.h / self.every
        if self.controller is None:
            still = np.zeros((len(fine), n_y))
            sim = simulate(self.plant, None, still, h, u=fine, v=v, limits=free, record_every=self.every)
        else:
            sim = simulate(self.plant, self.controller, fine, h, v=v, limits=free, record_every=self.every)
        return sim.y, sim.u

    def spread(self) -> tuple[Array, Array]:
        """Standard deviation of each PV and OP when nothing is moved."""
        y, u = self.run(np.zeros((len(self.noise), self.channels)), self.noise)
        return y.std(axis=0), u.std(axis=0)


@dataclass(frozen=True, eq=False)
class Moves:
    """How far each channel goes to each side of where it is now, how often, and which limit keeps it there."""

    size: Mapping[int, float]
    """By channel."""
    interval: Mapping[int, float]
    limited_by: str


@dataclass(frozen=True, eq=False)
class Plan:
    """Moves, how long they take, and what each open parameter would then be known to (half-width)."""

    moves: Moves
    length: float
    suffices: bool
    then: tuple[float, ...]


def pattern(samples: int, h: float, intervals: Mapping[int, float], channels: int) -> Array:
    """(samples, channels): each channel named goes to +1, then to -1, and so on, every so long; the rest is still."""
    moves = np.zeros((samples, channels))
    turn = np.arange(samples) * h * (1 + 1e-12)
    for channel, interval in intervals.items():
        moves[:, channel] = np.where((turn // interval).astype(int) % 2 == 0, 1.0, -1.0)
    return moves


def simulated_noise(study: Study, estimates: Mapping[int, OutputEstimate], samples: int, seed: int) -> Array:
    """(samples, n_y) as the noise models of the estimated outputs say; 0 for the others."""
    rng = np.random.default_rng(seed)
    out = np.zeros((samples, study.model.shape[0]))
    for i, estimate in estimates.items():
        fit, stride = estimate.fit, estimate.row.stride
        e = np.sqrt(fit.variance) * rng.standard_normal(-(-samples // stride) + 500)
        out[:, i] = np.repeat(lfilter([1.0], np.r_[1.0, fit.ar], e)[500:], stride)[:samples]
    return out


def fit_at(estimate: OutputEstimate, open_ones: Collection[int]) -> RowFit:
    """The fit at its parameters, at the model's where an element is not answered at all."""
    theta = estimate.theta.copy()
    for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
        if spec.initial is not None and all(k in open_ones for k in range(part.start, part.stop)):
            theta[part] = spec.initial
    low, high = estimate.row.bounds()
    return replace(estimate.fit, theta=np.clip(theta, low, high))


def information(fit: RowFit, u: Array, h: float, n_columns: int, known: bool) -> tuple[Array, Array]:
    """Information (n, p, p) of the parameters after each of n lengths, and the lengths, for inputs u (N, n_u).

    Operating point and initial state count as unknown, as they are in a loop that noise keeps moving. Measured
    disturbances are taken to rest. `known` is False where the noise model does not tell all (disturbances that reach
    several outputs): the information then counts less.
    """
    inputs = np.zeros((n_columns, len(u)))
    inputs[: u.shape[1]] = u.T
    inputs -= inputs[:, :1]
    piece = Piece(0, h, np.zeros(len(u)), np.ones(len(u), dtype=bool), inputs, fit.row.pieces[0].hold)
    row = replace(fit.row, pieces=(piece,)).without_unseen(fit.theta)
    gradient = row.response_and_gradient(fit.theta, 0)[1]
    columns = whiten(fit.ar, np.hstack([gradient, row.nuisance(fit.theta, 0)]))
    use = whitened_valid(fit.ar.size, row.measured(0)[1])
    columns = np.where(use[:, None], columns, 0.0) / np.linalg.norm(columns, axis=0).clip(1e-300)
    scale = np.linalg.norm(whiten(fit.ar, gradient), axis=0).clip(1e-300)
    # Rows with noise models of other orders are to have the same lengths.
    columns = np.vstack([np.zeros((fit.ar.size, columns.shape[1])), columns])
    length = -(-len(columns) // levels.PLAN_LENGTHS)
    count, size = -(-len(columns) // length), fit.theta.size
    padded = np.zeros((count * length, columns.shape[1]))
    padded[: len(columns)] = columns
    stacked = padded.reshape(count, length, -1)
    total = np.cumsum(np.swapaxes(stacked, 1, 2) @ stacked, axis=0)
    across, within = total[:, :size, size:], total[:, size:, size:]
    within = within + 1e-12 * np.eye(within.shape[1])
    told = total[:, :size, :size] - across @ np.linalg.solve(within, np.swapaxes(across, 1, 2))
    ends = np.minimum(np.arange(1, count + 1) * length, len(columns)) * h * row.stride
    return told * np.outer(scale, scale) / fit.variance / (1.0 if known else SHARED_FACTOR**2), ends


def combined(existing: Array, told: Array) -> Array:
    """(n, p) standard errors from an existing covariance (p, p) and information (n, p, p) on top of it."""
    scale = np.sqrt(np.maximum(np.diag(existing), 1e-300))
    normal = existing / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(normal)
    prior = (vectors / np.maximum(values, 1e-10)) @ vectors.T
    scaled = prior + told * np.outer(scale, scale)
    size = np.sqrt(np.einsum("naa->na", scaled))
    # Where parameters are known only together, rounding leaves nothing of the smallest values.
    values, vectors = np.linalg.eigh(scaled / (size[:, :, None] * size[:, None, :]))
    inverse = np.sum(vectors**2 / np.maximum(values, 1e-14)[:, None, :], axis=2)
    return np.asarray(np.sqrt(inverse) / size * scale)
