"""Lower bound of mu for real parameters alone: the largest real eigenvalue of M Q over real Q of size 1.

Looked at are the corners of the box of parameters, where the largest lies for a real M, and its edges, where it mostly
lies otherwise: all parameters but one are at their limits (Dailey, Proc. American Control Conf. 1990). From the best of
them a local search goes on by linear programmes over all parameters at once: the eigenvalue's derivatives say how it
moves with each of them, the part beside the real axis is to vanish (it costs more than it can gain), no parameter
leaves [-1, 1] or moves further than a trust region.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray, IntArray
from trueplant.robust import levels


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters q (n_s, k), the eigenvalue (n_s,), its derivatives (n_s, k) and what the point is worth (n_s,)."""

    q: Array
    value: ComplexArray
    slope: ComplexArray
    merit: Array

    def put(self, where: BoolArray, other: _Point) -> None:
        for name in ("q", "value", "slope", "merit"):
            getattr(self, name)[where] = getattr(other, name)[where]


def corners(count: int, most: int) -> Array:
    """Corners of the box of parameters, (n_t, count): all of them in random order, or as many as are allowed."""
    rng = np.random.default_rng(0)
    if 2**count <= most:
        every = np.stack(np.meshgrid(*[[1.0, -1.0]] * count, indexing="ij"), axis=-1).reshape(-1, count)
        return np.asarray(rng.permutation(every))
    return rng.choice([1.0, -1.0], size=(most, count))


def real_lower_bound(M: ComplexArray, owner: IntArray) -> tuple[Array, Array]:
    """Bound (n_s,) and real parameters (n_s, k) of size 1/bound for M (n_s, n, n); 0 and nan where none was found.

    owner: the parameter of each channel, (n,). That det(I - M Delta) = 0 is left to the caller to check.
    """
    k = int(owner[-1]) + 1
    best, q = np.zeros(len(M)), np.ones((len(M), k))

    def keep(size: Array, candidate: Array) -> None:
        better = size > best
        best[better], q[better] = size[better], candidate[better]

    for corner in corners(k, levels.REAL_CORNERS):
        values = np.linalg.eigvals(M * corner[owner])
        real = np.where(np.abs(values.imag) < levels.ON_THE_AXIS * np.abs(values), values.real, 0.0)
        keep(np.max(real, axis=1), np.tile(corner, (len(M), 1)))
    starts, alone = corners(k, levels.MIXED_STARTS), owner.size == k
    for free in range(k if alone and k > 1 else 0):
        others = starts.copy()
        others[:, free] = 0.0
        for signs in np.unique(others, axis=0):
            keep(*_on_edge(M, free, signs))
    best, found = _settled(M, owner, _point(M, owner, q, best))
    # the rest: points within the box that no edge reaches, and numbers that are repeated
    for start in (q, *(np.tile(corner, (len(M), 1)) for corner in ([] if alone else starts))):
        size, candidate = _climbed(M, owner, start)
        better = size > best
        best[better], found[better] = size[better], candidate[better]
    return best, found


def _on_edge(M: ComplexArray, free: int, signs: Array) -> tuple[Array, Array]:
    """Largest 1/r (n_s,) and q (n_s, k) for parameters r signs, one number each, with the free one between -r and r.

    det(I - M Delta) = a(r) + delta b(r) vanishes for a real delta where Im a b* does: a real polynomial in r.
    """
    k = signs.size
    nodes = np.exp(2j * np.pi * np.arange(k) / k)
    unit = np.eye(k)[free]
    one = np.eye(k) - M[:, None] * (nodes[:, None] * signs)[None, :, None, :]
    values = np.stack([np.linalg.det(one), np.linalg.det(one - M[:, None] * unit)], axis=1)
    # values on the unit circle to coefficients, lowest power first
    a, both = np.moveaxis(np.fft.fft(values, axis=2) / k, 1, 0)
    b = both - a
    crossed = np.zeros((len(M), 2 * k - 1))
    for power in range(k):
        crossed[:, power : power + k] += (a[:, power, None] * b.conj()).imag
    roots = _roots(crossed)
    r = np.maximum(roots.real, levels.TINY)
    powers = r[:, :, None] ** np.arange(k)
    rest, slope = (np.sum(c[:, None] * powers, axis=2) for c in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        delta = -(rest / slope).real
    # of a real M any r would do, and the roots are those of rounding
    genuine = np.max(np.abs(crossed), axis=1) > levels.ROOT * np.max(np.abs(a), axis=1) * np.max(np.abs(b), axis=1)
    good = genuine[:, None] & (np.abs(roots.imag) < levels.ROOT * r) & (np.abs(delta) <= r) & (r > levels.ROOT)
    r, delta = np.where(good, r, 1.0), np.where(good, delta, 0.0)
    size = np.where(good, 1 / r, 0.0)
    chosen = np.argmax(size, axis=1)[:, None]
    q = np.take_along_axis(delta / r, chosen, 1) * unit
    return np.max(size, axis=1), q + signs


def _roots(coefficients: Array) -> ComplexArray:
    """Of polynomials (n_s, m + 1), lowest power first; what is of lower degree gets roots far away."""
    scale = np.max(np.abs(coefficients), axis=1, keepdims=True)
    c = coefficients / np.maximum(scale, levels.TINY)
    top = np.where(np.abs(c[:, -1]) < levels.SINGULAR, levels.SINGULAR, c[:, -1])
    m = c.shape[1] - 1
    companion = np.zeros((len(c), m, m))
    companion[:, np.arange(1, m), np.arange(m - 1)] = 1.0
    companion[:, :, -1] = -c[:, :-1] / top[:, None]
    return np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)


