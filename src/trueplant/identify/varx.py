"""The plant as a black box: a long vector ARX model, consistent in closed loop, with the covariance of its response.

    y[k] = sum_i A_i y[k-i] + sum_i B_i u[k-i] + c + e[k],  i = 1 .. lags

Long enough for plant and noise together, it needs no knowledge of either, nor of the controller. It serves as the
second opinion and as a test of parametric models: does the fitted plant lie where the data say?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import Refused, UsageError
from trueplant.identify import levels
from trueplant.lti.transfer import TransferFunction, TransferMatrix
from trueplant.mismatch.sampling import sampled_frequency_response
from trueplant.record.types import Segment


@dataclass(frozen=True, eq=False)
class Varx:
    """A vector ARX model of all outputs, and how well the data determine it."""

    A: Array
    """(lags, n_y, n_y)."""
    B: Array
    """(lags, n_y, n_u)."""
    noise: Array
    """(n_y, n_y) covariance of the prediction errors."""
    inverse_gram: Array
    """(n, n), n = lags (n_y + n_u): the covariance of the coefficients of output i is noise[i, i] times this; the
    order is y[k-1], u[k-1], y[k-2], u[k-2], ..."""
    h: float
    count: int

    @property
    def lags(self) -> int:
        return len(self.A)

    def response(self, w: Array) -> tuple[ComplexArray, Array]:
        """Response between samples (n_w, n_y, n_u) at w rad per time unit, and its standard error sqrt(E|dG|^2)."""
        value, left, directions = self._linearised(w)
        spread = np.real(np.einsum("waj,jk,wak->wa", left, self.noise, left.conj()))
        power = np.real(np.sum((self.inverse_gram @ directions) * directions.conj(), axis=1))
        return value, np.sqrt(np.maximum(spread[:, :, None] * power[:, None, :], 0.0))

    def test(self, plant: TransferMatrix, hold: tuple[str, ...], w: Array | None = None) -> tuple[Array, Array]:
        """Does the plant lie where the data say? chi-square over its real and imaginary parts at w, for each element.

        Returns the p-values (n_y, n_u), small where the element does not fit, and the number of directions (n_y, n_u)
        that the data resolve; without w at `tested`. A plant estimated from the same data fits a little better than
        chance.

        Raises Refused where the lags are too short for a plant this slow: the test would find its own bias.
        """
        needed = max((_settling(element) for row in plant.elements for element in row), default=0.0)
        if self.lags * self.h < needed:
            raise Refused(
                f"the black box remembers {self.lags * self.h:.4g}, and a plant this slow needs {needed:.4g} at least: "
                "use records sampled less often, or longer ones"
            )
        w = self.tested if w is None else w
        return self.distance(sampled_frequency_response(plant, w, self.h, hold), w)

    @property
    def tested(self) -> Array:
        """VARX_TESTED frequencies, from half a period in the lags to a quarter of the sampling rate."""
        return np.geomspace(np.pi / (self.lags * self.h), np.pi / self.h / 2, levels.VARX_TESTED)

    def distance(self, response: ComplexArray, w: Array) -> tuple[Array, Array]:
        """The test for any response between samples (n_w, n_y, n_u) at w."""
        value, left, directions = self._linearised(w)
        apart = value - response
        n_y, n_u = value.shape[1:]
        p, dof = np.ones((n_y, n_u)), np.zeros((n_y, n_u))
        root = np.linalg.cholesky(self.noise + 1e-14 * np.trace(self.noise) * np.eye(n_y))
        for i in range(n_y):
            weight = left[:, i] @ root  # (n_w, n_y): independent unit errors of the outputs
            for j in range(n_u):
                rows = (weight[:, :, None] * directions[:, None, :, j]).reshape(w.size, n_y, -1)
                real = np.concatenate([rows.real, rows.imag]).transpose(1, 0, 2)
                covariance = np.sum(real @ self.inverse_gram @ real.transpose(0, 2, 1), axis=0)
                gap = np.concatenate([apart[:, i, j].real, apart[:, i, j].imag])
                scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
                values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
                kept = values > levels.VARX_RESOLVED * values[-1]
                distance = np.sum((vectors[:, kept].T @ (gap / scale)) ** 2 / values[kept])
                dof[i, j] = kept.sum()
                p[i, j] = chi2.sf(distance, dof[i, j])
        return p, dof

    def _linearised(self, w: Array) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """G (n_w, n_y, n_u), (I - A)^-1 (n_w, n_y, n_y), and what a coefficient does to a column of G before that.

        dG[:, j] = (I - A)^-1 sum_n dTheta[:, n] directions[:, n, j].
        """
        n_y, n_u = self.B.shape[1:]
        delays = np.exp(-1j * np.outer(w, np.arange(1, self.lags + 1)) * self.h)
        eye = np.eye(n_y)
        left = np.asarray(np.linalg.inv(eye - np.tensordot(delays, self.A, axes=1)), dtype=np.complex128)
        value = np.asarray(left @ np.tensordot(delays, self.B, axes=1), dtype=np.complex128)
        inputs = np.broadcast_to(np.eye(n_u, dtype=complex), (len(w), n_u, n_u))
        block = np.concatenate([value, inputs], axis=1)
        directions = np.asarray((delays[:, :, None, None] * block[:, None]).reshape(len(w), -1, n_u), np.complex128)
        return value, left, directions


def varx(segments: Sequence[Segment], lags: int | None = None) -> Varx:
    """Least squares over all segments, each with an operating point of its own; missing PV samples are left out.

    Where `lags` are not given they are as many as the record affords, up to 64: a model that is too short is biased,
    one that is too long only less sure. (Criteria such as Akaike's look at the prediction, which forgives a
    bias beyond the standard errors of the response.) They should span some three times the longest time constant.
    PV must answer OP after one sample at least, as it does in a loop in which PV is read before OP is written.

    Raises Refused where the records are too short or an input does not move, UsageError for different sample times.
    """
    data = [arrays_of(segment) for segment in segments]
    if not data:
        raise Refused("there is no usable segment: see what screening left out, and why")
    h = segments[0].h
    if any(abs(s.h - h) > 1e-9 * h for s in segments):
        raise UsageError("segments of different sample times cannot be combined: resample them to one")
    moved = np.sqrt(np.mean(np.vstack([np.diff(u, axis=0) for _, u in data]) ** 2, axis=0))
    if np.any(moved == 0):
        raise Refused(f"input {int(np.argmin(moved)) + 1} does not move in these records: nothing can be said of it")
    if lags is None:
        lags = max((p for p in levels.VARX_LAGS if _enough(data, p)), default=0)
    rows = regression(data, lags, lags) if lags > 0 else None
    if rows is None or len(rows.y) < 2 * rows.past.shape[1]:
        raise Refused("the records are too short for a vector ARX model: more samples without gaps are needed")
    return _solved(rows, lags, h)


@dataclass(frozen=True, eq=False)
class Regression:
    """Rows k of all segments whose past and present were measured, each segment's mean taken out."""

    past: Array
    """(N, lags (n_y + n_u)): y[k-1], u[k-1], y[k-2], u[k-2], ..."""
    y: Array
    """(N, n_y)."""
    u: Array
    """(N, n_u) at k itself."""
    segments: int
    follows: NDArray[np.bool_]
    """(N - 1,) True where the next row is the next sample."""


