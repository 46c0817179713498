"""Upper bound of mu with real parameters by D,G-scaling, for many matrices at once.

With D > 0 that commutes with Delta and G Hermitian on the real blocks and zero elsewhere,

    M^H D M + j (G M - M^H G) <= beta^2 D

proves mu <= beta, since z^H G z is real where w = delta z with a real delta (Fan, Tits and Doyle, IEEE Trans. Autom.
Control 36, 1991, 25-38). The least beta^2 is quasi-convex in (D, G). It is followed as for complex blocks, by Newton's
method on t theta - log det(theta D - M^H D M - j (G M - M^H G)) - log det D + 2 n log tr D with t growing; after each
step the scaled matrix takes the place of M. The search starts from the best D of the complex cover with G = 0, so the
bound is never above that of complex mu. What is returned is an eigenvalue of the scaled form, whatever the search did.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray, IntArray
from trueplant.robust import levels
from trueplant.robust.blocks import Structure
from trueplant.robust.upper import Upper


@dataclass(frozen=True, eq=False)
class MixedUpper(Upper):
    """The bound, D = left^H left of the rows, right^H right of the columns, and G (n_s, n_w, n_z)."""

    G: ComplexArray


@dataclass(frozen=True, eq=False)
class _State:
    """M as scaled by left and right, and G in the same coordinates."""

    M: ComplexArray
    left: ComplexArray
    right: ComplexArray
    G: ComplexArray

    def __getitem__(self, which: IntArray | BoolArray) -> _State:
        return _State(self.M[which], self.left[which], self.right[which], self.G[which])

    def put(self, where: IntArray, other: _State) -> None:
        for name in ("M", "left", "right", "G"):
            getattr(self, name)[where] = getattr(other, name)

    def copy(self) -> _State:
        return _State(self.M.copy(), self.left.copy(), self.right.copy(), self.G.copy())

    def form(self) -> ComplexArray:
        """M^H M + j (G M - M^H G^H), (n_s, n_w, n_w)."""
        crossed = 1j * self.G @ self.M
        return np.asarray(_adjoint(self.M) @ self.M + crossed + _adjoint(crossed), dtype=np.complex128)

    def eigenvalues(self) -> Array:
        """Of the form, ascending, (n_s, n_w)."""
        return np.asarray(np.linalg.eigvalsh(self.form()), dtype=np.float64)


def mixed_upper_bound(M: ComplexArray, structure: Structure, cover: Upper) -> MixedUpper:
    """M (n_s, n_z, n_w), none of them zero, of any scale; cover: the bound of the structure's complex cover."""
    n_z, n_w = structure.shape
    unit = cover.bound[:, None, None]
    one_left, one_right = (np.tile(np.eye(n, dtype=complex), (len(M), 1, 1)) for n in (n_z, n_w))
    start = _State(cover.scaled(M) / unit, one_left, one_right, np.zeros((len(M), n_w, n_z), complex))
    found = _Search(structure).run(start)
    best, G = cover.bound.copy(), np.zeros_like(found.G)
    # from here on only what M itself says of the scalings that were found
    total = Upper(best, found.left @ cover.left, found.right @ cover.right)
    fresh = _State(total.scaled(M) / unit, total.left, total.right, found.G)
    squared = fresh.eigenvalues()[:, -1] + _rounding(fresh)
    bound = np.sqrt(np.maximum(squared, 0.0)) * cover.bound
    better = bound < best
    left, right = cover.left.copy(), cover.right.copy()
    best[better], left[better], right[better] = bound[better], total.left[better], total.right[better]
    G[better] = (unit * _adjoint(total.right) @ found.G @ total.left)[better]
    return MixedUpper(best, left, right, G)


