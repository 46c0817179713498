"""Discrete noise models v = C(q)/D(q) e, for the prefilter of RIVC and for the covariance of every estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.noise import fit_ar, lagged, whitened_valid


@dataclass(frozen=True, eq=False)
class ArmaNoise:
    """v[k] + d1 v[k-1] + ... = e[k] + c1 e[k-1] + ..., e white."""

    d: Array = field(default_factory=lambda: np.zeros(0))
    c: Array = field(default_factory=lambda: np.zeros(0))

    def whiten(self, x: Array) -> Array:
        """D/C x along the first axis, from rest."""
        if not (self.d.size or self.c.size):
            return x
        out: Array = lfilter(np.r_[1.0, self.d], np.r_[1.0, self.c], x, axis=0)
        return out

    def usable(self, valid: BoolArray) -> BoolArray:
        """Where the prediction error no longer depends on samples that were not measured."""
        if not (self.d.size or self.c.size):
            return valid
        since = np.arange(valid.size) - np.maximum.accumulate(np.where(valid, -1, np.arange(valid.size)))
        return np.asarray(valid & (since > self.memory), dtype=bool)

    @property
    def memory(self) -> int:
        """Samples that the inverse filter needs to forget its start."""
        slowest = float(np.abs(np.roots(np.r_[1.0, self.c])).max()) if self.c.size else 0.0
        tail = np.ceil(np.log(levels.FORGOTTEN) / np.log(slowest)) if slowest > 0 else 0.0
        return self.d.size + int(min(tail, 200))

    def __str__(self) -> str:
        if self.c.size:
            return f"ARMA({self.d.size}, {self.c.size})"
        return f"AR({self.d.size})" if self.d.size else "white"


def fit_arma(signals: Sequence[Array], valid: Sequence[BoolArray], p: int, q: int, rounds: int = 8) -> ArmaNoise:
    """ARMA(p, q) by the method of Hannan and Rissanen (1982), then Gauss-Newton on the prediction errors.

    signals (N,) each with where it was measured (elsewhere 0). Zeros of C are kept inside the unit circle.
    """
    if q == 0:
        return ArmaNoise(fit_ar(signals, valid, p)[0])
    long = min(levels.LONGEST_AR, max(20, 3 * (p + q)), min(s.size for s in signals) // 5)
    ar = fit_ar(signals, valid, long)[0]
    errors = [lfilter(np.r_[1.0, ar], [1.0], v) for v in signals]
    gram, moment = np.zeros((p + q, p + q)), np.zeros(p + q)
    most = max(p, q)
    for v, e, ok in zip(signals, errors, valid, strict=True):
        columns = np.hstack([-lagged(v, most)[:, :p], lagged(e, most)[:, :q]])
        use = ArmaNoise(ar).usable(ok)[most:]
        gram += columns[use].T @ columns[use]
        moment += columns[use].T @ v[most:][use]
    x = np.asarray(np.linalg.lstsq(gram, moment, rcond=1e-10)[0], dtype=float)
    noise = ArmaNoise(x[:p], _inside(x[p:]))
    best = _power(noise, signals, valid)
    for _ in range(rounds):
        gram, moment = np.zeros((p + q, p + q)), np.zeros(p + q)
        inverse_c = np.r_[1.0, noise.c]
        for v, ok in zip(signals, valid, strict=True):
            e = noise.whiten(v)
            of_d, of_c = lfilter([1.0], inverse_c, v), lfilter([1.0], inverse_c, e)
            columns = np.hstack([lagged(of_d, most)[:, :p], -lagged(of_c, most)[:, :q]])
            use = noise.usable(ok)[most:]
            gram += columns[use].T @ columns[use]
            moment += columns[use].T @ e[most:][use]
        step = -np.linalg.lstsq(gram, moment, rcond=1e-12)[0]
        for damping in (1.0, 0.5, 0.1):
            trial = ArmaNoise(noise.d + damping * step[:p], _inside(noise.c + damping * step[p:]))
            power = _power(trial, signals, valid)
            if power < best:
                break
        else:
            break
        settled = power > best * (1 - 1e-9)
        noise, best = trial, power
        if settled:
            break
    return noise


def choose_arma(signals: Sequence[Array], valid: Sequence[BoolArray]) -> ArmaNoise:
    """The listed order with the least Bayesian criterion."""
    count = sum(int(ok.sum()) for ok in valid)
    best, chosen = np.inf, ArmaNoise()
    for p, q in levels.ARMA_ORDERS:
        if count < 20 * (p + q + 1):
            continue
        noise = fit_arma(signals, valid, p, q)
        criterion = np.log(max(_power(noise, signals, valid), 1e-300)) + np.log(count) * (p + q) / count
        if criterion < best:
            best, chosen = criterion, noise
    return chosen


def colour(errors: Sequence[Array], valid: Sequence[BoolArray]) -> int:
    """Autoregressive order of errors by the Bayesian criterion; 0 where they are white."""
    longest = max(0, min(levels.LONGEST_AR, min(e.size for e in errors) // 10))
    best, order = np.inf, 0
    for p in (*range(min(longest, 6) + 1), *range(8, longest + 1, 4)):
        _, variance, _ = fit_ar(errors, valid, p)
        count = sum(int(whitened_valid(p, ok).sum()) for ok in valid)
        if count < levels.FEWEST_PER_ORDER * (p + 2) or variance <= 0:
            break
        criterion = np.log(variance) + np.log(count) * p / count
        if criterion < best:
            best, order = criterion, p
        elif p > order + 8:
            break
    return order


def coloured_moment(
    instruments: Sequence[Array], errors: Sequence[Array], valid: Sequence[BoolArray]
) -> tuple[Array, int]:
    """Z' R Z for instruments Z (N, n) and errors (N,) of covariance R, and the order of the AR model behind R.

    R is that of an autoregressive model of the errors, its order by the Bayesian criterion; order 0 is white noise.
    """
    order = colour(errors, valid)
    ar, variance, _ = fit_ar(errors, valid, order)
    total = np.zeros((instruments[0].shape[1],) * 2)
    for z, ok in zip(instruments, valid, strict=True):
        x = np.where(ok[:, None], z, 0.0)
        if order == 0:
            total += variance * x.T @ x
            continue
        size = 1 << int(2 * len(x) - 1).bit_length()
        spectrum = variance / np.abs(np.fft.rfft(np.r_[1.0, ar], size)) ** 2
        transformed = np.fft.rfft(x, size, axis=0)
        weight = np.full(spectrum.size, 2.0)
        weight[[0, -1]] = 1.0
        total += np.real(transformed.conj().T @ ((weight * spectrum)[:, None] * transformed)) / size
    return total, order


def without_noise_directions(
    noise: ArmaNoise,
    instruments: Sequence[Array],
    raw: Sequence[Array],
    errors: Sequence[Array],
    usable: Sequence[BoolArray],
) -> list[Array]:
    """Whitened instruments (N, n) without what the coefficients of the noise model could make of them.

    In closed loop the inputs carry the noise, so that plant and noise model are estimated with correlated errors.
    """
    most = max(noise.d.size, noise.c.size)
    if most == 0:
        return list(instruments)
    columns = []
    for v, e, ok in zip(raw, errors, usable, strict=True):
        slopes = np.zeros((v.size, noise.d.size + noise.c.size))
        of_d, of_c = (lfilter([1.0], np.r_[1.0, noise.c], x) for x in (v, e))
        slopes[most:] = np.hstack([lagged(of_d, most)[:, : noise.d.size], lagged(of_c, most)[:, : noise.c.size]])
        columns.append(np.where(ok[:, None], slopes, 0.0))
    stacked = np.vstack(columns)
    left, values, _ = np.linalg.svd(stacked / np.maximum(np.linalg.norm(stacked, axis=0), 1e-300), full_matrices=False)
    basis = left[:, values > 1e-7 * values[0]]
    z = np.vstack(instruments)
    return np.split(z - basis @ (basis.T @ z), np.cumsum([v.size for v in raw])[:-1])


def _power(noise: ArmaNoise, signals: Sequence[Array], valid: Sequence[BoolArray]) -> float:
    power, count = 0.0, 0
    for v, ok in zip(signals, valid, strict=True):
        e = noise.whiten(v)[noise.usable(ok)]
        power, count = power + float(e @ e), count + e.size
    return power / count if count and np.isfinite(power) else np.inf


def _inside(c: Array) -> Array:
    """C with its zeros inside the unit circle."""
    roots = np.roots(np.r_[1.0, c]).astype(complex)
    large = np.abs(roots) > 1
    roots[large] = 1 / np.conj(roots[large])
    roots *= np.minimum(1.0, 0.99 / np.maximum(np.abs(roots), 1e-12))
    inside = np.zeros(c.size)
    coefficients = np.real(np.poly(roots))[1:]
    inside[: coefficients.size] = coefficients
    return inside
