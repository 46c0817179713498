"""From the response of one element at many frequencies to the parameters of its declared structure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import Refused
from trueplant.lti.structure import Structure
from trueplant.mismatch import levels
from trueplant.mismatch.sampling import hold_response, rows_frequency_response


class StructureFit(NamedTuple):
    """What `fit_structure` finds, and how well the response agrees with it."""

    parameters: Array
    covariance: Array
    distance: float
    """Chi-square of the response about the structure, by the weights given."""
    freedom: int


def fit_structure(
    w: Array,
    value: ComplexArray,
    std: Array,
    structure: Structure,
    h: float | None = None,
    hold: str = "zoh",
    covariance: ComplexArray | None = None,
    initial: Array | None = None,
) -> StructureFit:
    """Parameters of a structure and their covariance, by weighted least squares on one element's response.

    value (n_w,) at w (n_w,), with circular standard errors std (n_w,), is the response between samples h apart under
    `hold`, and is fitted by the sampled response of the structure; without h it is the continuous response.
    covariance (n_windows, points, points) replaces std where neighbours are correlated (see FrequencyResponse).
    Points that are not finite are left out. The search starts from a grid of time scales and dead times, whose
    best minima are refined, and from `initial` where given.

    The covariance is that of the weights given, (J* W J)^-1, times chi-square over its degrees of freedom where that is
    above 1, and reaches to other minima as far as these are likely. Raises Refused with fewer points than parameters.
    """
    from scipy.optimize import least_squares

    low, high = structure.bounds()
    whiten, keep = _whitening(np.asarray(w, dtype=float), value, std, covariance)
    w, value = w[keep], value[keep]
    if 2 * w.size <= len(structure.names):
        raise Refused(
            f"{w.size} frequencies say something of this element: too few for the {len(structure.names)} parameters of "
            f"{structure}; use a longer record or larger set-point changes"
        )

    def residual(p: Array) -> Array:
        return _split(whiten(_response(structure, p, w, h, hold)[:, 0] - value))

    def jacobian(p: Array) -> Array:
        return _split(whiten(_response(structure, p, w, h, hold)[:, 1:]))

    guesses = _grid(structure, w, value, std[keep], h, hold)
    if initial is not None:
        guesses.append(np.clip(initial, low + 1e-9, high))
    minima = [
        least_squares(residual, p, jacobian, bounds=(low, high), x_scale="jac", max_nfev=100, xtol=1e-12, ftol=1e-12)
        for p in guesses
    ]
    minima.sort(key=lambda found: found.cost)
    at = [found.x[structure.sorted(found.x)] for found in minima]
    costs = np.array([found.cost for found in minima])
    # where the response lies farther from the structure than its errors say, these are too small
    distance, freedom = float(2 * costs[0]), 2 * w.size - len(structure.names)
    excess = max(1.0, distance / freedom)
    spread = excess * _over_minima(at, costs / excess, [_covariance(jacobian(p)) for p in at])
    return StructureFit(at[0], spread, distance, freedom)


def _covariance(J: Array) -> Array:
    """(J' J)^-1"""
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    inverse = np.linalg.pinv(J / scale, rcond=1e-10)
    value: Array = inverse @ inverse.T / np.outer(scale, scale)
    return value


def _over_minima(at: Sequence[Array], costs: Array, covariances: Sequence[Array]) -> Array:
    """Mean square distance from the deepest minimum, each weighted with its likelihood (half a chi-square is `costs`).

    Dead times have several minima, and one that is nearly as deep may be where the plant is.
    """
    apart = [0]
    for k in range(1, len(at)):
        step = [np.abs(at[k] - at[n]) for n in apart]
        if all(np.any(d > np.sqrt(np.diag(covariances[n]))) for d, n in zip(step, apart, strict=True)):
            apart.append(k)
    weights = np.array([np.exp(costs[0] - costs[k]) for k in apart])
    spread = [covariances[k] + np.outer(at[k] - at[0], at[k] - at[0]) for k in apart]
    value: Array = np.einsum("k,kij->ij", weights / weights.sum(), np.array(spread))
    return value


def _split(x: ComplexArray, axis: int = 0) -> Array:
    """Real parts, then imaginary parts."""
    return np.concatenate([x.real, x.imag], axis=axis)


def _whitening(w: Array, value: ComplexArray, std: Array, covariance: ComplexArray | None) -> tuple[Any, Any]:
    """A function that gives residuals (n, ...) unit variance in real and imaginary part, and the points it is for."""
    finite = np.abs(value[np.isfinite(value)])
    floor = 1e-9 * float(finite.max()) if finite.size else 0.0
    if covariance is None:
        keep = np.isfinite(value) & np.isfinite(std)
        weight = np.sqrt(2) / np.maximum(std[keep], floor)
        return (lambda x: (x.T * weight).T), keep
    n_p = covariance.shape[1]
    good = np.isfinite(value.reshape(-1, n_p)).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    size = np.sqrt(np.maximum(np.einsum("wpp->wp", covariance[good]).real, floor**2))
    normal = covariance[good] / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(n_p)
    root = np.linalg.inv(np.linalg.cholesky(normal)) / size[:, None, :] * np.sqrt(2)

    def whiten(x: ComplexArray) -> ComplexArray:
        whitened: ComplexArray = (root @ x.reshape(len(root), n_p, -1)).reshape(x.shape)
        return whitened

    return whiten, np.repeat(good, n_p)


def _response(structure: Structure, p: Array, w: Array, h: float | None, hold: str) -> ComplexArray:
    """(n_w, 1 + n_p): the structure's response and its derivative by every parameter."""
    out = np.zeros((w.size, 1 + len(p)), dtype=complex)
    for block in structure.gradient_blocks(p):
        columns = [0, *(1 + k for k in block.index)]
        if h is None:
            s = 1j * w
            rows = np.stack([np.polyval(row, s) for row in block.num], axis=1)
            rows = rows * (np.exp(-block.dead_time * s) / np.polyval(block.den, s))[:, None]
        else:
            rows = rows_frequency_response(block.num, block.den, block.dead_time, w, h, structure.own_hold(hold))
        for k, column in enumerate(columns):
            out[:, column] += rows[:, k]
    return out


def _grid(structure: Structure, w: Array, value: ComplexArray, std: Array, h: float | None, hold: str) -> list[Array]:
    """The best initial guesses on a grid of time scale and dead time, gains by least squares.

    The hold is taken as a factor here: good enough to begin with, and quick. That error and the grid's own are
    allowed for in the weights.
    """
    s = 1j * w
    held = np.ones(w.size) if h is None else hold_response(w, h, hold)
    clear = np.abs(value) > levels.CLEAR_RESPONSE * std
    largest = np.max(np.abs(value[clear] if clear.any() else value))
    weight = 1 / np.sqrt(std**2 + (0.02 * largest) ** 2)
    power = np.abs(value) * weight
    loud = w[power >= levels.LOUD * power.max()]
    goal = _split(value * weight)
    step = 0.7 / loud.max()
    count = int(np.clip(1 / (w.min() * step), *levels.DEAD_TIMES)) if structure.has_dead_time else 1
    dead_times = step * np.arange(count)
    # with one dead time the zeros are linear too, as coefficients of the numerator
    powers = structure.leads if structure.delayed == 1 else 0
    first = structure.delayed + structure.lags + 2 * structure.pairs
    delays = dead_times[:, None] + step * np.arange(structure.delayed)
    late = np.exp(-s[:, None] * delays[:, None, :])
    candidates: list[tuple[float, Array]] = []
    for scale in np.geomspace(0.3 / loud.max(), 5 / w.min(), levels.SCALES):
        p = _guess(structure, float(scale))
        num, den = structure.polynomials(p)
        shape = weight * held / np.polyval(den, s) * (1.0 if powers else np.polyval(num, s))
        columns = _split(shape[:, None] * late * (s * scale)[:, None] ** np.arange(powers + 1), axis=1)
        linear = np.einsum("dkn,n->dk", np.linalg.pinv(columns), goal)
        costs = np.sum((np.einsum("dnk,dk->dn", columns, linear) - goal) ** 2, axis=1)
        for k, cost in enumerate(costs):
            full = p.copy()
            full[: structure.delayed] = linear[k, : structure.delayed]
            if powers:
                roots = np.roots(linear[k, ::-1])
                flat = (np.abs(roots.imag) > 0) | (roots == 0)
                full[first : first + roots.size] = np.where(flat, 1.0, -1 / np.where(flat, 1.0, roots.real)) * scale
            if structure.has_dead_time:
                full[-structure.delayed :] = delays[k] + 1e-6 * step
            candidates.append((float(cost), full))
    candidates.sort(key=lambda pair: pair[0])
    chosen: list[Array] = []
    for _, p in candidates:
        if not chosen or all(structure.has_dead_time and abs(p[-1] - q[-1]) > 1.5 * step for q in chosen):
            chosen.append(p)
        if len(chosen) == levels.GUESSES:
            break
    return chosen


def _guess(structure: Structure, scale: float) -> Array:
    lags = scale * 0.5 ** np.arange(structure.lags)
    return structure.parameters(1.0, lags, 1 / scale, 0.7, scale / 3, 0.0)
