"""Structured singular value, bounded from both sides for many matrices at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import UsageError
from trueplant.robust.blocks import Block, Structure
from trueplant.robust.lower import lower_bound
from trueplant.robust.mixed_lower import mixed_lower_bound
from trueplant.robust.mixed_upper import MixedUpper, mixed_upper_bound
from trueplant.robust.upper import Upper, upper_bound


@dataclass(frozen=True, eq=False)
class MuResult:
    """Bounds of mu, each with what proves it; leading axis as that of M."""

    lower: Array
    """(n_s,)"""
    upper: Array
    """(n_s,)"""
    delta: ComplexArray
    """(n_s, n_w, n_z): a perturbation of the structure with sigma_max = 1/lower and det(I - M delta) = 0; nan where
    lower is 0, since then none was found."""
    scaling: tuple[ComplexArray, ComplexArray]
    """L (n_s, n_z, n_z) and R (n_s, n_w, n_w) with sigma_max(L M R^-1) = upper and R Delta = Delta L for every Delta of
    the structure. With real blocks upper^2 is the largest eigenvalue of R^-H (M^H L^H L M + j (G M - M^H G^H)) R^-1
    instead, or 0 where that is negative."""
    G: ComplexArray
    """(n_s, n_w, n_z): Hermitian on the real blocks, zero elsewhere."""

    def __repr__(self) -> str:
        if self.upper.size == 0:
            return "mu at no frequency"
        k = int(np.argmax(self.upper))
        return f"mu between {self.lower[k]:.6g} and {self.upper[k]:.6g}, the largest of {self.upper.size}"


def mu(M: ArrayLike, blocks: Sequence[Block]) -> MuResult:
    """Bounds of the structured singular value of M (n_s, n_z, n_w), or of one matrix (n_z, n_w).

    mu = 1/min{sigma_max(Delta): Delta of the structure, det(I - M Delta) = 0}. The upper bound is exact when twice the
    repeated and the real blocks and the full blocks are 3 at most (Packard and Doyle 1993; Young 1993); how close the
    bounds are is seen in the result. Real blocks take far longer, and where there are no others the lower bound may be
    0: none was found, or there is none. Raises UsageError where the blocks do not fit M or M is not finite.
    """
    matrices = np.asarray(M, dtype=np.complex128)
    matrices = matrices[None] if matrices.ndim == 2 else matrices
    if matrices.ndim != 3:
        raise UsageError(f"mu needs matrices (n_z, n_w) or (n_s, n_z, n_w), not an array of shape {matrices.shape}")
    if not np.all(np.isfinite(matrices)):
        raise UsageError("mu needs finite matrices: leave out the frequencies at which M has a pole")
    structure = Structure.of(blocks, matrices.shape[1:])
    count, n_z, n_w = matrices.shape
    lower, upper = np.zeros(count), np.zeros(count)
    delta = np.full((count, n_w, n_z), np.nan, dtype=complex)
    left, right = (np.tile(np.eye(n, dtype=complex), (count, 1, 1)) for n in (n_z, n_w))
    G = np.zeros((count, n_w, n_z), dtype=complex)
    size = np.max(np.abs(matrices), axis=(1, 2), initial=0.0)
    there = size > 0
    if np.any(there):
        scaled = matrices[there] / size[there, None, None]
        bound, low, own = _bounds(scaled, structure)
        # both are right to rounding, which may put them a few units in the last place out of order
        lower[there], upper[there] = np.minimum(low, bound.bound) * size[there], bound.bound * size[there]
        delta[there], left[there], right[there] = own / size[there, None, None], bound.left, bound.right
        if isinstance(bound, MixedUpper):
            G[there] = bound.G * size[there, None, None]
    return MuResult(lower, upper, delta, (left, right), G)


def _bounds(M: ComplexArray, structure: Structure) -> tuple[Upper, Array, ComplexArray]:
    cover = upper_bound(M, structure.complex_cover())
    if not structure.any_real:
        return cover, *lower_bound(cover.scaled(M), cover.bound, structure)
    bound = mixed_upper_bound(M, structure, cover)
    return bound, *mixed_lower_bound(cover.scaled(M), bound.bound, structure)