def regression(data: Sequence[tuple[Array, Array]], lags: int, first: int) -> Regression | None:
    """The rows from sample `first` of each segment on; None where there are none."""
    rows: list[Array] = []
    targets: list[Array] = []
    inputs: list[Array] = []
    at: list[NDArray[np.int64]] = []
    for number, (y, u) in enumerate(data):
        n = len(y)
        if n <= first:
            continue
        joined = np.hstack([y, u])
        past = np.hstack([joined[first - i : n - i] for i in range(1, lags + 1)])
        whole = np.isfinite(past).all(axis=1) & np.isfinite(y[first:]).all(axis=1)
        if whole.sum() < 2:
            continue
        for out, values in ((rows, past), (targets, y[first:]), (inputs, u[first:])):
            out.append(values[whole] - values[whole].mean(axis=0))
        at.append(np.column_stack([np.full(int(whole.sum()), number), np.flatnonzero(whole)]))
    if not rows:
        return None
    moved = np.diff(np.vstack(at), axis=0)
    follows = (moved[:, 0] == 0) & (moved[:, 1] == 1)
    return Regression(np.vstack(rows), np.vstack(targets), np.vstack(inputs), len(rows), follows)


def _enough(data: Sequence[tuple[Array, Array]], lags: int) -> bool:
    """Are there SAMPLES_PER_COEFFICIENT rows for each coefficient of an output?"""
    samples = sum(max(len(y) - lags, 0) for y, _ in data)
    return bool(samples >= levels.SAMPLES_PER_COEFFICIENT * lags * (data[0][0].shape[1] + data[0][1].shape[1]))


def _settling(element: TransferFunction) -> float:
    poles = element.poles
    decaying = poles[poles.real < 0]
    slowest = float(np.max(-1 / decaying.real)) if decaying.size else 0.0
    return levels.VARX_SPAN * slowest + max((term.dead_time for term in element.terms), default=0.0)


def arrays_of(segment: Segment) -> tuple[Array, Array]:
    """y and u as deviations."""
    return segment.y - np.nanmean(segment.y, axis=0), segment.u - segment.u[0]


def _solved(rows: Regression, lags: int, h: float) -> Varx:
    phi, target, n_y = rows.past, rows.y, rows.y.shape[1]
    scale = np.linalg.norm(phi, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    basis, triangle = np.linalg.qr(phi / scale)
    left, values, right = np.linalg.svd(triangle)
    kept = values > 1e-10 * values[0]
    back = right[kept].T / values[kept]
    weights = back @ (left[:, kept].T @ (basis.T @ target)) / scale[:, None]
    errors = target - phi @ weights
    free = max(len(target) - int(kept.sum()) - rows.segments, 1)
    blocks = weights.reshape(lags, -1, n_y).transpose(0, 2, 1)
    noise = errors.T @ errors / free
    gram = back @ back.T / np.outer(scale, scale)
    return Varx(blocks[:, :, :n_y].copy(), blocks[:, :, n_y:].copy(), noise, gram, h, len(target))
