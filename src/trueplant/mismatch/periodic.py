"""The plant from set-points that repeat: averages over whole periods, errors from the spread between them.

At the lines of a periodic set-point the loop's answer is the same in every period once the transient has died out,
whatever its dynamics: no polynomial stands in for them, so that nothing is systematically wrong. What differs from
period to period is noise (Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd edition 2012,
chapters 2 and 7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError, Refused, UsageError
from trueplant.loop.controller import Controller
from trueplant.lti.transfer import TransferMatrix
from trueplant.mismatch import levels
from trueplant.mismatch.local import Form, FrequencyResponse, Sampled, gathered, moved, plant_response
from trueplant.mismatch.polynomial import Windows
from trueplant.mismatch.sampling import sampled_frequency_response
from trueplant.record.types import Segment

Stretch = tuple[int, int]
"""(first sample, whole periods)."""


@dataclass(frozen=True, eq=False)
class _Averaged:
    """One stretch: spectra at the lines (n_lines, n), noise of one period, and how many periods were used."""

    reference: ComplexArray
    signal: ComplexArray
    noise: ComplexArray
    used: int
    left_out: int


def periodic_response(
    segments: Sequence[Segment],
    method: str = "joint",
    model: TransferMatrix | None = None,
    controller: Controller | None = None,
    near: bool = False,
    period: float | None = None,
) -> FrequencyResponse:
    """The plant's frequency response at the lines of set-points that repeat (inputs, with method "direct").

    Every stretch in which the set-points repeat at least three times is an experiment; there may be several in a
    record. Its first period is left out, and those after it that differ from the later ones by more than noise; a
    steady drift is taken out. Several set-points need as many experiments that move them differently: in turn, or
    together with opposite signs. Lines that do not tell them apart are left out.

    `std` and `covariance` come from the spread between periods, with (periods - 1) complex degrees of freedom summed
    over the experiments in `dof`. Each line is a window of its own. `period`, in time units, is found if not given
    (`period_of`). method, model, controller and near are as in `local_response`; the model serves the closed form, and
    corrects `value` for the hold.

    Raises Refused where nothing repeats or the experiments cannot tell, LoopError where the closed form does not
    apply, UsageError for segments or a period that do not fit together.
    """
    if method == "closed-form":  # as of a linear loop alone
        segments = [part for segment in segments for part in segment.free_parts()] or segments
    h, hold, inputs, outputs, notes = gathered(segments)
    n_y, n_u = outputs[0].shape[1], inputs[0].shape[1]
    references = moved(segments, method)
    if method == "closed-form" and (model is None or controller is None):
        raise LoopError("the closed form needs a model and a declared controller: use the joint form without")
    signals = outputs if method == "direct" else [np.hstack(z) for z in zip(outputs, inputs, strict=True)]
    what = "inputs" if method == "direct" else "set-points"
    repeat = [s.u if method == "direct" else s.setpoints for s in segments]
    length = _samples(period, h) if period is not None else _period(repeat, what)
    averaged = [
        _average(r[a : a + count * length], z[a : a + count * length], length)
        for r, z, x in zip(references, signals, repeat, strict=True)
        for a, count in _stretches(x, length)
    ]
    if not averaged:
        raise Refused(
            f"the {what} do not repeat with a period of {length * h:g} at least {levels.FEWEST_PERIODS} times"
        )
    windows = _against(_combined(averaged, length, h, what), model, (n_y, n_u), method, h, hold)
    used, left_out = sum(a.used for a in averaged), sum(a.left_out for a in averaged)
    notes.append(
        f"{used} periods of {length * h:g} were averaged, in {len(averaged)} experiment{'s'[: len(averaged) > 1]}; "
        f"{left_out} before them were left out as transient"
    )
    form = Form(method, model, controller, near)
    return plant_response(windows, (n_y, n_u), form, Sampled(h, hold), tuple(notes), used)


def period_of(r: Array, h: float) -> float:
    """The period, in time units, with which signals r (N, n) sampled at h repeat sample by sample.

    The lag at which most of the record belongs to stretches of three or more equal periods, to rounding. Raises Refused
    where set-points move for more than half of the time outside of such stretches.
    """
    r = np.asarray(r, dtype=float)
    return _period([r.reshape(len(r), -1)], "set-points") * h


def _samples(period: float, h: float) -> int:
    length = round(period / h)
    if length < levels.SHORTEST_PERIOD or abs(length * h - period) > 1e-6 * period:
        raise UsageError(
            f"a period of {period:g} is {period / h:.6g} samples of {h:g}: it has to be a whole number of samples, at "
            f"least {levels.SHORTEST_PERIOD}; resample the record, or use the local polynomial method"
        )
    return length


def _period(references: Sequence[Array], what: str) -> int:
    """The lag (samples) whose repetitions cover most samples; the shortest of those that cover as many."""
    best, covered = 0, 0
    moving = sum(_moving(r) for r in references)
    for lag in sorted({int(lag) for r in references for lag in _candidates(r)}):
        samples = sum(count * lag for r in references for _, count in _stretches(r, lag))
        if samples > covered + lag:
            best, covered = lag, samples
    if covered < levels.COVERED * max(moving, 1):
        raise Refused(
            f"the {what} do not repeat, sample by sample, at least {levels.FEWEST_PERIODS} times: averages over "
            "periods need a period that is a whole number of samples; use the local polynomial method"
        )
    return best


def _moving(r: Array) -> int:
    """Samples from the first move to the last."""
    moves = np.flatnonzero(_moves(r))
    return int(moves[-1] - moves[0]) if moves.size else 0


def _range(r: Array) -> Array:
    extent: Array = np.ptp(r, axis=0)
    return extent


def _moves(r: Array) -> NDArray[np.bool_]:
    moves: NDArray[np.bool_] = np.logical_or.reduce([np.diff(x) != 0 for x in r.T])
    return moves


def _candidates(r: Array) -> NDArray[np.int64]:
    """Lags at which the mean square of r(t + lag) - r(t) has its lowest minima, by way of the autocorrelation."""
    n = len(r)
    if n < levels.FEWEST_PERIODS * levels.SHORTEST_PERIOD:
        return np.zeros(0, dtype=np.int64)
    scaled = (r - r.mean(axis=0)) / np.where(_range(r) > 0, _range(r), 1.0)
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    power = np.sum(np.abs(np.fft.rfft(scaled, size, axis=0)) ** 2, axis=1)
    product = np.fft.irfft(power, size)[:n]
    energy = np.concatenate([[0.0], np.cumsum(np.sum(scaled**2, axis=1))])
    lags = np.arange(n // levels.FEWEST_PERIODS + 2)
    apart = (energy[n - lags] + energy[n] - energy[lags] - 2 * product[lags]) / (n - lags)
    lowest = np.flatnonzero((apart[1:-1] <= apart[:-2]) & (apart[1:-1] <= apart[2:])) + 1
    lowest = lowest[(lowest >= levels.SHORTEST_PERIOD) & (levels.FEWEST_PERIODS * lowest <= n)]
    return lowest[np.argsort(apart[lowest], kind="stable")[: levels.MINIMA]]


def _stretches(r: Array, lag: int) -> list[Stretch]:
    """Where r moves and repeats with this lag for FEWEST_PERIODS at least: whole periods, up to the last sample."""
    equal = np.logical_and.reduce([np.abs(x[lag:] - x[:-lag]) <= levels.SAME * np.ptp(x) for x in r.T])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], equal, [False]]).astype(int)))
    ends = edges[1::2] + lag
    counts = (ends - edges[::2]) // lag
    long = counts >= levels.FEWEST_PERIODS
    return [
        (int(end - count * lag), int(count))
        for end, count in zip(ends[long], counts[long], strict=True)
        if np.any(_moves(r[end - lag : end]))
    ]


def _average(r: Array, z: Array, length: int) -> _Averaged:
    """Mean spectra of a stretch of whole periods, after its transient."""
    lines = slice(1, (length - 1) // 2 + 1)
    cut = z.reshape(-1, length, z.shape[1])
    spectra = np.fft.rfft(cut, axis=1)[:, lines] / np.sqrt(length)
    first = _settled_from(spectra, 1e-10 * np.sqrt(length) * float(np.max(np.abs(z))))
    kept, used = spectra[first:], len(spectra) - first
    mean = kept.mean(axis=0) - _ramp(cut[first:].mean(axis=1), length)[lines]
    apart = kept - kept.mean(axis=0)
    noise = np.einsum("plz,plv->lzv", apart, apart.conj()) / (used - 1)
    reference = np.fft.rfft(r.reshape(-1, length, r.shape[1])[first:].mean(axis=0), axis=0)[lines] / np.sqrt(length)
    return _Averaged(reference, mean, noise, used, first)


def _ramp(means: Array, length: int) -> ComplexArray:
    """Spectrum (n_bins, n_z) within one period of the straight line through the means (P, n_z) of the periods.

    A drift is alike in all periods, so that their spread would not show what it adds to the lines.
    """
    place = np.arange(len(means)) - (len(means) - 1) / 2
    slope = place @ means / np.sum(place**2) / length
    ramp: ComplexArray = np.fft.rfft(np.arange(length))[:, None] * slope / np.sqrt(length)
    return ramp


def _settled_from(spectra: ComplexArray, rounding: float) -> int:
    """The first period, from the second on, that does not differ from the later ones by more than their spread.

    The power of the difference over that of the spread, summed over the lines, has about an F distribution; as noise is
    not white, the lines count for (sum s^2)^2 / sum s^4 (Satterthwaite).
    """
    count, _, n_z = spectra.shape
    if count == levels.FEWEST_PERIODS:
        return 1
    for first in range(1, count - 2):
        later = spectra[first + 1 :]
        m = len(later)
        mean = later.mean(axis=0)
        spread = np.sum(np.abs(later - mean) ** 2, axis=0) / (m - 1)
        differs = np.sum(np.abs(spectra[first] - mean) ** 2, axis=0)
        size = np.sum(np.abs(mean) ** 2, axis=0)
        total = np.maximum(spread.sum(axis=0), 1e-300)
        effective = np.maximum(total**2 / np.maximum(np.sum(spread**2, axis=0), 1e-300), 1.0)
        p = fisher.sf(differs / (total * (1 + 1 / m)), 2 * effective, 2 * effective * (m - 1))
        if np.all((p > levels.DIFFERS / n_z) | (differs <= levels.TRANSIENT_NEGLIGIBLE**2 * size + rounding**2)):
            return first
    raise Refused(
        "the response still changes from period to period when the record ends: leave more periods after the transient"
    )


def _combined(averaged: Sequence[_Averaged], length: int, h: float, what: str) -> Windows:
    """Responses by least squares over the experiments at every line, weighted by their periods."""
    n_r, n_e = averaged[0].reference.shape[1], len(averaged)
    if n_e < n_r:
        raise Refused(
            f"{n_e} experiment{'s'[: n_e > 1]} with periodic {what} cannot tell {n_r} of them apart at a line: it "
            "takes as many, in which they move in turn or with opposite signs"
        )
    weight = np.sqrt([float(a.used) for a in averaged])
    R = np.stack([a.reference for a in averaged], axis=2) * weight
    Z = np.stack([a.signal for a in averaged], axis=2) * weight
    scale = np.abs(R).max(axis=(0, 2))[:, None]
    u, singular, vh = np.linalg.svd(R / np.where(scale > 0, scale, 1.0), full_matrices=False)
    usable = singular[:, -1] > levels.EXCITED * singular.max()
    if not usable.any():
        raise Refused(
            f"no line tells the {what} apart: the experiments move them alike; move them in turn or with opposite signs"
        )
    over = vh[usable].conj().transpose(0, 2, 1) / singular[usable, None, :] @ u[usable].conj().transpose(0, 2, 1)
    inverse = over / scale.T
    degrees = [a.used - 1 for a in averaged]
    noise = np.average([a.noise[usable] for a in averaged], axis=0, weights=degrees)
    # Z = H R + N: H - H_true = N R^+, whose columns c, d covary by (R^+* R^+)_cd times the noise of one period
    gram = np.einsum("lec,led->lcd", inverse, inverse.conj())
    return Windows(
        w=(np.float64(2 * np.pi / (length * h)) * np.arange(1, (length - 1) // 2 + 1))[usable, None],
        basis=np.ones((1, 1)),
        theta=(Z[usable] @ inverse).transpose(0, 2, 1),
        gram=gram,
        noise=noise,
        dof=sum(degrees),
        bins=1,
    )


def _against(
    windows: Windows,
    model: TransferMatrix | None,
    shape: tuple[int, int],
    method: str,
    h: float,
    hold: tuple[str, ...],
) -> Windows:
    """Responses of (y, u), or of y to u, turned into those of e = y - Ghat u as the method takes them."""
    n_y, n_u = shape
    if model is None:
        return windows
    Ghat = sampled_frequency_response(model, windows.w[:, 0], h, hold)
    if method == "direct":
        return replace(windows, theta=windows.theta - Ghat.transpose(0, 2, 1))
    rows = n_y if method == "closed-form" else n_y + n_u
    turn = np.broadcast_to(np.eye(rows, n_y + n_u, dtype=complex), (len(Ghat), rows, n_y + n_u)).copy()
    turn[:, :n_y, n_y:] = -Ghat
    return replace(
        windows,
        theta=windows.theta @ turn.transpose(0, 2, 1),
        noise=turn @ windows.noise @ turn.conj().transpose(0, 2, 1),
    )
