"""Moves of a test, and the information in a record of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import RowFit
from trueplant.identify.levels import SHARED_FACTOR
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.identify.pieces import Piece
from trueplant.study import levels


@dataclass(frozen=True, eq=False)
class Moves:
    """How far each channel goes to each side of where it is now, how often, and which limit keeps it there."""

    size: Mapping[int, float]
    """By channel."""
    interval: Mapping[int, float]
    limited_by: str = ""

    def course(self, length: float, h: float, channels: int, rest: int = 0) -> Array:
        """(N, channels) the moves for so long, then `rest` samples back where they began."""
        moving = pattern(round(length / h), h, self.interval, channels)
        sizes = np.array([self.size.get(c, 0.0) for c in range(channels)])
        return np.asarray(np.vstack([moving, np.zeros((rest, channels))]) * sizes)


def pattern(samples: int, h: float, intervals: Mapping[int, float], channels: int) -> Array:
    """(samples, channels): each channel named goes to +1, then to -1, and so on, every so long; the rest is still.

    Each goes up and down a whole number of times and is then still where it began, so that its mean does not move and
    a level that integrates it comes back.
    """
    moves = np.zeros((samples, channels))
    instants = np.arange(samples)
    for channel, interval in intervals.items():
        turn = (instants * h * (1 + 1e-12) // interval).astype(int)
        whole = 2 * int(samples * h * (1 + 1e-9) // (2 * interval))
        moves[:, channel] = np.where(turn < whole, np.where(turn % 2 == 0, 1.0, -1.0), 0.0)
    return moves


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
    """(n, p, p) covariances from an existing one (p, p) and information (n, p, p) on top of it."""
    scale = np.sqrt(np.maximum(np.diag(existing), 1e-300))
    normal = existing / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(normal)
    prior = (vectors / np.maximum(values, 1e-10)) @ vectors.T
    scaled = prior + told * np.outer(scale, scale)
    size = np.sqrt(np.einsum("naa->na", scaled))
    # Where parameters are known only together, rounding leaves nothing of the smallest values.
    values, vectors = np.linalg.eigh(scaled / (size[:, :, None] * size[:, None, :]))
    inverse = (vectors / np.maximum(values, 1e-14)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    back = scale / size
    return np.asarray(inverse * back[:, :, None] * back[:, None, :])