def _climbed(M: ComplexArray, owner: IntArray, q: Array) -> tuple[Array, Array]:
    point = _point(M, owner, q)
    trust = np.full(len(M), levels.FIRST_TRUST)
    for _ in range(levels.REAL_STEPS):
        q = point.q + _programme(point, trust)
        # a smaller box would only scale the eigenvalue
        trial = _point(M, owner, q / np.maximum(np.max(np.abs(q), axis=1, keepdims=True), levels.TINY))
        better = trial.merit > point.merit
        point.put(better, trial)
        trust = np.where(better, np.minimum(2 * trust, 2.0), trust / 3)
        if np.max(trust) < levels.LEAST_TRUST:
            break
    return _settled(M, owner, point)


def _settled(M: ComplexArray, owner: IntArray, point: _Point) -> tuple[Array, Array]:
    """Put onto the real axis by the parameters that have room; the bound, 0 where that fails, and the parameters."""
    for _ in range(levels.POLISHING):
        g = point.slope.imag
        room = 1e-3 + np.maximum(1 - np.abs(point.q), 0.0)
        least = (levels.ON_THE_AXIS * np.abs(point.value)) ** 2 + levels.TINY
        step = point.value.imag / np.maximum(np.sum(room * g**2, axis=1), least)
        point = _point(M, owner, point.q - np.clip(step[:, None] * room * g, -0.1, 0.1), point.value)
    extent = np.max(np.abs(point.q), axis=1)
    real = (np.abs(point.value.imag) < levels.ON_THE_AXIS * np.abs(point.value)) & (point.value.real > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.where(real & (extent > 0), point.value.real / extent, 0.0)
        return size, np.where(size[:, None] > 0, point.q / point.value.real[:, None], np.nan)


def _point(M: ComplexArray, owner: IntArray, q: Array, near: ComplexArray | Array | None = None) -> _Point:
    """The eigenvalue of M Q that is worth most there, or is next to another, and how it moves."""
    values, vectors = np.linalg.eig(M * q[:, owner][:, None, :])
    # a defective matrix has no inverse of its vectors: the largest finite numbers stand for one
    u, s, vh = np.linalg.svd(vectors)
    inverse = (vh.conj().swapaxes(1, 2) / np.maximum(s, levels.SINGULAR)[:, None, :]) @ u.conj().swapaxes(1, 2)
    worth = values.real - levels.OFF_AXIS * np.abs(values.imag)
    chosen = np.argmax(worth, axis=1) if near is None else np.argmin(np.abs(values - near[:, None]), axis=1)
    each = np.arange(len(M))
    by_channel = np.einsum("sa,sab->sb", inverse[each, chosen], M) * vectors[each, :, chosen]
    slope = by_channel @ (owner[:, None] == np.arange(q.shape[1]))
    return _Point(q, values[each, chosen].astype(np.complex128), slope, worth[each, chosen])


def _programme(point: _Point, trust: Array) -> Array:
    """The step of largest Re dlambda - c |Im lambda + Im dlambda| within the box and the trust region, by its dual."""
    up = np.minimum(1 - point.q, trust[:, None])
    down = np.maximum(-1 - point.q, -trust[:, None])

    def step(multiplier: Array) -> tuple[Array, Array]:
        gain = point.slope.real + multiplier[:, None] * point.slope.imag
        taken = np.where(gain > 0, up, np.where(gain < 0, down, 0.0))
        return taken, point.value.imag + np.sum(point.slope.imag * taken, axis=1)

    # the part beside the axis grows with the multiplier: it is zero between two of them, or beyond the price
    low = np.full(len(trust), -levels.OFF_AXIS)
    high = -low
    for _ in range(levels.HALVINGS):
        middle = (low + high) / 2
        positive = step(middle)[1] > 0
        low, high = np.where(positive, low, middle), np.where(positive, middle, high)
    (first, below), (second, above) = step(low), step(high)
    share = np.where(above > below, -below / np.where(above > below, above - below, 1.0), 0.5)
    return np.asarray(first + np.clip(share, 0, 1)[:, None] * (second - first))
