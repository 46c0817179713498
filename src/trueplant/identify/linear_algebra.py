"""Normal equations that stay usable where data say next to nothing, and linear unknowns taken out of them."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled
from trueplant.identify import levels


def inverse(information: Array, floor: float = 1e-14) -> Array:
    """Inverse of an information matrix (n, n), scaled to a unit diagonal first.

    `floor` is the least eigenvalue of the scaled matrix: a variance is very large, but finite, where the
    data do not determine a parameter.
    """
    scale, values, vectors = scaled_eigen(information, floor)
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def with_held(information: Array, moving: BoolArray) -> Array:
    """The information (n, n) with what does not move (n,) known, and related to nothing."""
    held = np.where(np.outer(moving, moving), information, 0.0)
    held[~moving, ~moving] = 1e30
    return held


def log_determinant(information: Array, floor: float = 1e-14) -> float:
    """Of the same matrix, with the same floor."""
    scale, values, _ = scaled_eigen(information, floor)
    return float(2 * np.sum(np.log(scale)) + np.sum(np.log(values)))


def scaled_eigen(information: Array, floor: float = 1e-14) -> tuple[Array, Array, Array]:
    """Scale (n,), and eigenvalues and eigenvectors of the matrix (n, n) that has a unit diagonal, scaled by it."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-80))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return scale, np.maximum(values, floor), vectors


def orthonormal(columns: Array) -> Array:
    """Basis (n, rank) of the column space, directions lost in rounding dropped."""
    return eliminated(columns, np.zeros(len(columns)))[1]


def eliminated(columns: Array, target: Array) -> tuple[Array, Array]:
    """Least-squares weights (m,) of the columns (n, m) for the target (n,), and a basis (n, rank) of what they span."""
    weights, basis = _eliminated(np.array(columns.T, dtype=float, order="C"), np.ascontiguousarray(target))
    return weights, basis.T


@compiled
def _eliminated(rows: Array, target: Array) -> tuple[Array, Array]:
    """The same with rows (m, n), which it overwrites, and a basis (rank, n)."""
    m = rows.shape[0]
    norms = np.array([np.sqrt(_dot(rows[k], rows[k])) for k in range(m)])
    if not norms.any():
        return np.zeros(m), rows[:0]
    for k in range(m):
        rows[k] /= norms[k] if norms[k] > 0 else 1.0
    left, values, right = np.linalg.svd(_orthonormalise(rows))
    rank = np.sum(values > levels.LOST * values[0])
    shares, weights = np.array([_dot(rows[k], target) for k in range(m)]), np.zeros(m)
    for k in range(rank):
        weights += _dot(np.ascontiguousarray(left[:, k]), shares) / values[k] * right[k]
    basis = rows if rank == m else np.ascontiguousarray(left[:, :rank].T) @ rows
    return np.where(norms > 0, weights / np.maximum(norms, 1e-300), 0.0), basis


@compiled
def _orthonormalise(rows: Array) -> Array:
    """Make the rows (m, n) orthonormal, those that are 0 apart; r (m, m) with r.T @ rows the rows as they were.

    Gram and Schmidt, each row twice: once more than exact numbers would need makes them orthogonal to rounding
    (Giraud et al. 2005).
    """
    m = rows.shape[0]
    r = np.zeros((m, m))
    for k in range(m):
        for _ in range(2):
            for j in range(k):
                r[j, k] += _remove(rows[j], rows[k])
        r[k, k] = np.sqrt(_dot(rows[k], rows[k]))
        if r[k, k] > 0:
            rows[k] /= r[k, k]
    return r


@compiled
def remove(basis: Array, rows: Array) -> None:
    """Take what orthonormal rows (m, n) span out of other rows (k, n)."""
    for k in range(rows.shape[0]):
        for j in range(basis.shape[0]):
            _remove(basis[j], rows[k])


@compiled
def _remove(direction: Array, row: Array) -> float:
    """Make a row (n,) orthogonal to one of length 1; its share in it."""
    share: float = _dot(direction, row)
    for k in range(row.size):
        row[k] -= share * direction[k]
    return share


@compiled(fastmath={"reassoc"})
def _dot(a: Array, b: Array) -> float:
    """Of vectors that are in the cache, in any order of summation: four times as fast as one after the other."""
    total = 0.0
    for k in range(a.size):
        total += a[k] * b[k]
    return total


def identifiable_columns(columns: Array, errors: Array, largest: Array) -> BoolArray:
    """Which columns (n, m) have an amplitude that the errors (n,) determine to better than its largest value (m,).

    A free response that the noise model cancels does not show in the prediction errors: left in, it would take on any
    amplitude, and the output errors with it.
    """
    found: BoolArray = _identifiable(np.ascontiguousarray(columns.T), np.ascontiguousarray(errors), largest)
    return found


@compiled
def _identifiable(rows: Array, errors: Array, largest: Array) -> BoolArray:
    """The same of rows (m, n)."""
    moves = np.abs(np.diff(errors)[:: 1 + max(errors.size - 1, 0) // levels.LEVEL_SAMPLES])
    level = np.median(moves) / levels.NORMAL_MOVE if moves.size else 0.0
    out = np.empty(rows.shape[0], dtype=np.bool_)
    for m in range(rows.shape[0]):
        out[m] = np.sqrt(_dot(rows[m], rows[m])) * largest[m] > level
    return out
