"""Since when: has a series of estimates changed, in a step or little by little, and what chance would make of it.

Each window of a long record gives the parameters of an element with their covariance. Generalised least squares
compares three histories: constant, one step at an unknown time, and a straight drift. The instant of a step is
searched for, so that its likelihood ratio is not chi-square (Andrews 1993): the significance comes from the same
search in series that are constant and scatter as the covariances say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.detect import levels


@dataclass(frozen=True, eq=False)
class Series:
    """Estimates of the same m parameters from K windows that share no sample, in order of time."""

    start: Array
    """(K,)"""
    end: Array
    theta: Array
    """(K, m)"""
    covariance: Array
    """(K, m, m)"""

    def __post_init__(self) -> None:
        if not (np.all(self.end > self.start) and np.all(self.start[1:] >= self.end[:-1] - 1e-9 * self.end[-1])):
            raise ValueError("windows must follow each other in time and not overlap")

    def __len__(self) -> int:
        return int(self.start.size)

    @property
    def middle(self) -> Array:
        return np.asarray((self.start + self.end) / 2)


@dataclass(frozen=True, eq=False)
class History:
    """What the series says: the likelihood ratios of step and drift against constant, and their significance."""

    p_value: float
    """That nothing has changed."""
    kind: str
    """ "step", "drift", or "undecided" between the two: which of them it is if it is a change at all."""
    time: float
    """Of the best step, as far as whole windows can tell."""
    step: float
    drift: float
    scatter: float
    """Factor on the standard errors that the scatter of the windows asked for; 1 if none."""


@dataclass(frozen=True, eq=False)
class Shift:
    """Parameters before and after an instant, estimated from different data."""

    before: Array
    after: Array
    covariance: Array
    """(m, m) of after - before."""

    @property
    def p_value(self) -> float:
        """Joint, that nothing differs."""
        difference = self.after - self.before
        return float(chi2.sf(difference @ np.linalg.solve(self.covariance, difference), difference.size))


def history(series: Series, draws: int = levels.DRAWS, seed: int = 0) -> History:
    """Constant, step or drift? Needs two windows at least; two cannot tell a step from a drift."""
    count, m = series.theta.shape
    if count < 2:
        raise ValueError("a change can only be seen between two windows at least")
    scatter = _scatter(series)
    roots = np.linalg.inv(np.linalg.cholesky(series.covariance)) / scatter
    z = np.einsum("kab,kb->ka", roots, series.theta).reshape(-1)
    constant = _orthonormal(_design(roots, np.ones((1, count))))[0]
    times = _instants(series)
    steps = _beyond(constant, _design(roots, _share_after(series, times)))
    middle = series.middle - series.middle.mean()
    drift = _beyond(constant, _design(roots, middle[None]))[0]
    gains = np.sum((steps @ z) ** 2, axis=1)
    best = int(np.argmax(gains))
    step_gain, drift_gain = float(gains[best]), float(np.sum((drift @ z) ** 2))
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((z.size, draws))
    null = np.max(np.sum((steps @ noise) ** 2, axis=1), axis=0)
    null = np.maximum(null, np.sum((drift @ noise) ** 2, axis=0))
    found = max(step_gain, drift_gain)
    # Far in the tail the draws end, and Bonferroni's bound over the instants takes over.
    p = min((1 + int(np.sum(null >= found))) / (1 + draws), (times.size + 1) * float(chi2.sf(found, m)))
    difference = step_gain - drift_gain - np.log(count * m)
    told = count > 2 and abs(difference) >= levels.CLEAR
    kind = "undecided" if not told else "step" if difference > 0 else "drift"
    if kind == "drift" and count < levels.DRIFT_SHOWS:
        kind = "undecided"
    return History(float(p), kind, float(times[best]), step_gain, drift_gain, scatter)


def slope(series: Series, scatter: float = 1.0) -> tuple[Array, Array, Array]:
    """A straight line through the windows: values (m,) at the first and last instant, covariance (m, m) of the rise."""
    m = series.theta.shape[1]
    share = (series.middle - series.start[0]) / (series.end[-1] - series.start[0])
    information, moment = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
    for x, theta, covariance in zip(share, series.theta, series.covariance, strict=True):
        weight = np.linalg.inv(covariance)
        information += np.kron(np.array([[1.0, x], [x, x * x]]), weight)
        moment += np.concatenate([weight @ theta, x * (weight @ theta)])
    inverse = np.linalg.inv(information)
    line = inverse @ moment
    return line[:m], line[:m] + line[m:], scatter**2 * inverse[m:, m:]


def _instants(series: Series) -> Array:
    """Where a step is looked for: between windows, and within those that have another on both sides."""
    inner = [
        series.start[k] + (series.end[k] - series.start[k]) * np.arange(1, levels.PARTS) / levels.PARTS
        for k in range(1, len(series) - 1)
    ]
    between = (series.end[:-1] + series.start[1:]) / 2
    return np.sort(np.concatenate([between, *inner]))


def _share_after(series: Series, times: Array) -> Array:
    """(n_times, K) share of each window that lies after each instant: what a step there moves its estimate by."""
    return np.clip((series.end - times[:, None]) / (series.end - series.start), 0.0, 1.0)


def _design(roots: Array, weights: Array) -> Array:
    """(n, K m, m) whitened columns of a change that enters the windows with weights (n, K)."""
    columns = weights[:, :, None, None] * roots
    return columns.reshape(weights.shape[0], -1, roots.shape[2])


def _orthonormal(columns: Array) -> Array:
    """(n, m, K m) orthonormal rows that span the columns (n, K m, m)."""
    return np.asarray(np.swapaxes(np.linalg.qr(columns)[0], 1, 2))


def _beyond(constant: Array, columns: Array) -> Array:
    """(n, m, K m) orthonormal rows of what the columns span beyond a constant."""
    return _orthonormal(columns - constant.T @ (constant @ columns))


def _scatter(series: Series) -> float:
    """Birge's factor (1932) from neighbouring windows, if they differ by more than their covariances say.

    The largest difference is left out: it may be the step itself. A slow drift hardly shows between neighbours.
    """
    count, m = series.theta.shape
    if count < levels.FEWEST_WINDOWS:
        return 1.0
    pairs = np.arange(0, count - 1, 2)
    difference = series.theta[pairs + 1] - series.theta[pairs]
    spread = series.covariance[pairs + 1] + series.covariance[pairs]
    size = np.sort(np.einsum("ka,ka->k", difference, np.linalg.solve(spread, difference[..., None])[..., 0]))[:-1]
    if chi2.sf(float(size.sum()), m * size.size) > levels.SCATTERED:
        return 1.0
    largest = float(chi2.ppf(1 - np.exp(-np.euler_gamma) / pairs.size, m))  # about the mean of what was left out
    return max(1.0, float(np.sqrt(size.sum() / (m * pairs.size - largest))))
