"""Lower bound of mu with real parameters: a perturbation of the structure, real where it has to be, that is singular.

With complex blocks beside the real parameters delta, closing M on them leaves F(delta), and every eigenvalue of
F(delta) Q with a complex Q of size 1 gives a perturbation of size max(max |delta|, 1/|lambda|). The search makes the
larger of the two smaller: the complex part by the power iteration of lower.py, the real one by linear programmes in a
trust region, from several starts. (The power iteration of Young and Doyle, Proc. Conf. on Decision and Control 1990,
1230-1235, looks for the same points and does not always settle.) Real parameters alone are searched in real_lower.py.
A perturbation counts only when I - M Delta is singular to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray, IntArray
from trueplant.robust import levels
from trueplant.robust.blocks import Structure
from trueplant.robust.lower import climbed
from trueplant.robust.real_lower import corners, real_lower_bound


@dataclass(frozen=True, eq=False)
class _Parts:
    """Where the real channels (rows and columns alike) and the complex ones stand, and what the complex ones are."""

    rows: IntArray
    columns: IntArray
    owner: IntArray
    other_rows: IntArray
    other_columns: IntArray
    rest: Structure

    @classmethod
    def of(cls, structure: Structure) -> _Parts:
        kinds: tuple[list[int], ...] = ([], [], [], [], [])
        count = 0
        for block, z, w in structure.places():
            at, into = range(z.start, z.stop), range(w.start, w.stop)
            kinds[0 if block.is_real else 3].extend(at)
            kinds[1 if block.is_real else 4].extend(into)
            if block.is_real:
                kinds[2].extend([count] * block.rows)
                count += 1
        rest = Structure(tuple(block for block in structure.blocks if not block.is_real))
        rows, columns, owner, other_rows, other_columns = (np.array(part, dtype=np.intp) for part in kinds)
        return cls(rows, columns, owner, other_rows, other_columns, rest)

    @property
    def count(self) -> int:
        return int(self.owner[-1]) + 1


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters (n_s, k), 1/|lambda| (n_s,), slopes of log |lambda| (n_s, k), Q/lambda, and where Q is turned to."""

    delta: Array
    other: Array
    slope: Array
    closing: ComplexArray
    direction: ComplexArray

    @property
    def size(self) -> Array:
        return np.asarray(np.maximum(np.max(np.abs(self.delta), axis=1), self.other))

    def put(self, where: BoolArray, other: _Point) -> None:
        for name in ("delta", "other", "slope", "closing", "direction"):
            getattr(self, name)[where] = getattr(other, name)[where]


def mixed_lower_bound(M: ComplexArray, upper: Array, structure: Structure) -> tuple[Array, ComplexArray]:
    """Bound (n_s,) and Delta (n_s, n_w, n_z) for scaled matrices and their upper bounds; nan where none was found."""
    parts = _Parts.of(structure)
    lower, delta = np.zeros(len(M)), np.full((len(M), *structure.shape[::-1]), np.nan, dtype=complex)
    positive = np.flatnonzero(upper > 0)
    unit = upper[positive]
    scaled = M[positive] / unit[:, None, None]
    best, found = np.zeros(len(unit)), delta[positive]
    waited = np.zeros(len(unit), dtype=int)

    def keep(left: IntArray, candidates: ComplexArray) -> None:
        size = _proved(scaled[left], candidates)
        waited[left] = np.where(size > best[left] * (1 + levels.MIXED_TIGHT), 0, waited[left] + 1)
        better = size > best[left]
        best[left[better]], found[left[better]] = size[better], candidates[better]

    if parts.rest.blocks:
        for start in (np.zeros(parts.count), *corners(parts.count, levels.MIXED_STARTS)):
            left = np.flatnonzero((best < 1 - levels.MIXED_TIGHT) & (waited < levels.PATIENCE))
            if left.size:
                keep(left, _descended(scaled[left], parts, start))
    left = np.flatnonzero(best < 1 - levels.MIXED_TIGHT)
    if left.size:
        inner = scaled[np.ix_(left, parts.rows, parts.columns)]
        alone = real_lower_bound(inner, parts.owner)[1]
        keep(left, _assembled(parts, alone, np.zeros((left.size, *parts.rest.shape[::-1]))))
    lower[positive], delta[positive] = best * unit, found / unit[:, None, None]
    return lower, delta


def _proved(M: ComplexArray, delta: ComplexArray) -> Array:
    """1/size of those with which I - M Delta is singular to rounding, 0 of the others."""
    there = np.all(np.isfinite(delta), axis=(1, 2))
    used = np.where(there[:, None, None], delta, 0.0)
    singular = np.linalg.svd(np.eye(M.shape[1]) - M @ used, compute_uv=False)
    size = np.linalg.norm(used, ord=2, axis=(1, 2))
    good = there & (size > 0) & (singular[:, -1] < levels.PROVED * np.maximum(singular[:, 0], 1.0))
    return np.asarray(np.where(good, 1 / np.where(good, size, 1.0), 0.0), dtype=np.float64)


