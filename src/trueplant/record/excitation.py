"""Do the set-points (or, in open loop, the OPs) move enough, over which frequencies, and apart from each other?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.runs import true_runs
from trueplant.record.sensor import quantum
from trueplant.record.spectra import window_spectra
from trueplant.record.types import Segment


@dataclass(frozen=True, eq=False)
class Excitation:
    """How n signals move, over all segments together. Frequencies w in rad per time unit."""

    which: str
    names: tuple[str, ...]
    changes: NDArray[np.int64]
    """(n,) number of samples at which the signal moves."""
    total_variation: Array
    """(n,) sum of the absolute moves."""
    std: Array
    """(n,)"""
    quanta: Array
    """(n,) standard deviation in quanta of the signal; infinite where it has no quantum."""
    power_share: Array
    """(n,) share of the signal's power that lies above the noise."""
    bands: tuple[tuple[float, float] | None, ...]
    """(w_low, w_high) in which the spectrum exceeds the noise (longest stretch), None for a constant signal."""
    w: Array
    condition: Array
    """Condition number, over w, of the averaged spectral matrix of the signals scaled to unit variance."""
    rank: int
    """Number of directions in which the signals move apart."""
    sentences: tuple[str, ...] = field(default=())
    """What is not enough, in plain words; empty if nothing is missing."""

    @property
    def sufficient(self) -> bool:
        """True if every signal moves, and moves apart from the others."""
        return self.rank == len(self.names)


def excitation(segments: Sequence[Segment], which: Literal["r", "u"] = "r", names: Sequence[str] = ()) -> Excitation:
    """Measure the excitation by set-points (which="r") or by OP ("u") over all segments.

    The spectral matrix is averaged over Hann windows and segments (Welch, 1967), of the moves, so that steps do not
    leak; a condition number does not depend on that filter, which is common to all signals. The noise to exceed is
    that of PV for set-points (white floor from its second differences) and a signal's own quantisation for OP.
    """
    if which not in ("r", "u"):
        raise DataError(f'excitation of {which!r} is unknown; use "r" or "u"')
    if not segments:
        raise DataError("excitation needs at least one segment; none was left by screening")
    h = segments[0].h
    signals = [np.asarray(getattr(g, "setpoints" if which == "r" else "u")) for g in segments]
    n = signals[0].shape[1]
    shown = tuple(names) if names else tuple(f"{'set-point' if which == 'r' else 'OP'} {k + 1}" for k in range(n))
    moves = [np.nan_to_num(np.diff(x, axis=0)) for x in signals]
    changes = np.sum([np.sum(m != 0, axis=0) for m in moves], axis=0)
    std = np.where(changes > 0, np.array([_std(x.T[k] for x in signals) for k in range(n)]), 0.0)
    q = np.array([_quantum(signals, k) for k in range(n)])
    with np.errstate(divide="ignore", invalid="ignore"):
        quanta = np.where(q > 0, std / q, np.where(std > 0, np.inf, 0.0))
    w, spectrum = _spectral_matrix(moves, h)
    noise = _pv_noise(segments, n) if which == "r" else q**2 / 12
    bands, share = _bands(w, spectrum, noise, h, changes)
    sentences, rank = _directions(sum(m.T @ m for m in moves), changes, shown, which)
    return Excitation(
        which=which,
        names=shown,
        changes=changes,
        total_variation=np.sum([np.sum(np.abs(m), axis=0) for m in moves], axis=0),
        std=std,
        quanta=quanta,
        power_share=share,
        bands=bands,
        w=w,
        condition=_condition(spectrum),
        rank=rank,
        sentences=sentences,
    )


def _std(stretches: Iterable[Array]) -> float:
    """Root mean square of a signal about its mean in each stretch; samples that are missing count as on it."""
    squares = samples = 0.0
    for x in stretches:
        known = x[np.isfinite(x)]
        squares, samples = squares + known.size * float(np.var(known)) if known.size else squares, samples + x.size
    return float(np.sqrt(squares / samples))


def _quantum(signals: list[Array], k: int) -> float:
    joined = np.concatenate([x[:, k] for x in signals])
    return quantum(joined[np.isfinite(joined)])


