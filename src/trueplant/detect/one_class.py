"""A one-class detector over moving windows, for data without set-point changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import f as fisher

from trueplant.arrays import Array
from trueplant.detect import levels
from trueplant.detect.signals import Detection, NotApplicable, centred, flagged
from trueplant.lti import TransferMatrix
from trueplant.record import Segment


def one_class(segments: Sequence[Segment], model: TransferMatrix, level: float = 0.05) -> Detection:
    """After Lu, Forbes, Loewen, Backstrom, Dumont and Gopaluni (2020), Comput. Chem. Eng. 133, 106660.

    The data are cut into windows, a model is fitted in each, and windows of later data are judged by the cluster that
    the first ones form. With several segments the first is taken for what the loop was, with one its first half.
    The reference trains a one-class support vector machine on the windows' impulse responses; here the class is a
    Gaussian: the means of the early and the late windows are compared by Hotelling's T-squared, of three points on the
    step response of each element from a least-squares ARX model of each output. The noise model of the windows is
    compared likewise and given in the note, which distinguishes a changed disturbance from a changed plant.

    This compares early with late data, not data with the model, and ARX models of short windows in closed loop
    without set-point changes are biased: as long as controller and disturbance stay, the bias is the same in all.

    Raises NotApplicable where there are too few samples for the windows, or no element has a lag.
    """
    closed = [s for s in segments if np.isfinite(s.y).all()]
    if not closed:
        raise NotApplicable("every stretch of data has missing PVs")
    lags = _lags(model)
    if not lags.any():
        raise NotApplicable("no element of the model has a lag to choose the windows by")
    stride = max(1, int(lags[lags > 0].min() / levels.SAMPLES_PER_LAG / closed[0].h))
    signals = [(centred(s.y[::stride]), centred(s.u[::stride])) for s in closed]
    if len(signals) == 1:
        y, u = signals[0]
        half = len(y) // 2
        early, late = [(y[:half], u[:half])], [(y[half:], u[half:])]
    else:
        early, late = signals[:1], signals[1:]
    n_y, n_u = model.shape[0], closed[0].u.shape[1]
    size = len(early[0][0]) // levels.WINDOWS
    least = 6 * levels.WINDOW_ORDER * (1 + n_u)
    if size < least:
        raise NotApplicable(
            f"{levels.WINDOWS} windows of at least {least} samples are needed where the model is known to fit"
        )
    h = closed[0].h * stride
    dead = _dead_times(model, h)
    pairs = [_features(part, size, h, lags, dead) for part in (early, late)]
    (before, noise_before), (after, noise_after) = pairs
    if len(after) < 2:
        raise NotApplicable("the data to be judged are shorter than two windows")
    statistic, threshold = np.zeros((n_y, n_u)), np.zeros((n_y, n_u))
    noise = []
    for i in range(n_y):
        for j in range(n_u):
            if model[i, j].is_zero:
                statistic[i, j] = threshold[i, j] = np.nan
                continue
            statistic[i, j], threshold[i, j] = _hotelling(before[:, i, j], after[:, i, j], level / (n_y * n_u))
        value, limit = _hotelling(noise_before[:, i], noise_after[:, i], level / n_y)
        noise += [str(i + 1)] if value > limit else []
    note = f"the disturbance on output {', '.join(noise)} has changed too" if noise else ""
    return flagged("one-class", statistic, threshold, note)


def _lags(model: TransferMatrix) -> Array:
    """(n_y, n_u) slowest lag of each element, 0 where there is none."""
    return np.array(
        [
            [max((1 / abs(p.real) for p in cell.poles if p.real < 0), default=0.0) for cell in row]
            for row in model.elements
        ]
    )


def _dead_times(model: TransferMatrix, h: float) -> NDArray[np.intp]:
    """(n_y, n_u) whole samples."""
    return np.array(
        [[int(min((t.dead_time for t in cell.terms), default=0.0) / h) for cell in row] for row in model.elements],
        dtype=np.intp,
    )


def _features(
    parts: Sequence[tuple[Array, Array]], size: int, h: float, lags: Array, dead: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Of each window: points of the step responses (m, n_y, n_u, 3), and noise models (m, n_y, 1 + WINDOW_ORDER)."""
    steps, noise = [], []
    for y, u in parts:
        for start in range(0, len(y) - size + 1, size):
            fits = [_window(y[start : start + size], u[start : start + size], i, dead[i]) for i in range(y.shape[1])]
            steps.append([_step_points(a, b, h, lags[i]) for i, (a, b, _) in enumerate(fits)])
            noise.append([np.concatenate([[np.log(max(s, 1e-300))], a]) for a, _, s in fits])
    return np.array(steps), np.array(noise)


def _window(y: Array, u: Array, i: int, dead: NDArray[np.intp]) -> tuple[Array, Array, float]:
    """Least-squares ARX model of output i: a (WINDOW_ORDER,), b (n_u, WINDOW_ORDER), residual variance."""
    n_u = u.shape[1]
    first = levels.WINDOW_ORDER + int(dead[:n_u].max())
    rows = np.arange(first, len(y))
    back = np.arange(1, levels.WINDOW_ORDER + 1)
    columns = [y[rows[:, None] - back, i]] + [u[rows[:, None] - back - dead[j], j] for j in range(n_u)]
    x = np.column_stack([*columns, np.ones(rows.size)])
    theta = np.linalg.lstsq(x, y[rows, i], rcond=None)[0]
    residual = y[rows, i] - x @ theta
    b = theta[levels.WINDOW_ORDER : levels.WINDOW_ORDER * (1 + n_u)].reshape(n_u, levels.WINDOW_ORDER)
    return theta[: levels.WINDOW_ORDER], b, float(residual @ residual / max(rows.size - x.shape[1], 1))


def _step_points(a: Array, b: Array, h: float, lags: Array) -> list[Array]:
    """For each input the step response of the window's model, without its dead time, at HORIZONS lags."""
    points = []
    for j, own in enumerate(b):
        at = np.maximum(np.round(levels.HORIZONS * max(lags[j], h) / h).astype(int), 1)
        response = lfilter(np.concatenate([[0.0], own]), np.concatenate([[1.0], -a]), np.ones(at[-1] + 1))
        points.append(np.clip(response[at], -1e6, 1e6))
    return points


def _hotelling(before: Array, after: Array, level: float) -> tuple[float, float]:
    """T-squared for the difference of two means (m, p) and (n, p), scaled to F, and its limit."""
    m, n, p = len(before), len(after), before.shape[1]
    shift = after.mean(axis=0) - before.mean(axis=0)
    scatter = (np.cov(before.T) * (m - 1) + np.cov(after.T) * (n - 1)) / (m + n - 2)
    scale = np.sqrt(np.maximum(np.diag(scatter), 1e-300))
    normal = scatter / np.outer(scale, scale) + 1e-9 * np.eye(p)
    t2 = m * n / (m + n) * float(shift / scale @ np.linalg.solve(normal, shift / scale))
    free = m + n - p - 1
    return t2 * free / (p * (m + n - 2)), float(fisher.isf(level, p, free))
