"""Upper bound of mu by D-scaling: the smallest sigma_max(L M R^-1) over scalings that commute with Delta.

The logarithm of sigma_max is convex along every geodesic of scalings, and so is the sum of any increasing convex
function of the logarithms of all singular values. Newton's method follows the minimum of such a barrier,

    t gamma - log det(I - e^-gamma A),   A = R^-H M^H L^H L M R^-1,

as t grows; the distance of gamma to the least log sigma_max^2 is at most n/t. After each step the scaled
matrix takes the place of M, so all derivatives are taken at L = R = I. (Doyle 1982; Sezginer and Overton 1990 for
the convexity; Boyd and El Ghaoui 1993 for methods of centres.) All frequencies at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.robust.blocks import Structure

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_SMALLEST_GAP = 1e-9
_LONGEST_LOG = 150.0
"""Of a scaling: reducible matrices reach their bound only in the limit of infinite scalings."""


@dataclass(frozen=True, eq=False)
class Upper:
    """Bound (n_s,) and scalings, left (n_s, n_z, n_z) and right (n_s, n_w, n_w)."""

    bound: Array
    left: ComplexArray
    right: ComplexArray

    def scaled(self, M: ComplexArray) -> ComplexArray:
        """L M R^-1."""
        return np.asarray((self.left @ M) @ np.linalg.inv(self.right), dtype=np.complex128)


def balanced(M: ComplexArray, structure: Structure, sweeps: int = 6) -> Array:
    """Logarithms of block scalings (n_s, F) that even out rows and columns (Osborne 1960)."""
    rows, columns = structure.members()
    squares = np.einsum("zk,szw,wl->skl", rows, np.abs(M) ** 2, columns)
    count = squares.shape[1]
    with np.errstate(divide="ignore"):
        logs = np.log(squares)
    logs[:, np.arange(count), np.arange(count)] = -np.inf
    x = np.zeros(squares.shape[:2])
    for _ in range(sweeps if count > 1 else 0):
        for k in range(count):
            now = logs + 2 * (x[:, :, None] - x[:, None, :])
            # a floor lets blocks without way back be scaled away, sweep by sweep
            floor = np.max(now, axis=(1, 2), keepdims=True) - 80.0
            now = np.maximum(now, np.where(np.isfinite(floor), floor, 0.0))
            others = np.arange(count) != k
            row, column = now[:, k, others], now[:, others, k]
            x[:, k] += (np.logaddexp.reduce(column, axis=1) - np.logaddexp.reduce(row, axis=1)) / 4
        x = np.clip(x - x.mean(axis=1, keepdims=True), -_LONGEST_LOG, _LONGEST_LOG)
    return x


def upper_bound(M: ComplexArray, structure: Structure) -> Upper:
    """M (n_s, n_z, n_w), none of them zero, of any scale."""
    rows, columns = structure.members()
    x = balanced(M, structure)
    left, right = np.exp(x @ rows.T), np.exp(x @ columns.T)
    start = left[:, :, None] * M / right[:, None, :]
    size = np.linalg.norm(start, axis=(1, 2))
    search = _Search(structure, start / size[:, None, None])
    search.run()
    total_left, total_right = search.left * left[:, None, :], search.right * right[:, None, :]
    return Upper(search.best * size, total_left, total_right)


class _Search:
    """Newton's method on the barrier for a batch; what has converged is left alone."""

    def __init__(self, structure: Structure, M: ComplexArray) -> None:
        self.diagonal = structure.all_full
        self.rows, self.columns = structure.members()
        left, right = structure.directions()
        # gamma is one more direction, a scaling of the right side alone
        self.left_basis = np.concatenate([left, np.zeros((1, *left.shape[1:]))])
        self.right_basis = np.concatenate([right, np.eye(right.shape[-1])[None]])
        self.left_pairs = _pairs(self.left_basis)
        self.right_pairs = _pairs(self.right_basis)
        self.traces = np.trace(self.right_basis, axis1=1, axis2=2).real
        self.M0 = M
        count, n_z, n_w = M.shape
        self.left = np.tile(np.eye(n_z, dtype=complex), (count, 1, 1))
        self.right = np.tile(np.eye(n_w, dtype=complex), (count, 1, 1))
        self.best = np.linalg.norm(M, ord=2, axis=(1, 2))

    def run(self) -> None:
        if len(self.left_basis) == 2:
            return  # one full block: no scaling changes anything
        n = self.right.shape[-1]
        active = np.arange(len(self.M0))
        t = 10.0 * n
        left, right, M = self.left.copy(), self.right.copy(), self.M0
        while True:
            for _ in range(12):
                M, left, right, decrement = self._step(M, left, right, t)
                if np.max(decrement) < 0.1:
                    break
            bound, slope = self._simple_slope(M)
            better = bound < self.best[active]
            chosen = active[better]
            self.best[chosen], self.left[chosen], self.right[chosen] = bound[better], left[better], right[better]
            if n / t < _SMALLEST_GAP:
                return
            go_on = slope > 1e-6
            if not np.any(go_on):
                return
            active, M, left, right = active[go_on], M[go_on], left[go_on], right[go_on]
            t *= 30.0

    def _simple_slope(self, M: ComplexArray) -> tuple[Array, Array]:
        """sigma_max, and the largest slope of its logarithm if it is a simple singular value."""
        u, sigma, vh = np.linalg.svd(M)
        slope = np.abs(u[:, :, 0]) ** 2 @ self.rows - np.abs(vh[:, 0, :]) ** 2 @ self.columns
        if not self.diagonal:
            slope = np.einsum("sa,jab,sb->sj", u[:, :, 0].conj(), self.left_basis[:-1], u[:, :, 0]).real
            slope -= np.einsum("sa,jab,sb->sj", vh[:, 0, :], self.right_basis[:-1], vh[:, 0, :].conj()).real
        return sigma[:, 0], np.max(np.abs(slope), axis=1)

    def _step(
        self, M: ComplexArray, left: ComplexArray, right: ComplexArray, t: float
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray, Array]:
        """One damped Newton step of every matrix; returns the scaled matrices and the Newton decrements."""
        A = M.conj().swapaxes(1, 2) @ M
        values, vectors = np.linalg.eigh(A)
        gamma, value = _centre(values, t)
        root = np.exp(-gamma / 2)[:, None, None]
        inverse = (vectors / (1 - values * np.exp(-gamma)[:, None])[:, None, :]) @ vectors.conj().swapaxes(1, 2)
        gradient, hessian = self._derivatives(M * root, inverse)
        gradient[:, -1] = 0.0  # gamma is at its best already
        scale = np.einsum("sjj->sj", hessian)
        ridge = 1e-11 * scale.max(axis=1)
        hessian[:, np.arange(scale.shape[1]), np.arange(scale.shape[1])] += ridge[:, None]
        step = np.asarray(-np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0], dtype=np.float64)
        decrement = np.sqrt(np.maximum(-np.sum(step * gradient, axis=1), 0.0))
        step[:, -1] = 0.0
        # far from the minimum a scaling may change by e in one step
        step *= np.minimum(1.0, 2.0 / np.maximum(np.max(np.abs(step), axis=1), 1e-300))[:, None]
        new_left, new_right, trial = left.copy(), right.copy(), M.copy()
        todo = np.arange(len(M))
        for _ in range(10):
            d_left, d_right = self._exponential(step[todo])
            moved = (d_left @ M[todo]) @ np.linalg.inv(d_right)
            reached = _centre(np.linalg.eigvalsh(moved.conj().swapaxes(1, 2) @ moved), t)[1]
            good = reached <= value[todo] + 1e-10 * np.abs(value[todo])
            done = todo[good]
            trial[done] = moved[good]
            new_left[done], new_right[done] = d_left[good] @ left[done], d_right[good] @ right[done]
            todo = todo[~good]
            if todo.size == 0:
                break
            step[todo] /= 2
        return trial, new_left, new_right, decrement

    def _derivatives(self, M: ComplexArray, inverse: ComplexArray) -> tuple[Array, Array]:
        """Gradient (n_s, J) and Hessian (n_s, J, J) of the barrier at the identity; inverse = (I - M^H M)^-1."""
        adjoint = M.conj().swapaxes(1, 2)
        back = M @ inverse @ adjoint
        count, size = len(M), len(self.traces)
        flat_right, flat_left = inverse.reshape(count, -1), back.reshape(count, -1)
        gradient = self.traces - (flat_right @ _flat(self.right_basis)).real + (flat_left @ _flat(self.left_basis)).real
        change = self.right_basis - (adjoint[:, None] @ self.left_basis) @ M[:, None]
        relative = inverse[:, None] @ change
        rows = relative.reshape(count, size, -1)
        columns = relative.swapaxes(2, 3).reshape(count, size, -1)
        hessian = (rows @ columns.swapaxes(1, 2)).real
        second = flat_right @ self.right_pairs - flat_left @ self.left_pairs
        return gradient, hessian - second.real.reshape(count, size, size)

    def _exponential(self, step: Array) -> tuple[ComplexArray, ComplexArray]:
        """exp of half the step, for the left and the right scaling."""
        half = step[:, :-1] / 2
        if self.diagonal:
            return _diagonals(np.exp(half @ self.rows.T)), _diagonals(np.exp(half @ self.columns.T))
        return _expm(np.tensordot(half, self.left_basis[:-1], 1)), _expm(np.tensordot(half, self.right_basis[:-1], 1))


