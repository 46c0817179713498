"""Local polynomial method (Pintelon and Schoukens 2012, chapter 7): responses and noise from short records.

In a window of neighbouring DFT bins the response from the reference signals and the transient (leakage) term are
smooth, and are written as polynomials of second degree; what they leave is noise. What is not smooth enough for that,
a response that lasts longer than about 1.5 times the record length over the bins in a window, is a systematic error
that the noise does not show: use the method on what a model leaves unexplained rather than on the whole.

Noise that falls with frequency, as that of a load that walks, differs within the lowest windows by orders of magnitude.
Where all that is left is noise, windows are weighted with the power of w that its restricted likelihood suggests.

The transient is written in 1/w, 1 and w, because a record that ends elsewhere than it began leaks with 1/w; what slow
known modes leave of an unknown initial state is not smooth, and is added in its exact form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import Refused
from trueplant.mismatch import levels

TERMS = 3
"""Of a polynomial of second degree."""
NODES = np.sqrt(0.75) * np.array([-1.0, 0.0, 1.0])
"""Where in a window (-1 to 1) its polynomial is read: three points hold all that it says."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Local models in windows that do not overlap, hence independent of each other.

    Polynomials have 3 points and 3 terms in a window; a line of a periodic signal is a window of 1 point and 1 term.
    """

    w: Array
    """(n_win, points) frequencies at which the polynomials are read."""
    basis: Array
    """(points, terms) of the response polynomial there."""
    theta: ComplexArray
    """(n_win, terms * n_r, n_z) coefficients; term a of reference j at a * n_r + j."""
    gram: ComplexArray
    """(n_win, terms * n_r, terms * n_r): covariance of theta is gram[c, d] noise[z, v]."""
    noise: ComplexArray
    """(n_win, n_z, n_z) covariance of the DFTs of z over sqrt(N); of polynomials averaged over three windows."""
    dof: int
    """Complex degrees of freedom behind the noise of one window, before averaging."""
    bins: int
    """Bins of the longest record in a window."""

    @property
    def value(self) -> ComplexArray:
        """(n_win, 3 points, n_z, n_r) responses from references to z."""
        n_win, n_coef, n_z = self.theta.shape
        terms = self.basis.shape[1]
        stacked = self.theta.reshape(n_win, terms, n_coef // terms, n_z)
        value: ComplexArray = np.einsum("pa,wajz->wpzj", self.basis, stacked)
        return value


def fit_windows(
    references: Sequence[Array],
    signals: Sequence[Array],
    h: float,
    poles: Sequence[complex] = (),
    colours: Sequence[float] = (0.0,),
) -> Windows:
    """Local models from references (N_k, n_r) to signals (N_k, n_z) of several records k, all sampled at h.

    Records enter with equal noise; each has its own transient. Lengths may differ. Windows are as
    narrow as `WINDOW_DOF` allows. `poles` are modes (per time unit) that may ring out from before a record; those that
    are slow against a window count. `colours` are the powers of 1/w with which the noise's amplitude may fall; what is
    no noise, as the mismatch of a model that is far off, would be taken for one.

    Raises Refused for records that are too short, and where no window tells the references apart.
    """
    n_r = references[0].shape[1]
    lengths = [len(r) for r in references]
    longest = max(lengths)
    spacing = 2 * np.pi / (longest * h)
    bins = _bins(n_r, lengths, spacing, poles)
    modes = _slow(poles, bins * spacing)
    kept = [k for k, n in enumerate(lengths) if bins * n / longest > TERMS + modes.size + 1]
    highest = min(2 * np.pi / (lengths[k] * h) * ((lengths[k] - 1) // 2) for k in kept)
    n_win = int((highest / spacing + 0.5) / bins)
    if n_win < 1:
        raise Refused(
            f"a record of {longest} samples is too short for a local model of {n_r} reference signals: "
            f"it needs {2 * bins + 1} samples or more"
        )
    half = bins * spacing / 2
    centre = np.float64(spacing) * (0.5 + bins * (np.arange(n_win) + 0.5))
    n_coef = TERMS * n_r
    rows, targets, within = [], [], []
    for place, k in enumerate(kept):
        regressors, target, relative = _rows(references[k], signals[k], h, centre, half, modes)
        own = regressors.shape[2] - n_coef
        padded = np.zeros((*regressors.shape[:2], n_coef + own * len(kept)), dtype=complex)
        padded[:, :, :n_coef] = regressors[:, :, :n_coef]
        padded[:, :, n_coef + own * place : n_coef + own * (place + 1)] = regressors[:, :, n_coef:]
        rows.append(padded)
        targets.append(target)
        within.append(relative)
    K, target, relative = (np.concatenate(parts, axis=1) for parts in (rows, targets, within))
    colour = max(colours, key=lambda power: _likelihood(K, target, relative, power))
    weight = relative[:, :, None] ** colour
    theta, gram, noise, dof, usable = _solve(weight * K, weight * target, n_coef)
    if not usable.any():
        raise Refused(
            "the set-points move too little or too much alike within these records to tell their effects apart: "
            "move each of them at instants of its own, well apart; moves that repeat many times are for averages over "
            "their periods"
        )
    basis = NODES[:, None] ** np.arange(TERMS)
    return Windows(
        w=(centre[:, None] + half * NODES)[usable],
        basis=basis,
        theta=theta[usable],
        gram=gram[usable],
        noise=_smoothed(noise[usable], centre[usable] ** (2 * colour)),
        dof=dof,
        bins=bins,
    )


def _bins(n_r: int, lengths: Sequence[int], spacing: float, poles: Sequence[complex]) -> int:
    """Fewest bins of the longest record that leave `WINDOW_DOF`; a shorter one counts if any of its are left."""
    relative = np.array(lengths) / max(lengths)
    for m in range(TERMS + 2, max(lengths)):
        left = np.floor(m * relative) - TERMS - _slow(poles, m * spacing).size
        if np.sum(left[left > 1]) - TERMS * n_r >= levels.WINDOW_DOF:
            return m
    raise Refused(f"records of {max(lengths)} samples are too short for a local model of {n_r} reference signals")


def _slow(poles: Sequence[complex], width: float) -> ComplexArray:
    """Distinct modes other than integrators that decay too slowly to be smooth over a window of that width."""
    distinct: list[complex] = []
    for p in poles:
        if 0 < abs(p) < width and all(abs(p - q) > levels.SAME_MODE * abs(q) for q in distinct):
            distinct.append(complex(p))
    return np.array(distinct, dtype=complex)


def _rows(
    r: Array, z: Array, h: float, centre: Array, half: float, modes: ComplexArray
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Regressors (n_win, rows, TERMS n_r + TERMS + modes) and targets (n_win, rows, n_z) of one record.

    With them w (n_win, rows) over the window's centre. Windows have a bin more or less; rows that are missing are 0,
    and their w is the centre's.
    """
    n = len(r)
    w = 2 * np.pi / (n * h) * np.arange(1, (n - 1) // 2 + 1)
    window = np.floor((w - centre[0] + half) / (2 * half)).astype(int)
    inside = (window >= 0) & (window < centre.size)
    w, window = w[inside], window[inside]
    first = np.searchsorted(window, np.arange(centre.size))
    place = np.arange(w.size) - first[window]
    spectra = np.fft.rfft(np.hstack([r, z]), axis=0)[1 : (n - 1) // 2 + 1][inside] / np.sqrt(n)
    x = (w - centre[window]) / half
    powers = x[:, None] ** np.arange(TERMS)
    reference = (powers[:, :, None] * spectra[:, None, : r.shape[1]]).reshape(w.size, -1)
    smooth = (w / centre[window])[:, None] ** np.arange(-1, TERMS - 1)
    ringing = 1 / (1 - np.exp((modes[None, :] - 1j * w[:, None]) * h))
    transient = np.hstack([smooth, ringing])
    rows = int(place.max()) + 1
    regressors = np.zeros((centre.size, rows, reference.shape[1] + transient.shape[1]), dtype=complex)
    regressors[window, place] = np.hstack([reference, transient])
    target = np.zeros((centre.size, rows, z.shape[1]), dtype=complex)
    target[window, place] = spectra[:, r.shape[1] :]
    relative = np.ones((centre.size, rows))
    relative[window, place] = w / centre[window]
    return regressors, target, relative


def _likelihood(K: ComplexArray, target: ComplexArray, relative: Array, power: float) -> float:
    """Restricted log likelihood, where the noise goes with w to minus `power`, but for a constant."""
    weight = relative[:, :, None] ** power
    scaled, length = _scaled(K)
    q, r = np.linalg.qr(weight * scaled)
    left = weight * target - q @ (q.conj().transpose(0, 2, 1) @ (weight * target))
    n_z = target.shape[2]
    dof = np.sum(np.any(K != 0, axis=2), axis=1) - K.shape[2]
    size = np.maximum(np.sum(np.abs(left) ** 2, axis=1), np.finfo(float).tiny)
    diagonal = np.maximum(np.abs(np.einsum("wcc->wc", r)), np.finfo(float).tiny)
    columns = np.log(diagonal).sum(axis=1)
    each = n_z * (2 * np.log(weight).sum(axis=(1, 2)) - 2 * columns) - dof * np.log(size).sum(axis=1)
    # in narrow windows 1/w, 1 and w are the same to rounding, and w is too even to tell the power
    there = np.all(length > 0, axis=(1, 2)) & (dof > 0) & (diagonal.min(axis=1) * levels.LARGEST_CONDITION > 1)
    return float(each[there].sum())


def _solve(
    K: ComplexArray, target: ComplexArray, n_coef: int
) -> tuple[ComplexArray, ComplexArray, ComplexArray, int, NDArray[np.bool_]]:
    """Least squares in every window: coefficients of the references, their gram matrix, the noise covariance.

    The transients are projected out first, so that what is left tells how well the references are separated.
    """
    free, _ = np.linalg.qr(_scaled(K[:, :, n_coef:])[0])
    own = K[:, :, :n_coef] - free @ (free.conj().transpose(0, 2, 1) @ K[:, :, :n_coef])
    _, before = _scaled(K[:, :, :n_coef])
    left = target - free @ (free.conj().transpose(0, 2, 1) @ target)
    scaled = own / np.where(before > 0, before, 1.0)
    u, singular, vh = np.linalg.svd(scaled, full_matrices=False)
    present = np.all(before > levels.ABSENT_REFERENCE * before.max(axis=0), axis=(1, 2))
    usable = present & (singular[:, -1] * levels.LARGEST_CONDITION > np.maximum(singular[:, 0], 1e-12))
    inverse = np.where(usable[:, None], 1 / np.where(singular > 0, singular, 1.0), 0.0)
    projected = u.conj().transpose(0, 2, 1) @ left
    back = vh.conj().transpose(0, 2, 1) * inverse[:, None, :] / np.where(before > 0, before, 1.0).transpose(0, 2, 1)
    theta: ComplexArray = back @ projected
    residual = left - u @ projected
    counts = np.sum(np.any(K != 0, axis=2), axis=1)
    dof = np.maximum(counts - K.shape[2], 1)
    # theta_c = sum_n P_cn n_n: E theta_c conj(theta_d) = (P P*)_cd, times the noise
    gram = np.asarray(back @ back.conj().transpose(0, 2, 1), dtype=complex)
    noise: ComplexArray = np.einsum("wrz,wrv->wzv", residual, residual.conj()) / dof[:, None, None]
    return theta, gram, noise, int(np.median(dof)), usable


def _scaled(columns: ComplexArray) -> tuple[ComplexArray, Array]:
    length: Array = np.linalg.norm(columns, axis=1, keepdims=True)
    return columns / np.where(length > 0, length, 1.0), length


def _smoothed(noise: ComplexArray, falls: Array) -> ComplexArray:
    """Mean over each window and its neighbours, times `falls` (n_win,): what is left of the spectrum is smoother than
    its estimate in one window."""
    if len(noise) < 3:
        return noise
    level = noise * falls[:, None, None]
    middle = (level[:-2] + level[1:-1] + level[2:]) / 3
    smooth = np.concatenate([middle[:1], middle, middle[-1:]]) / falls[:, None, None]
    return np.asarray(smooth, dtype=complex)