def _assembled(parts: _Parts, real: Array, rest: ComplexArray | Array) -> ComplexArray:
    whole = np.zeros(
        (len(real), parts.columns.size + parts.other_columns.size, parts.rows.size + parts.other_rows.size), complex
    )
    whole[:, parts.columns, parts.rows] = real[:, parts.owner]
    whole[:, parts.other_columns[:, None], parts.other_rows[None, :]] = rest
    return whole


def _descended(M: ComplexArray, parts: _Parts, start: Array) -> ComplexArray:
    """The smallest perturbation found from one start."""
    point = _point(M, parts, np.tile(start, (len(M), 1)), None)
    trust = np.full(len(M), levels.FIRST_TRUST)
    for _ in range(levels.MIXED_STEPS):
        trial = _point(M, parts, _programme(point, trust), point.direction)
        better = trial.size < point.size
        point.put(better, trial)
        trust = np.where(better, np.minimum(2 * trust, 2.0), trust / 3)
        if np.max(trust) < levels.LEAST_TRUST:
            break
    return _assembled(parts, point.delta, point.closing)


def _programme(point: _Point, trust: Array) -> Array:
    """Parameters within the smallest box for which the slopes promise a lambda that fits it."""
    size = point.size
    reach = (trust * size)[:, None] * np.sign(point.slope)

    def at(box: Array) -> Array:
        return np.clip(point.delta + reach, -box[:, None], box[:, None])

    low, high = size / (1 + trust), size
    for _ in range(levels.HALVINGS):
        middle = (low + high) / 2
        gain = np.sum(point.slope * (at(middle) - point.delta), axis=1)
        fits = gain - np.log(point.other) >= -np.log(middle)
        low, high = np.where(fits, low, middle), np.where(fits, middle, high)
    return at(high)


def _point(M: ComplexArray, parts: _Parts, delta: Array, direction: ComplexArray | None) -> _Point:
    """M closed on the parameters, the best complex perturbation of what is left, and how it changes with them."""
    each = np.arange(len(M))
    rr, rc = M[np.ix_(each, parts.rows, parts.columns)], M[np.ix_(each, parts.rows, parts.other_columns)]
    cr, cc = M[np.ix_(each, parts.other_rows, parts.columns)], M[np.ix_(each, parts.other_rows, parts.other_columns)]
    d = delta[:, parts.owner]
    inverse = _inverse(np.eye(d.shape[1]) - rr * d[:, None, :])
    back = inverse @ rc
    F = cc + (cr * d[:, None, :]) @ back
    size, closing = climbed(F, np.linalg.svd(F)[2][:, 0].conj(), parts.rest, levels.FIRST_CLIMB)
    if direction is not None and len(parts.rest.blocks) > 1:
        warm, warmed = climbed(F, direction, parts.rest, levels.FIRST_CLIMB)
        better = warm > size
        size[better], closing[better] = warm[better], warmed[better]
    # an eigenvalue of F closing is 1: its vectors on both sides are null vectors of the difference
    used = np.where(np.isfinite(closing), closing, 0.0)
    u, _, vh = np.linalg.svd(np.eye(F.shape[1]) - F @ used)
    y, x = u[:, :, -1], vh[:, -1].conj()
    into = (used @ x[:, :, None])[:, :, 0]
    ahead = np.einsum("sa,sab->sb", y.conj(), cr)
    ahead = ahead + np.einsum("sa,sab->sb", ahead * d, inverse @ rr)
    product = np.sum(y.conj() * x, axis=1)
    per_channel = ahead * (back @ into[:, :, None])[:, :, 0] / np.where(product == 0, 1.0, product)[:, None]
    slope = np.asarray(per_channel.real @ (parts.owner[:, None] == np.arange(parts.count)), dtype=np.float64)
    with np.errstate(divide="ignore"):
        other = np.asarray(np.minimum(1 / size, levels.NO_BOUND), dtype=np.float64)
    return _Point(delta, other, slope, closing, into)


def _inverse(matrices: ComplexArray) -> ComplexArray:
    """Of regular matrices; for a singular one, large numbers."""
    u, s, vh = np.linalg.svd(matrices)
    s = np.maximum(s, levels.SINGULAR * np.maximum(s[:, :1], 1.0))
    return np.asarray((vh.conj().swapaxes(1, 2) / s[:, None, :]) @ u.conj().swapaxes(1, 2), dtype=np.complex128)
