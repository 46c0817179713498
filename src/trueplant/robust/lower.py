"""Lower bound of mu: the largest spectral radius of M Q over Q of the structure whose blocks have norm 1.

Each Q that is tried gives a Delta = Q/lambda with det(I - M Delta) = 0 to rounding, lambda an eigenvalue of M Q, so the
bound holds whatever the search does. The search is the power iteration of Packard, Fan and Doyle (1988), started from
the singular vectors of the scaled matrix: at the best scaling some unit vector in the span of the largest ones has
equal parts in the rows and columns of every block when the upper bound is exact. Where more than two of them agree, as
for a unitary matrix, the search may stop short by some per cent, which the distance to the upper bound then shows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.robust import levels
from trueplant.robust.blocks import Structure


def lower_bound(
    M: ComplexArray, upper: Array, structure: Structure, starts: int = levels.RANDOM_STARTS
) -> tuple[Array, ComplexArray]:
    """Bound (n_s,) and Q/lambda (n_s, n_w, n_z) for the scaled matrices M (n_s, n_z, n_w) and their upper bounds.

    Up to `starts` random starts where the singular vectors do not reach the upper bound.
    """
    M = M / upper[:, None, None]
    vectors = np.linalg.svd(M)[2].conj().swapaxes(1, 2)
    best, delta = climbed(M, vectors[:, :, 0], structure, levels.FIRST_CLIMB)
    rng = np.random.default_rng(0)

    def equal_parts(left: NDArray[np.intp], sign: float) -> ComplexArray:
        return _equal_parts(M[left], vectors[left], structure, sign)

    def random(left: NDArray[np.intp], weight: float) -> ComplexArray:
        shape = (left.size, vectors.shape[2])
        mixture = rng.normal(size=shape) + 1j * rng.normal(size=shape)
        return np.asarray(np.einsum("sij,sj->si", vectors[left], mixture * weight ** np.arange(shape[1])))

    attempts: list[tuple[Callable[[NDArray[np.intp], float], ComplexArray], float, int]] = []
    if M.shape[2] > 1:
        attempts = [(equal_parts, 1.0, levels.SECOND_CLIMB), (equal_parts, -1.0, levels.SECOND_CLIMB)]
        attempts += [(random, levels.RANDOM_WEIGHT, levels.RANDOM_CLIMB)] * starts
    for begin, setting, steps in attempts:
        left = np.flatnonzero(best < 1 - levels.TIGHT)
        if left.size == 0:
            break
        found, other = climbed(M[left], begin(left, setting), structure, steps)
        better = found > best[left]
        best[left[better]], delta[left[better]] = found[better], other[better]
    return best * upper, delta / upper[:, None, None]


def climbed(M: ComplexArray, b: ComplexArray, structure: Structure, steps: int) -> tuple[Array, ComplexArray]:
    """The power iteration from b (n_s, n_w), and what its end proves."""
    b = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), levels.TINY)
    w, adjoint = b, M.conj().swapaxes(1, 2)
    for _ in range(steps):
        a = _unit(_times(M, b))
        w = _unit(_times(adjoint, _towards(a, w, structure, from_rows=True)))
        b = _towards(w, a, structure, from_rows=False)
    a = _unit(_times(M, b))
    return _proved(M, _aligned(a, w, structure))


def _times(M: ComplexArray, v: ComplexArray) -> ComplexArray:
    return np.asarray((M @ v[:, :, None])[:, :, 0])


def _unit(v: ComplexArray) -> ComplexArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), levels.TINY))


def _towards(own: ComplexArray, other: ComplexArray, structure: Structure, from_rows: bool) -> ComplexArray:
    """Q own or Q^H own: each block turned to its counterpart.

    A full block keeps the direction of `own` and takes the size of `other`; a repeated one keeps `other` but for a
    phase. The result lives where `own` does.
    """
    value = np.zeros_like(own)
    for block, z, w in structure.places():
        here, there = (z, w) if from_rows else (w, z)
        mine, theirs = own[:, here], other[:, there]
        if block.is_full:
            value[:, here] = _unit(mine) * np.linalg.norm(theirs, axis=1, keepdims=True)
        else:
            inner = np.sum(mine.conj() * theirs, axis=1)
            value[:, here] = theirs * (inner.conj() / np.maximum(np.abs(inner), levels.TINY))[:, None]
    return value


def _aligned(a: ComplexArray, w: ComplexArray, structure: Structure) -> ComplexArray:
    """The Q (n_s, n_w, n_z) with blocks of norm 1 that turns a into the direction of w."""
    n_z, n_w = structure.shape
    Q = np.zeros((len(a), n_w, n_z), dtype=complex)
    for block, z, side in structure.places():
        mine, theirs = a[:, z], w[:, side]
        if block.is_full:
            Q[:, side, z] = _unit(theirs)[:, :, None] * _unit(mine).conj()[:, None, :]
        else:
            inner = np.sum(mine.conj() * theirs, axis=1)
            Q[:, side, z] = (inner / np.maximum(np.abs(inner), levels.TINY))[:, None, None] * np.eye(block.rows)
    return Q


def _proved(M: ComplexArray, Q: ComplexArray) -> tuple[Array, ComplexArray]:
    values = np.linalg.eigvals(M @ Q)
    largest = np.take_along_axis(values, np.argmax(np.abs(values), axis=1)[:, None], axis=1)[:, 0]
    size = np.abs(largest)
    with np.errstate(divide="ignore", invalid="ignore"):
        return size, np.asarray(np.where(size[:, None, None] > 0, Q / largest[:, None, None], np.nan))


def _equal_parts(M: ComplexArray, vectors: ComplexArray, structure: Structure, sign: float) -> ComplexArray:
    """The mixture of the two largest right singular vectors whose image has equal parts in each block.

    On the sphere of mixtures of two vectors every block's difference of parts is a plane; the point sought lies on all
    of them (least squares where there are more than two), `sign` chooses among the two such points.
    """
    right = vectors[:, :, :2]
    image = M @ right
    left = image / np.maximum(np.linalg.norm(image, axis=1, keepdims=True), levels.TINY)
    planes, heights = [], []
    for _, z, w in structure.places():
        form = left[:, z].conj().swapaxes(1, 2) @ left[:, z] - right[:, w].conj().swapaxes(1, 2) @ right[:, w]
        off = form[:, 0, 1]
        planes.append(np.stack([off.real, -off.imag, (form[:, 0, 0] - form[:, 1, 1]).real / 2], axis=1))
        heights.append(-(form[:, 0, 0] + form[:, 1, 1]).real / 2)
    normal, height = np.stack(planes, axis=1), np.stack(heights, axis=1)
    u, s, vt = np.linalg.svd(normal)
    rank = min(2, s.shape[1])
    projected = np.einsum("sfi,sf->si", u, height)[:, :rank]
    kept = s[:, :rank] > 1e-9 * np.maximum(s[:, :1], levels.TINY)
    inside = np.where(kept, projected / np.where(kept, s[:, :rank], 1.0), 0.0)
    point = np.einsum("sr,sri->si", inside, vt[:, :rank])
    length = np.linalg.norm(point, axis=1, keepdims=True)
    point = np.where(length > 1, point / np.maximum(length, levels.TINY), point)
    rest = np.sqrt(np.maximum(1 - np.sum(point**2, axis=1, keepdims=True), 0.0))
    point = point + sign * rest * vt[:, 2]
    # back from the sphere: (cos, e^(j phi) sin) of half the angle
    first = np.sqrt(np.maximum((1 + point[:, 2]) / 2, 0.0))
    second = np.sqrt(np.maximum((1 - point[:, 2]) / 2, 0.0))
    phase = np.exp(1j * np.arctan2(point[:, 1], point[:, 0]))
    return np.asarray(right[:, :, 0] * first[:, None] + right[:, :, 1] * (second * phase)[:, None])