def _spectral_matrix(moves: list[Array], h: float) -> tuple[Array, ComplexArray]:
    """w (n_w,) without zero, and the averaged cross spectra (n_w, n, n) of the moves."""
    total = sum(m.shape[0] for m in moves)
    longest = max(m.shape[0] for m in moves)
    n = moves[0].shape[1]
    size = min(longest, levels.LONGEST_WINDOW, max(8, 2 * total // (max(levels.WELCH_WINDOWS, 2 * n) + 1)))
    taper = np.hanning(size + 2)[1:-1]
    sums, count = np.zeros((size // 2 + 1, n, n), dtype=complex), 0
    for m in moves:
        if m.shape[0] < size:
            m = np.concatenate([m, np.zeros((size - m.shape[0], n))])
        for f in window_spectra(m, taper, max(1, size // 2), centred=False):
            sums += np.einsum("lfi,lfj->fij", f, f.conj())
            count += f.shape[0]
    w = 2 * np.pi * np.fft.rfftfreq(size, h)
    spectrum = np.asarray(sums[1:] / (count * np.sum(taper**2)), dtype=complex)
    return np.asarray(w[1:], dtype=float), spectrum


def _condition(spectrum: ComplexArray) -> Array:
    """Condition number at each frequency after scaling each signal to unit power; infinite where it is singular."""
    power = np.real(np.einsum("fii->i", spectrum))
    if np.any(power <= 0):
        return np.full(spectrum.shape[0], np.inf)
    scaled = spectrum / np.sqrt(np.outer(power, power))
    values = np.linalg.eigvalsh(scaled)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = values[:, -1] / values[:, 0]
    return np.where(values[:, 0] > 1e-13 * values[:, -1], ratio, np.inf)


def _pv_noise(segments: Sequence[Segment], n: int) -> Array:
    """(n,) variance of each PV's white noise, from the median absolute second difference (6 times as much variance)."""
    out = np.zeros(n)
    for k in range(min(n, segments[0].y.shape[1])):
        d = np.concatenate([np.diff(g.y[:, k], 2) for g in segments])
        d = d[np.isfinite(d)]
        out[k] = (levels.NORMAL_MAD * float(np.median(np.abs(d)))) ** 2 / 6 if d.size else 0.0
    return out


def _bands(
    w: Array, spectrum: ComplexArray, noise: Array, h: float, changes: NDArray[np.int64]
) -> tuple[tuple[tuple[float, float] | None, ...], Array]:
    """Where the power of each signal exceeds the noise, and the share of its power there."""
    bands: list[tuple[float, float] | None] = []
    share = np.zeros(changes.size)
    # of white noise v the moves have the power |1 - exp(-jwh)|^2 var v
    differencing = np.abs(1 - np.exp(-1j * w * h)) ** 2
    for k in range(changes.size):
        power = np.real(spectrum[:, k, k])
        above = (power > noise[k] * differencing) & (power > 1e-12 * np.max(power, initial=0.0))
        if changes[k] == 0 or not above.any():
            bands.append(None)
            continue
        begin, length = true_runs(above)
        longest = int(np.argmax(length))
        bands.append((float(w[begin[longest]]), float(w[begin[longest] + length[longest] - 1])))
        signal = power / differencing
        share[k] = float(np.sum(signal[above]) / np.sum(signal))
    return tuple(bands), share


def _directions(
    products: Array, changes: NDArray[np.int64], names: tuple[str, ...], which: str
) -> tuple[tuple[str, ...], int]:
    """What is missing, in words, and the rank of the moves, from the sums of their `products` (n, n)."""
    sentences = []
    word = "set-point" if which == "r" else "OP"
    still = [names[k] for k in np.flatnonzero(changes == 0)]
    for name in still:
        sentences.append(f"{name} is constant: nothing is learnt through this {word}; move it in another experiment.")
    moving = np.flatnonzero(changes > 0)
    if moving.size == 0:
        return tuple(sentences), 0
    size = np.sqrt(np.diag(products)[moving])
    gram = products[np.ix_(moving, moving)] / np.outer(size, size)
    singular = np.linalg.svd(gram, compute_uv=False, hermitian=True)
    rank = int(np.sum(np.sqrt(singular / singular[0]) > levels.SAME_PROPORTION))
    if rank == moving.size:
        return tuple(sentences), rank
    pairs = [(a, b) for a, b in combinations(range(moving.size), 2) if abs(gram[a, b]) > 1 - levels.SAME_PROPORTION**2]
    for a, b in pairs:
        sentences.append(
            f"{names[moving[a]]} and {names[moving[b]]} always move together in the same proportion: their effects "
            "cannot be told apart; move them separately, or add an experiment in which they move differently."
        )
    if not pairs:
        sentences.append(
            f"The {moving.size} {word}s move in only {rank} independent directions: not all effects can be told apart; "
            "add an experiment in which they move separately."
        )
    return tuple(sentences), rank
