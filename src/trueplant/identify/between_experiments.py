"""Several experiments of one plant: how far they differ, and what that leaves of their common estimate.

Each experiment is fitted alone. The plant of each is taken to differ from their mean by a relative spread, one for
all gains, one for all lags and leads and one for all dead times, normal. Before the experiments are looked at, the
spreads are half-normal with a standard deviation of BETWEEN_RUNS; what the experiments say of them is their marginal
likelihood. Mean and covariance are averaged over the spreads, without a test of whether the experiments agree.
With one parameter this is the random-effects model of meta-analysis (Roever 2020).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array, IntArray
from trueplant.identify import levels
from trueplant.identify.covariance import scaled
from trueplant.identify.estimate import noise_signals
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.noise import fit_ar
from trueplant.identify.search import grid_guess
from trueplant.identify.validate import residual_tests


@dataclass(frozen=True, eq=False)
class Runs:
    """The estimates of single experiments, and their spread."""

    experiments: tuple[int, ...]
    fits: tuple[RowFit, ...]
    covariance: Array
    """(n_runs, n, n)."""
    p_value: float
    """That the runs agree (Cochran's Q)."""
    spread: Array
    """(3,) relative standard deviation between runs of gains, of lags and leads, and of dead times."""
    shift: Array
    """(n,) from the pooled estimate to the mean of the runs."""
    added: Array
    """(n, n) what the spread adds to the covariance of the mean."""

    @property
    def theta(self) -> Array:
        """(n_runs, n)"""
        return np.array([fit.theta for fit in self.fits])

    @cached_property
    def cross_p(self) -> Array:
        """(n_columns,) that the prediction errors of the single runs are unrelated to the past of each input.

        What a structure lacks is in these too; those about the mean also follow inputs because runs differ.
        """
        return np.asarray(len(self.fits) * np.min([residual_tests(fit).cross_p for fit in self.fits], axis=0))

    @property
    def agree(self) -> bool:
        return self.p_value > levels.RUNS_DISAGREE


def single_runs(pooled: RowFit) -> list[tuple[int, RowFit]]:
    """The fit of each experiment alone: from the pooled one, or from what a search over its own dead times finds."""
    experiments = sorted({piece.experiment for piece in pooled.row.pieces})
    fits = []
    for experiment in experiments:
        pieces = tuple(piece for piece in pooled.row.pieces if piece.experiment == experiment)
        row = replace(pooled.row, pieces=pieces)
        samples = sum(int(row.measured(k)[1].sum()) for k in range(len(pieces)))
        if samples > levels.SAMPLES_PER_PARAMETER * (pooled.theta.size + pooled.ar.size):
            own = np.where(pooled.free, grid_guess(row, pooled.theta, pooled.ar, rounds=1), pooled.theta)
            begun = (pooled.theta, np.clip(own, *row.bounds()))
            found = [fit_row(row, theta, pooled.ar, free=pooled.free, iterations=40) for theta in begun]
            fits.append((experiment, min(found, key=lambda fit: fit.cost)))
    return fits


def compare_runs(pooled: RowFit, factor: Array) -> Runs | None:
    """How far single experiments differ; None with fewer than two that can be fitted.

    `factor` (n,) is that of the variances (`inflation`).
    """
    if len({piece.experiment for piece in pooled.row.pieces}) < 2:
        return None
    fits = single_runs(pooled)
    if len(fits) < 2:
        return None
    theta = np.array([fit.theta for _, fit in fits])
    covariance = scaled(np.array([fit.covariance for _, fit in fits]), factor)
    free = np.flatnonzero(pooled.free)
    sizes = sizes_of(pooled)[free]
    mixed = _mixture(theta[:, free], covariance[:, free][:, :, free], pooled.theta[free], sizes, kinds_of(pooled)[free])
    shift, added = np.zeros(theta.shape[1]), np.zeros((theta.shape[1],) * 2)
    shift[free], added[np.ix_(free, free)] = mixed.shift, mixed.added
    experiments = tuple(experiment for experiment, _ in fits)
    single = tuple(fit for _, fit in fits)
    return Runs(experiments, single, covariance, mixed.p_value, mixed.spread, shift, added)


def sizes_of(pooled: RowFit) -> Array:
    """(n,) what a relative spread of each parameter is relative to: itself, with the lag for dead times and leads."""
    parts = enumerate(zip(pooled.row.specs, pooled.row.slices, strict=True))
    sizes = np.concatenate(
        [spec.structure.sizes(pooled.theta[part], pooled.row.lag(m, pooled.theta[part])) for m, (spec, part) in parts]
    )
    return np.where(sizes > 0, sizes, 1.0)


def kinds_of(pooled: RowFit) -> IntArray:
    """(n,) which of the spreads each parameter has."""
    return np.where(pooled.row.is_gain, 0, np.where(pooled.row.is_dead_time, 2, 1))


@dataclass(frozen=True, eq=False)
class _Mixture:
    """What the runs say together, averaged over the spreads between them."""

    p_value: float
    spread: Array
    shift: Array
    added: Array


def _mixture(theta: Array, covariance: Array, pooled: Array, sizes: Array, kinds: IntArray) -> _Mixture:
    """Of runs theta (n_runs, n) with covariance (n_runs, n, n), and the spread (`kinds_of`) of each parameter.

    Where runs do not differ, `pooled` (n,) is their mean, free of the errors of short runs; the more they differ, the
    less it says. In between it counts by its share of the information on the mean.
    """
    grid = np.stack(np.meshgrid(*[levels.RUN_SPREADS] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    between = (grid[:, kinds] * sizes) ** 2
    scale = np.outer(sizes, sizes)
    # (n_grid, n_runs, n, n) in units of the sizes
    each = (covariance / scale)[None] + ((between / sizes**2)[:, None, :, None] * np.eye(sizes.size))
    precision = np.linalg.inv(each)
    total = precision.sum(axis=1)
    means = np.linalg.inv(total)
    values = theta / sizes
    moment = np.einsum("grij,rj->gi", precision, values)
    centre = np.einsum("gij,gj->gi", means, moment)
    misfit = np.einsum("ri,grij,rj->g", values, precision, values) - np.sum(moment * centre, axis=1)
    centre = centre + np.einsum("ij,gjk,k->gi", means[0], total, pooled / sizes - centre[0])
    log = np.linalg.slogdet(precision)[1].sum(axis=1) - np.linalg.slogdet(total)[1] - misfit
    log = log / 2 - np.sum((grid / levels.BETWEEN_RUNS) ** 2, axis=1) / 2
    steps = np.gradient(levels.RUN_SPREADS)
    weights = np.exp(log - log.max()) * np.einsum("i,j,k->ijk", steps, steps, steps).ravel()
    weights /= weights.sum()
    mean = weights @ centre
    around = centre - mean
    whole = np.einsum("g,gij->ij", weights, means) + (around.T * weights) @ around
    freedom = (len(theta) - 1) * sizes.size
    p_value = float(chi2.sf(max(float(misfit[0]), 0.0), freedom))
    return _Mixture(p_value, weights @ grid, mean * sizes - pooled, (whole - means[0]) * scale)


def refit_noise(fit: RowFit, order: int) -> RowFit:
    """The same row with a noise model of another order, started from the present estimate."""
    signals, valid = noise_signals(fit)
    ar = fit_ar(signals, valid, order)[0]
    return fit_row(fit.row, fit.theta, ar, weights=fit.weights, free=fit.free, iterations=40)
