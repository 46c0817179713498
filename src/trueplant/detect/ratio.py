"""The plant-model ratio over frequency: gain, dynamics and dead time separately."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.detect.signals import Detection, NotApplicable, Signals, shifted
from trueplant.lti import TransferMatrix
from trueplant.record.spectra import window_spectra

KINDS = ("gain", "dynamics", "dead time")


def plant_model_ratio(signals: Signals, model: TransferMatrix, level: float = 0.05) -> Detection:
    """Selvanathan and Tangirala (2010), Ind. Eng. Chem. Res. 49, 4210: S_yr/S_(yhat r), here element by element.

    With one loop the ratio is theirs. With several, (S_yr S_ur^-1)_ij/Ghat_ij stands for it (the joint form of the
    plant over the model), which is the same thing for one loop. The gain is read from |ratio| at low frequency,
    the dynamics from |ratio| at high over that at low frequency, the dead time from the slope of its phase; each
    is averaged over the frequencies in which the set-points say something. The statistic is the largest of the
    three in standard deviations under circular shifts of the error; the threshold holds for the whole matrix.

    Raises NotApplicable with fewer moving set-points than inputs.
    """
    n_u = signals.u.shape[1]
    if signals.outer.shape[1] < n_u:
        raise NotApplicable(f"{signals.outer.shape[1]} moving set-points do not tell {n_u} inputs apart")
    errors = shifted(signals.e, signals.lags)
    n, draws, n_y = errors.shape
    w, response, noise = _error_responses(signals, errors.reshape(n, draws * n_y))
    ghat = model(1j * w)[:, :, :n_u]
    n_f = w.size
    response = response.reshape(n_f, draws, n_y, n_u)
    absent = np.abs(ghat).max(axis=0) == 0
    safe = np.where(absent, 1.0, ghat)
    ratio = 1 + response / safe[:, None]
    weight = np.abs(safe) ** 2 / noise[:, None, :]
    contrasts = _contrasts(w, ratio, weight)
    spread = contrasts[:, 1:].std(axis=1)
    scores = np.abs(contrasts - contrasts[:, 1:].mean(axis=1)[:, None]) / np.maximum(spread, 1e-300)[:, None]
    scores[:, :, absent] = 0.0
    largest = scores.max(axis=0)
    threshold = float(np.quantile(largest[1:].reshape(draws - 1, -1).max(axis=1), 1 - level))
    told = scores[:, 0] > threshold
    kinds = tuple(
        tuple(", ".join(k for k, yes in zip(KINDS, told[:, i, j], strict=True) if yes) for j in range(n_u))
        for i in range(n_y)
    )
    statistic = np.where(absent, np.nan, largest[0])
    return Detection(
        "plant-model-ratio",
        statistic,
        np.full(statistic.shape, threshold),
        np.asarray(largest[0] > threshold),
        kinds=kinds,
    )


def _error_responses(signals: Signals, errors: Array) -> tuple[Array, ComplexArray, Array]:
    """Frequencies (n_f,), response of each error to each input (n_f, m, n_u), and its relative variance (n_f, n_u).

    Averages over half overlapping stretches under a Hann window, the spectra from the set-points throughout.
    """
    n = signals.u.shape[0]
    size = int(np.clip(4 * signals.lags, 16, max(16, n // 4)))
    hann = np.hanning(size)

    def transform(x: Array) -> ComplexArray:
        spectrum = np.concatenate(list(window_spectra(x, hann, size // 2)))
        return np.asarray(spectrum[:, 1 : size // 2].transpose(1, 0, 2))

    r, u, e = (transform(x) for x in (signals.outer, signals.u, errors))
    s_rr, s_ur, s_er = (np.einsum("fba,fbc->fac", x, r.conj()) for x in (r, u, e))
    # With more set-points than inputs the least squares through all of them is taken.
    ridge = 1e-9 * np.trace(s_rr, axis1=1, axis2=2).real[:, None, None] * np.eye(r.shape[2])
    project = np.linalg.solve(s_rr + ridge, s_ur.conj().transpose(0, 2, 1))
    gram = s_ur @ project
    ridge_u = 1e-9 * np.trace(gram, axis1=1, axis2=2).real[:, None, None] * np.eye(u.shape[2])
    inverse = np.linalg.inv(gram + ridge_u)
    response = s_er @ project @ inverse
    noise = np.real(np.diagonal(inverse, axis1=1, axis2=2))
    w = np.asarray(2 * np.pi * np.fft.rfftfreq(size, signals.h)[1 : size // 2], dtype=np.float64)
    return w, np.asarray(response, dtype=np.complex128), np.asarray(np.maximum(noise, 1e-300), dtype=float)


def _contrasts(w: Array, ratio: ComplexArray, weight: Array) -> Array:
    """(3, draws, n_y, n_u): log of the gain, of the change over frequency, and the dead time of each ratio."""
    weight = weight / weight.sum(axis=0)
    below = np.cumsum(weight, axis=0) - weight / 2
    low, high = weight * (below < 0.5), weight * (below >= 0.5)
    low, high = low / np.maximum(low.sum(axis=0), 1e-300), high / np.maximum(high.sum(axis=0), 1e-300)
    size = np.log(np.maximum(np.abs(ratio), 1e-12))
    gain = np.einsum("fij,fdij->dij", low, size)
    top = np.einsum("fij,fdij->dij", high, size)
    slope = weight * w[:, None, None]
    slope = slope / np.sum(slope * w[:, None, None], axis=0)
    delay = -np.einsum("fij,fdij->dij", slope, np.angle(ratio))
    return np.array([gain, top - gain, delay])