def _centre(values: Array, t: float) -> tuple[Array, Array]:
    """The best gamma (n_s,) for eigenvalues (n_s, n), and the barrier's value there."""
    top = np.maximum(values[:, -1:], 1e-300)
    share = np.maximum(values / top, 0.0)
    delta = np.full(len(values), 1 / t)
    # sum share/(1 - share + delta) = t; its inverse is nearly linear in delta
    for _ in range(5):
        terms = share / (1 - share + delta[:, None])
        total = terms.sum(axis=1)
        slope = -(terms / (1 - share + delta[:, None])).sum(axis=1)
        delta = np.maximum(delta - (1 / total - 1 / t) * total**2 / -slope, 1 / t)
    gamma = np.log(top[:, 0]) + np.log1p(delta)
    ratio = share / (1 + delta[:, None])
    return gamma, t * gamma - np.log1p(-ratio).sum(axis=1)


def _flat(basis: ComplexArray) -> ComplexArray:
    """(n n, J) so that a flattened matrix times it gives the traces of the products."""
    return basis.swapaxes(1, 2).reshape(len(basis), -1).T


def _pairs(basis: ComplexArray) -> ComplexArray:
    product = basis[:, None] @ basis[None]
    both = (product + product.swapaxes(0, 1)) / 2
    return _flat(both.reshape(-1, *basis.shape[1:]))


def _diagonals(values: Array) -> ComplexArray:
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]), dtype=np.complex128)


def _expm(H: ComplexArray) -> ComplexArray:
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors * np.exp(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2), dtype=np.complex128)
