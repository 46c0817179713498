"""Normal equations that stay usable where data say next to nothing, and linear unknowns taken out of them."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels


def inverse(information: Array, floor: float = 1e-14) -> Array:
    """Inverse of an information matrix (n, n), scaled to a unit diagonal first.

    `floor` is the least eigenvalue of the scaled matrix: a variance is very large, but finite, where the
    data do not determine a parameter.
    """
    scale = np.sqrt(np.maximum(np.diag(information), 1e-80))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, floor)) @ vectors.T / np.outer(scale, scale))


def orthonormal(columns: Array) -> Array:
    """Basis (n, rank) of the column space, directions lost in rounding dropped."""
    return eliminated(columns, np.zeros(len(columns)))[1]


def eliminated(columns: Array, target: Array) -> tuple[Array, Array]:
    """Least-squares weights (m,) of the columns (n, m) for the target (n,), and a basis (n, rank) of what they span."""
    norms = np.linalg.norm(columns, axis=0)
    there = norms > 0
    if not there.any():
        return np.zeros(norms.size), np.zeros((len(columns), 0))
    q, r = np.linalg.qr(columns[:, there] / norms[there])
    left, values, right = np.linalg.svd(r, full_matrices=False)
    kept = values > levels.LOST * values[0]
    basis = q @ left[:, kept]
    weights = np.zeros(norms.size)
    weights[there] = right[kept].T @ ((basis.T @ target) / values[kept]) / norms[there]
    return weights, basis


def identifiable_columns(columns: Array, errors: Array, largest: Array) -> BoolArray:
    """Which columns (n, m) have an amplitude that the errors (n,) determine to better than its largest value (m,).

    A free response that the noise model cancels does not show in the prediction errors: left in, it would take on any
    amplitude, and the output errors with it.
    """
    size = np.linalg.norm(columns, axis=0) * largest
    moves = np.diff(errors)
    if not moves.size:
        return np.asarray(size > 0)
    some = moves[:: 1 + moves.size // levels.LEVEL_SAMPLES]
    return np.asarray(size > np.median(np.abs(some)) / levels.NORMAL_MOVE)
