"""Initial guesses of the fit: the time scale and the dead time of each element on a grid, gains by least squares.

The cost of a dead time has several minima; the grid covers them all, one element at a time with the
gains of all others and the nuisance terms projected out, and several times over.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify import levels
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
from trueplant.lti.sampled import rows_response
from trueplant.lti.structure import Structure


def initial_theta(row: Row, time_scale: float) -> Array:
    """The models' parameters; elements without one get the time scale, unit gain and no dead time.

    From a lag of 0 no search gets away: it begins with the shortest part of the dead time that is tried.
    """
    parts = []
    for spec in row.specs:
        guess = spec.initial if spec.guess is None else spec.guess
        if guess is not None:
            p = np.array(guess, dtype=float)
            none = spec.structure.is_lag & (p == 0)
            parts.append(np.where(none, levels.STRETCH.min() * spec.structure.longest_dead_time(p), p))
            continue
        lags = time_scale / np.arange(1, spec.structure.lags + 1)
        parts.append(spec.structure.parameters(1.0, lags, 2.0 / time_scale, 0.7, time_scale / 10, 0.0))
    return np.concatenate(parts)


def grid_guess(row: Row, theta: Array, ar: Array, rounds: int = 2, largest: int = 20_000) -> Array:
    """theta with time scales, dead times and gains that the data prefer (given the noise model)."""
    samples = sum(len(range(0, p.y.size, row.stride)) for p in row.pieces)
    if samples > largest and ar.size == 0:
        row = Row(row.specs, row.pieces, row.stride * int(np.ceil(samples / largest)))
    theta = theta.copy()
    for _ in range(rounds):
        before = theta.copy()
        for m in range(len(row.specs)):
            theta = improved_element(row, theta, ar, m)[0]
        if np.allclose(theta, before, rtol=1e-12, atol=0):
            break
    return _least_squares_gains(row, theta, ar)


def _unit(row: Row, theta: Array, m: int) -> Array:
    """Parameters of element m with its gains scaled so that the largest is 1."""
    p = theta[row.slices[m]].copy()
    count = row.specs[m].structure.delayed
    largest = np.max(np.abs(p[:count]))
    p[:count] = p[:count] / largest if largest > 0 else 1.0
    return p


def _columns(row: Row, theta: Array, skip: int | None = None) -> list[Array]:
    """For each piece, the responses of the elements at unit gain, but for the one to skip."""
    kept = [m for m in range(len(row.specs)) if m != skip]
    out = []
    for piece in row.pieces:
        n = len(range(0, piece.y.size, row.stride))
        columns = np.zeros((n, len(kept)))
        for c, m in enumerate(kept):
            spec = row.specs[m]
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            columns[:, c] = spec.structure.response(_unit(row, theta, m), u, piece.h, hold, row.stride)
        out.append(columns)
    return out


def dead_time_grid(row: Row, m: int, p: Array, h: float, finest: int = 48) -> Array:
    """Dead times to try for element m, in whole samples of the record."""
    structure = row.specs[m].structure
    longest = max(3 * structure.longest_dead_time(p), structure.lag(p), 10 * h)
    longest = min(longest, max(q.span for q in row.pieces) / 4)
    count = max(int(longest / h), 1)
    return np.unique(np.round(np.linspace(0, count, min(count + 1, finest))).astype(int))


def improved_element(row: Row, theta: Array, ar: Array, m: int) -> tuple[Array, float]:
    """theta with the time scale, the dead time, the gain and the leads of element m that the data prefer.

    And how much of the squares of PV it then explains that the other elements do not.
    """
    structure, part = row.specs[m].structure, row.slices[m]
    unit = _unit(row, theta, m)
    exponents = structure.time_scales
    dead = structure.is_dead_time
    h = row.pieces[0].h
    shifts = dead_time_grid(row, m, unit, h) if dead.any() else np.zeros(1, dtype=int)
    others = _columns(row, theta, skip=m)
    size = len(_numerators(structure, unit))
    gram = np.zeros((levels.STRETCH.size, shifts.size, size, size))
    whole = np.zeros_like(gram)
    moment = np.zeros((levels.STRETCH.size, shifts.size, size))
    nominal = theta.copy()
    for k, piece in enumerate(row.pieces):
        y, valid = row.measured(k)
        if y.size <= ar.size + 1:
            continue
        use = whitened_valid(ar.size, valid)
        if not use.any():
            continue
        basis = orthonormal(whiten(ar, np.hstack([others[k], row.nuisance(nominal, k)]))[use])
        target = whiten(ar, y)[use]
        columns = np.zeros((1 + basis.shape[1], use.size))
        columns[:, use] = np.vstack([target - basis @ (basis.T @ target), basis.T])
        stretched = unit * levels.STRETCH[:, None] ** exponents
        stretched[:, dead] = unit[dead] - (unit[dead].min() if dead.any() else 0.0)
        late = np.zeros((levels.STRETCH.size, size, shifts[-1] + piece.y.size))
        for a, p in enumerate(stretched):
            late[a, :, shifts[-1] :] = _responses(row, m, p, piece)
        told, energy = _delayed_products(late, shifts[-1] - shifts, row.stride, ar, columns, use)
        moment += told[..., 0]
        whole += energy
        gram += energy - told[..., 1:] @ told[..., 1:].swapaxes(-1, -2)
    weights = _solved(gram, moment, np.sqrt(np.diagonal(whole, axis1=-2, axis2=-1)))
    top = np.sum(weights * moment, axis=-1)
    a, b = divmod(int(np.argmax(top)), shifts.size)
    if top[a, b] <= 0:
        return theta, 0.0
    p = unit * levels.STRETCH[a] ** exponents
    if dead.any():
        p[dead] = unit[dead] - unit[dead].min() + shifts[b] * h
    p[: structure.delayed] *= weights[a, b, -1]
    if size > 1 and np.all(weights[a, b]):
        p[structure.is_lead] = -np.real(1 / np.roots(weights[a, b]))
    theta = theta.copy()
    theta[part] = p
    return theta, float(top[a, b])


def _delayed_products(
    late: Array, starts: IntArray, stride: int, ar: Array, columns: Array, use: BoolArray
) -> tuple[Array, Array]:
    """Whitened responses times columns (..., starts, n, c), and times each other (..., starts, n, n).

    Each start is the sample of `late` (..., n, N) where the responses begin for one of many dead times. From there on
    they are seen at every `stride`-th sample and whitened by `ar`. The columns (c, m) are 0 where `use` (m,) is False.
    All dead times are slices of one whitened response.
    """
    n, m, used = late.shape[-2], columns.shape[-1], use.astype(float)
    told = np.empty((*late.shape[:-1], len(columns), starts.size))
    energy = np.empty((*late.shape[:-1], n, starts.size))
    for phase in np.unique(starts % stride):
        seen = late[..., phase::stride]
        rows = whiten(ar, seen.reshape(-1, seen.shape[-1]).T).T.reshape(*seen.shape[:-1], -1)
        pairs = combinations_with_replacement(range(n), 2)
        products = {(one, other): rows[..., one, :] * rows[..., other, :] for one, other in pairs}
        for k in np.flatnonzero(starts % stride == phase):
            part = slice(starts[k] // stride, starts[k] // stride + m)
            told[..., k] = rows[..., part] @ columns.T
            for (one, other), product in products.items():
                energy[..., one, other, k] = energy[..., other, one, k] = product[..., part] @ used
    return np.moveaxis(told, -1, -3), np.moveaxis(energy, -1, -3)


def _numerators(structure: Structure, p: Array) -> Array:
    """(n, order + 1) numerators whose sum, each with a weight of its own, is that of an element.

    Powers of s where it has leads: the coefficients are linear, whatever the signs of the leads.
    """
    if structure.leads and structure.delayed == 1:
        return np.eye(structure.leads + 1)
    return structure.polynomials(p)[0][None, :]


def _responses(row: Row, m: int, p: Array, piece: Piece) -> Array:
    """(n, N) responses of the numerators of element m, or of all of its delayed terms together."""
    spec = row.specs[m]
    u, hold = piece.inputs[spec.column], piece.hold[spec.column]
    if spec.structure.delayed > 1:
        return spec.structure.response(p, u, piece.h, hold)[None, :]
    num, den = _numerators(spec.structure, p), spec.structure.polynomials(p)[1]
    padded = np.hstack([np.zeros((len(num), len(den) - num.shape[1])), num]) / den[0]
    return rows_response(padded, den / den[0], float(spec.structure.dead_times(p)[0]), u, piece.h, hold)


def _solved(gram: Array, moment: Array, whole: Array) -> Array:
    """Weights (..., n) of least squares; 0 where the responses cannot be told from nothing or from each other.

    `whole` (..., n) is their size with what other elements and unknowns do as well.
    """
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 0.0))
    there = np.all(scale > 1e-6 * np.maximum(np.maximum(scale.max(), whole), 1e-150), axis=-1)
    normal = gram / np.where(there[..., None, None], scale[..., :, None] * scale[..., None, :], 1.0)
    eye = np.eye(moment.shape[-1])
    normal = np.where(there[..., None, None], normal + levels.RIDGE * eye, eye)
    safe = np.where(there[..., None], scale, 1.0)
    weights = np.linalg.solve(normal, (moment / safe)[..., None])[..., 0] / safe
    return np.asarray(np.where(there[..., None], weights, 0.0))


def _least_squares_gains(row: Row, theta: Array, ar: Array) -> Array:
    """theta with the gain of each element by least squares over all pieces."""
    columns = _columns(row, theta)
    count = len(row.specs)
    gram, moment = np.zeros((count, count)), np.zeros(count)
    for k in range(len(row.pieces)):
        y, valid = row.measured(k)
        use = whitened_valid(ar.size, valid) if y.size > ar.size + 1 else np.zeros(0, bool)
        if not use.any():
            continue
        basis = orthonormal(whiten(ar, row.nuisance(theta, k))[use])
        x = whiten(ar, columns[k])[use]
        x = x - basis @ (basis.T @ x)
        gram += x.T @ x
        moment += x.T @ whiten(ar, y)[use]
    gains = np.linalg.lstsq(gram, moment, rcond=1e-10)[0]
    theta = theta.copy()
    for m, (spec, part) in enumerate(zip(row.specs, row.slices, strict=True)):
        p = _unit(row, theta, m)
        p[: spec.structure.delayed] *= gains[m] if gains[m] != 0 else 1e-6
        theta[part] = p
    return theta
