"""Initial guesses of the fit: the time scale and the dead time of each element on a grid, gains by least squares.

The cost of a dead time has several minima; the grid covers them all, one element at a time with the
gains of all others and the nuisance terms projected out, and several times over.
"""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.identify.row import Row


def initial_theta(row: Row, time_scale: float) -> Array:
    """The models' parameters; elements without one get the time scale, unit gain and no dead time."""
    parts = []
    for spec in row.specs:
        guess = spec.initial if spec.guess is None else spec.guess
        if guess is not None:
            parts.append(np.array(guess, dtype=float))
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
            theta = _improve_element(row, theta, ar, m)
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


def _improve_element(row: Row, theta: Array, ar: Array, m: int) -> Array:
    structure, part = row.specs[m].structure, row.slices[m]
    unit = _unit(row, theta, m)
    exponents = structure.time_scales
    dead = structure.is_dead_time
    h = row.pieces[0].h
    shifts = dead_time_grid(row, m, unit, h) if dead.any() else np.zeros(1, dtype=int)
    others = _columns(row, theta, skip=m)
    top = np.zeros((levels.STRETCH.size, shifts.size))
    gain = np.zeros_like(top)
    power = np.zeros_like(top)
    moment = np.zeros_like(top)
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
        target = target - basis @ (basis.T @ target)
        spec = row.specs[m]
        for a, stretch in enumerate(levels.STRETCH):
            p = unit * stretch**exponents
            p[dead] = unit[dead] - (unit[dead].min() if dead.any() else 0.0)
            full = structure.response(p, piece.inputs[spec.column], piece.h, piece.hold[spec.column])
            late = np.concatenate([np.zeros(shifts[-1]), full])
            shifted = np.array([late[shifts[-1] - shift :][: full.size : row.stride] for shift in shifts]).T
            x = whiten(ar, shifted)[use]
            # The target is orthogonal to the basis already, so that only the power of x has to be projected.
            moment[a] += x.T @ target
            power[a] += np.einsum("bn,bn->b", x.T, x.T) - np.sum((basis.T @ x) ** 2, axis=0)
    ok = power > 1e-12 * max(power.max(), 1e-300)
    top[ok] = moment[ok] ** 2 / power[ok]
    gain[ok] = moment[ok] / power[ok]
    a, b = divmod(int(np.argmax(top)), shifts.size)
    if top[a, b] <= 0:
        return theta
    p = unit * levels.STRETCH[a] ** exponents
    if dead.any():
        p[dead] = unit[dead] - unit[dead].min() + shifts[b] * h
    p[: structure.delayed] *= gain[a, b]
    theta = theta.copy()
    theta[part] = p
    return theta


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