class _Search:
    """Newton's method for a batch; what has converged is left alone."""

    def __init__(self, structure: Structure) -> None:
        self.rows, self.columns = structure.directions()
        self.real = structure.real_directions()
        self.traces = np.trace(self.columns, axis1=1, axis2=2).real
        self.row_products, self.column_products = _products(self.rows), _products(self.columns)

    def run(self, start: _State) -> _State:
        n = start.M.shape[-1]
        best, least = start.copy(), start.eigenvalues()[:, -1]
        active, state, t = np.arange(len(least)), start, levels.FIRST_BARRIER * n
        while active.size:
            pending = np.arange(active.size)
            for _ in range(levels.MOST_NEWTON):
                moved, decrement = self._step(state[pending], t)
                state.put(pending, moved)
                pending = pending[decrement > levels.NEWTON_DECREMENT]
                if pending.size == 0:
                    break
            reached = state.eigenvalues()[:, -1]
            better = reached < least[active]
            best.put(active[better], state[better])
            least[active[better]] = reached[better]
            # below zero no perturbation of any size makes the loop singular
            lost = np.maximum(levels.MIXED_FLOOR, levels.ABOVE_ROUNDING * _rounding(state))
            go_on = (least[active] > 0) & (n / t > np.maximum(levels.MIXED_GAP * least[active], lost))
            active, state = active[go_on], state[go_on]
            t *= levels.BARRIER_GROWTH
        return best

    def _step(self, state: _State, t: float) -> tuple[_State, Array]:
        """One damped step of every matrix, and how far the barrier was to fall by it (Newton decrements)."""
        values, vectors = np.linalg.eigh(state.form())
        theta, value = _centre(np.asarray(values, dtype=np.float64), t)
        value += _spread(state)
        inverse = (vectors / (theta[:, None] - values)[:, None, :]) @ _adjoint(vectors)
        gradient, hessian = self._derivatives(state, theta, inverse)
        curvature, axes = np.linalg.eigh(hessian)
        # the barrier is convex only in (D, G) itself: a negative curvature is turned round
        curvature = np.maximum(np.abs(curvature), levels.LEAST_CURVATURE * np.abs(curvature).max(axis=1, keepdims=True))
        along = np.einsum("sij,si->sj", axes, gradient) / np.maximum(curvature, levels.TINY)
        step = -np.einsum("sij,sj->si", axes, along)
        decrement = np.asarray(np.sqrt(np.maximum(-np.sum(step * gradient, axis=1), 0.0)), dtype=np.float64)
        step = step * self._damping(state, step)[:, None]
        new, pending = state.copy(), np.arange(len(theta))
        for _ in range(levels.MOST_HALVINGS):
            trial = self._moved(state[pending], step[pending])
            reached = _centre(trial.eigenvalues(), t)[1] + _spread(trial)
            good = reached <= value[pending] + 1e-12 * np.abs(value[pending])
            new.put(pending[good], trial[good])
            pending = pending[~good]
            if pending.size == 0:
                break
            step[pending] /= 2
        return new, decrement

    def _damping(self, state: _State, step: Array) -> Array:
        """Far from the minimum D may change by e in one step, and G by as much as its own size and that of M."""
        count = len(self.rows)
        d = np.max(np.abs(step[:, :count]), axis=1)
        g = np.max(np.abs(step[:, count:]), axis=1) / (1 + np.max(np.abs(state.G), axis=(1, 2)))
        return np.asarray(np.minimum(1.0, levels.LONGEST_STEP / np.maximum(np.maximum(d, g), levels.TINY)))

    def _derivatives(self, state: _State, theta: Array, inverse: ComplexArray) -> tuple[Array, Array]:
        """Gradient and Hessian in the directions of log D and of G, theta at its best for each of them."""
        M, adjoint = state.M, _adjoint(state.M)
        count, size, total = len(M), len(self.rows), len(self.rows) + len(self.real)
        by_d = theta[:, None, None, None] * self.columns - adjoint[:, None] @ self.rows @ M[:, None]
        crossed = 1j * self.real @ M[:, None]
        changes = np.concatenate([by_d, -crossed - _adjoint(crossed)], axis=1)
        relative = inverse[:, None] @ changes
        first = np.trace(relative, axis1=2, axis2=3).real
        gradient = -first
        gradient[:, :size] += self.traces
        flat, turned = relative.reshape(count, total, -1), relative.swapaxes(2, 3).reshape(count, total, -1)
        hessian = (flat @ turned.swapaxes(1, 2)).real
        through = (M @ inverse @ adjoint).reshape(count, -1)
        second = (theta[:, None] * inverse.reshape(count, -1)) @ self.column_products - through @ self.row_products
        hessian[:, :size, :size] -= second.real.reshape(count, size, size)
        # of the spread of D; by the search's own steps, so from where it began
        C = state.right @ _adjoint(state.right)
        C *= (C.shape[-1] / np.trace(C, axis1=1, axis2=2).real)[:, None, None]
        along = (C.reshape(count, -1) @ _flat(self.columns)).real
        gradient[:, :size] += 2 * (along - self.traces)
        hessian[:, :size, :size] += 2 * (
            (C.reshape(count, -1) @ self.column_products).real.reshape(count, size, size)
            - along[:, :, None] * along[:, None, :] / C.shape[-1]
        )
        # theta moves along: the complement of its own row
        squared = (inverse @ inverse).reshape(count, -1)
        with_theta = np.einsum("sjab,sba->sj", relative, inverse).real
        with_theta[:, :size] -= (inverse.reshape(count, -1) @ _flat(self.columns)).real
        own = squared[:, :: M.shape[-1] + 1].sum(axis=1).real
        hessian -= with_theta[:, :, None] * with_theta[:, None, :] / own[:, None, None]
        return gradient, hessian

    def _moved(self, state: _State, step: Array) -> _State:
        size = len(self.rows)
        left, right = (np.tensordot(step[:, :size] / 2, basis, 1) for basis in (self.rows, self.columns))
        d_left, d_right, back_left, back_right = _expm(left), _expm(right), _expm(-left), _expm(-right)
        G = state.G + np.tensordot(step[:, size:], self.real, 1)
        return _State(
            d_left @ state.M @ back_right, d_left @ state.left, d_right @ state.right, back_right @ G @ back_left
        )


