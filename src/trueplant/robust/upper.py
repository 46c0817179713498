"""Upper bound of mu by D-scaling: the smallest sigma_max(L M R^-1) over scalings that commute with Delta.

The logarithm of sigma_max is convex along every geodesic of scalings, and so is the sum of any increasing convex
function of the logarithms of all singular values. Newton's method follows the minimum of such a barrier,

    t gamma - log det(I - e^-gamma A),   A = R^-H M^H L^H L M R^-1,

as t grows; the distance of gamma to the least log sigma_max^2 is at most n/t. After each step the scaled
matrix takes the place of M, so all derivatives are taken at L = R = I. (Doyle 1982; Sezginer and Overton 1990 for
the convexity; Boyd and El Ghaoui 1993 for methods of centres.) All frequencies at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.robust import levels
from trueplant.robust.blocks import Structure


@dataclass(frozen=True, eq=False)
class Upper:
    """Bound (n_s,) and scalings, left (n_s, n_z, n_z) and right (n_s, n_w, n_w)."""

    bound: Array
    left: ComplexArray
    right: ComplexArray

    def scaled(self, M: ComplexArray) -> ComplexArray:
        """L M R^-1."""
        return np.asarray((self.left @ M) @ np.linalg.inv(self.right), dtype=np.complex128)


def balanced(M: ComplexArray, structure: Structure, sweeps: int = levels.SWEEPS) -> Array:
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
            # zeros are lifted to a floor, so that blocks of a reducible matrix are scaled apart sweep by sweep
            floor = np.max(now, axis=(1, 2), keepdims=True) - levels.BALANCING_FLOOR
            now = np.maximum(now, np.where(np.isfinite(floor), floor, 0.0))
            others = np.arange(count) != k
            row, column = now[:, k, others], now[:, others, k]
            x[:, k] += (np.logaddexp.reduce(column, axis=1) - np.logaddexp.reduce(row, axis=1)) / 4
        x = np.clip(x - x.mean(axis=1, keepdims=True), -levels.LONGEST_LOG, levels.LONGEST_LOG)
    return x


def upper_bound(M: ComplexArray, structure: Structure) -> Upper:
    """M (n_s, n_z, n_w), none of them zero, of any scale."""
    rows, columns = structure.members()
    x = balanced(M, structure)
    left, right = np.exp(x @ rows.T), np.exp(x @ columns.T)
    start = left[:, :, None] * M / right[:, None, :]
    size = np.linalg.norm(start, axis=(1, 2))
    # a scaling by numbers needs far less work than one by matrices, which only repeated numbers call for
    kind = _ByNumbers if structure.all_full else _ByMatrices
    search = kind(structure, start / size[:, None, None])
    search.run()
    total_left, total_right = search.left * left[:, None, :], search.right * right[:, None, :]
    return Upper(search.best * size, total_left, total_right)


class _Search(ABC):
    """Newton's method on the barrier for a batch; what has converged is left alone.

    J directions of the logarithm of the scaling, and gamma as the last: a scaling of the right side alone.
    """

    directions: int

    def __init__(self, M: ComplexArray) -> None:
        self.M0 = M
        count, n_z, n_w = M.shape
        self.left = np.tile(np.eye(n_z, dtype=complex), (count, 1, 1))
        self.right = np.tile(np.eye(n_w, dtype=complex), (count, 1, 1))
        self.best = np.linalg.norm(M, ord=2, axis=(1, 2))

    @abstractmethod
    def derivatives(self, M: ComplexArray, inverse: ComplexArray, back: ComplexArray) -> tuple[Array, Array]:
        """Gradient (n_s, J + 1) and Hessian of the barrier at the identity, inverse = X = (I - M^H M)^-1, back = X M^H.

        For the directions E_i and the change S_i = E_i - M^H E_i M of I - M^H M: gradient tr E_i - tr X S_i, Hessian
        tr X S_i X S_j - tr X S_ij with S_ij the same of the symmetric product of E_i and E_j.
        """

    @abstractmethod
    def slopes(self, u: ComplexArray, v: ComplexArray) -> Array:
        """Change of log sigma (n_s, J) for its singular vectors u (n_s, n_z) and v (n_s, n_w)."""

    @abstractmethod
    def moved(self, step: Array, *matrices: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """M, left and right after the step (n_s, J)."""

    def run(self) -> None:
        if self.directions == 1:
            return  # one full block: no scaling changes anything
        n = self.right.shape[-1]
        active = np.arange(len(self.M0))
        t = levels.FIRST_BARRIER * n
        left, right, M = self.left.copy(), self.right.copy(), self.M0
        while True:
            for _ in range(levels.MOST_NEWTON):
                M, left, right, decrement = self._step(M, left, right, t)
                if np.max(decrement) < levels.NEWTON_DECREMENT:
                    break
            u, sigma, vh = np.linalg.svd(M)
            better = sigma[:, 0] < self.best[active]
            chosen = active[better]
            self.best[chosen], self.left[chosen], self.right[chosen] = sigma[better, 0], left[better], right[better]
            # no slope at a simple singular value: this is the minimum; at a repeated one only t tells
            go_on = np.max(np.abs(self.slopes(u[:, :, 0], vh[:, 0, :].conj())), axis=1) > levels.NO_SLOPE
            if n / t < levels.SMALLEST_GAP or not np.any(go_on):
                return
            active, M, left, right = active[go_on], M[go_on], left[go_on], right[go_on]
            t *= levels.BARRIER_GROWTH

    def _step(
        self, M: ComplexArray, left: ComplexArray, right: ComplexArray, t: float
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray, Array]:
        """One damped Newton step of every matrix; returns the scaled matrices and the Newton decrements."""
        values, vectors = np.linalg.eigh(M.conj().swapaxes(1, 2) @ M)
        gamma, value = _centre(values, t)
        root = np.exp(-gamma / 2)[:, None, None]
        adjoint = vectors.conj().swapaxes(1, 2)
        inverse = (vectors / (1 - values * np.exp(-gamma)[:, None])[:, None, :]) @ adjoint
        now = M * root
        gradient, hessian = self.derivatives(now, inverse, inverse @ now.conj().swapaxes(1, 2))
        gradient[:, -1] = 0.0  # gamma is at its best already
        each = np.arange(self.directions + 1)
        hessian[:, each, each] += 1e-11 * hessian[:, each, each].max(axis=1, keepdims=True)
        step = np.asarray(-np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0], dtype=np.float64)
        decrement = np.sqrt(np.maximum(-np.sum(step * gradient, axis=1), 0.0))
        step = step[:, :-1]
        # far from the minimum a scaling may change by e in one step
        longest = np.maximum(np.max(np.abs(step), axis=1), 1e-300)
        step = step * np.minimum(1.0, levels.LONGEST_STEP / longest)[:, None]
        new = M.copy(), left.copy(), right.copy()
        pending = np.arange(len(M))
        for _ in range(levels.MOST_HALVINGS):
            trial = self.moved(step[pending], M[pending], left[pending], right[pending])
            reached = _centre(_eigenvalues(trial[0]), t)[1]
            good = reached <= value[pending] + 1e-10 * np.abs(value[pending])
            for kept, found in zip(new, trial, strict=True):
                kept[pending[good]] = found[good]
            pending = pending[~good]
            if pending.size == 0:
                break
            step[pending] /= 2
        return *new, decrement


class _ByNumbers(_Search):
    """Full blocks only: E_i are diagonal, and traces of products are sums of squares over blocks."""

    def __init__(self, structure: Structure, M: ComplexArray) -> None:
        super().__init__(M)
        rows, columns = structure.members()
        self.directions = rows.shape[1]
        self.rows, self.columns = rows, columns
        self.all_rows = np.column_stack([rows, np.zeros(len(rows))])
        self.all_columns = np.column_stack([columns, np.ones(len(columns))])

    def derivatives(self, M: ComplexArray, inverse: ComplexArray, back: ComplexArray) -> tuple[Array, Array]:
        L, R = self.all_rows, self.all_columns
        through = M @ back
        x, b = (np.diagonal(m, axis1=1, axis2=2).real for m in (inverse, through))
        crossed = _sums(back, R, L)
        hessian = _sums(inverse, R, R) - crossed - crossed.swapaxes(1, 2) + _sums(through, L, L)
        second = np.tensordot(x, R[:, :, None] * R[:, None, :], 1) - np.tensordot(b, L[:, :, None] * L[:, None, :], 1)
        return (1 - x) @ R + b @ L, hessian - second

    def slopes(self, u: ComplexArray, v: ComplexArray) -> Array:
        return np.asarray(np.abs(u) ** 2 @ self.rows - np.abs(v) ** 2 @ self.columns)

    def moved(self, step: Array, *matrices: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        M, left, right = matrices
        d_left, d_right = np.exp(step / 2 @ self.rows.T)[:, :, None], np.exp(step / 2 @ self.columns.T)
        return d_left * M / d_right[:, None, :], d_left * left, d_right[:, :, None] * right


class _ByMatrices(_Search):
    """Repeated numbers as well: their E_i span the Hermitian matrices."""

    def __init__(self, structure: Structure, M: ComplexArray) -> None:
        super().__init__(M)
        self.rows, self.columns = structure.directions()
        self.directions = len(self.rows)
        self.all_rows = np.concatenate([self.rows, np.zeros((1, *self.rows.shape[1:]))])
        self.all_columns = np.concatenate([self.columns, np.eye(self.columns.shape[-1])[None]])

    def derivatives(self, M: ComplexArray, inverse: ComplexArray, back: ComplexArray) -> tuple[Array, Array]:
        count, size = len(M), self.directions + 1
        x, b = inverse.reshape(count, -1), (M @ back).reshape(count, -1)
        traces = np.trace(self.all_columns, axis1=1, axis2=2).real
        gradient = traces - (x @ _flat(self.all_columns)).real + (b @ _flat(self.all_rows)).real
        change = self.all_columns - (M.conj().swapaxes(1, 2)[:, None] @ self.all_rows) @ M[:, None]
        relative = inverse[:, None] @ change
        left, right = relative.reshape(count, size, -1), relative.swapaxes(2, 3).reshape(count, size, -1)
        second = x @ _flat(_products(self.all_columns)) - b @ _flat(_products(self.all_rows))
        return gradient, (left @ right.swapaxes(1, 2)).real - second.real.reshape(count, size, size)

    def slopes(self, u: ComplexArray, v: ComplexArray) -> Array:
        forms = (np.einsum("sa,jab,sb->sj", x.conj(), E, x).real for x, E in ((u, self.rows), (v, self.columns)))
        return np.asarray(next(forms) - next(forms))

    def moved(self, step: Array, *matrices: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        M, left, right = matrices
        d_left, d_right = (_expm(np.tensordot(step / 2, basis, 1)) for basis in (self.rows, self.columns))
        return np.asarray(d_left @ M @ np.linalg.inv(d_right), dtype=np.complex128), d_left @ left, d_right @ right


def _sums(matrices: ComplexArray, rows: Array, columns: Array) -> Array:
    """Sums of the squared sizes of the elements over the members of blocks."""
    return np.asarray(np.tensordot(np.tensordot(np.abs(matrices) ** 2, columns, 1), rows, (1, 0)).swapaxes(1, 2))


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


def _eigenvalues(M: ComplexArray) -> Array:
    """Of M^H M."""
    return np.asarray(np.linalg.eigvalsh(M.conj().swapaxes(1, 2) @ M), dtype=np.float64)


def _flat(basis: ComplexArray) -> ComplexArray:
    """(n n, J) so that a flattened matrix times it gives the traces of the products."""
    return basis.swapaxes(1, 2).reshape(len(basis), -1).T


def _products(basis: ComplexArray) -> ComplexArray:
    """Symmetric products of all pairs, (J J, n, n)."""
    product = basis[:, None] @ basis[None]
    return np.asarray((product + product.swapaxes(0, 1)).reshape(-1, *basis.shape[1:]) / 2)


def _expm(H: ComplexArray) -> ComplexArray:
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors * np.exp(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2), dtype=np.complex128)