def _centre(values: Array, t: float) -> tuple[Array, Array]:
    """The best theta (n_s,) for ascending eigenvalues (n_s, n), and the barrier's value there."""
    below = values[:, -1:] - values
    delta = np.full(len(values), 1 / t)
    # sum 1/(below + delta) = t; its inverse is nearly linear in delta
    for _ in range(6):
        terms = 1 / (below + delta[:, None])
        total = terms.sum(axis=1)
        delta = np.maximum(delta + (1 / t - 1 / total) * total**2 / (terms**2).sum(axis=1), 1 / t)
    return values[:, -1] + delta, t * (values[:, -1] + delta) - np.log(below + delta[:, None]).sum(axis=1)


def _spread(state: _State) -> Array:
    """2 (n log tr D - log det D): without it D could vanish where G does not, and the barrier would reward that."""
    n = state.right.shape[-1]
    trace = np.sum(np.abs(state.right) ** 2, axis=(1, 2))
    return np.asarray(2 * n * np.log(trace / n) - 4 * np.linalg.slogdet(state.right)[1], dtype=np.float64)


def _rounding(state: _State) -> Array:
    """What rounding may have taken off the largest eigenvalue of the form."""
    M, G = (np.linalg.norm(m, axis=(1, 2)) for m in (state.M, state.G))
    return np.asarray(4 * state.M.shape[-1] * np.finfo(float).eps * M * (M + 2 * G), dtype=np.float64)


def _adjoint(matrices: ComplexArray) -> ComplexArray:
    return np.asarray(matrices.conj().swapaxes(-1, -2), dtype=np.complex128)


def _flat(basis: ComplexArray) -> ComplexArray:
    """(n n, J) so that a flattened matrix times it gives the traces of the products."""
    return np.asarray(basis.swapaxes(1, 2).reshape(len(basis), -1).T)


def _products(basis: ComplexArray) -> ComplexArray:
    """Symmetric products of all pairs, flattened as by _flat."""
    product = basis[:, None] @ basis[None]
    return _flat(np.asarray((product + product.swapaxes(0, 1)).reshape(-1, *basis.shape[1:]) / 2))


def _expm(H: ComplexArray) -> ComplexArray:
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors * np.exp(values)[:, None, :]) @ _adjoint(vectors), dtype=np.complex128)
