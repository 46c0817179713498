"""How much of a signal the set-points explain at each frequency, by any linear relation: multiple coherence.

Spectra are averaged over Hann windows of half overlap (Welch 1967), each freed of its mean. With one set-point this is
the usual magnitude-squared coherence; it is S/(S + N) of a signal whose power is S by the set-points and N by the rest
(Bendat and Piersol, Random Data, 4th edition 2010, chapters 6, 7 and 9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import beta

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import Refused, UsageError
from trueplant.mismatch import levels
from trueplant.mismatch.local import gathered, moved
from trueplant.record.spectra import window_spectra
from trueplant.record.types import Segment


@dataclass(frozen=True, eq=False)
class Coherence:
    """Multiple and partial coherence at w (n_w,) rad per time unit, between 0 and 1."""

    w: Array
    multiple: Array
    """(n_w, n_z) of each output, then (with set-points) of each input, with all set-points together."""
    partial: Array
    """(n_w, n_z, n_r) with each set-point alone, once the others are taken out of it and of the signal."""
    level: float
    """What `multiple` of a signal without any relation to the set-points exceeds in `significance` of the cases."""
    partial_level: float
    windows: float
    """Independent windows that the averages count for."""
    significance: float
    which: str


def coherence(
    segments: Sequence[Segment],
    which: Literal["r", "u"] = "r",
    window: int | None = None,
    significance: float = levels.UNRELATED,
) -> Coherence:
    """Coherence of the outputs and inputs with the set-points (which="r"), or of the outputs with the inputs ("u").

    window: samples of one; if not given the records are cut into four windows for each set-point and four more, before
    overlap: more windows have less of chance in them, longer ones tell closer frequencies apart. The level follows from
    the beta distribution that the coherence of unrelated Gaussian signals has.

    Raises Refused where nothing moves or the records are too short, UsageError for segments that do not fit together.
    """
    if which not in ("r", "u"):
        raise UsageError(f'coherence is with set-points ("r") or inputs ("u"), not {which!r}')
    h, _, inputs, outputs, _ = gathered(segments)
    references = moved(segments, "joint" if which == "r" else "direct")
    signals = [np.hstack(z) for z in zip(outputs, inputs, strict=True)] if which == "r" else outputs
    n_r, lengths = references[0].shape[1], [len(r) for r in references]
    length = min(sum(lengths) // (levels.AVERAGES * (n_r + 1)), max(lengths)) if window is None else window
    powers = [_powers(np.hstack(x), length) for x in zip(references, signals, strict=True)]
    count = sum(windows for _, windows in powers)
    independent = count / (1 + 2 * levels.HANN_OVERLAP * (count - 1) / max(count, 1))
    if independent < n_r + 2:
        raise Refused(
            f"{sum(lengths)} samples hold too few windows to tell what {n_r} "
            f"{'set-point' if which == 'r' else 'input'}{'s'[: n_r > 1]} explain: use longer records"
        )
    S = np.sum([power for power, _ in powers], axis=0)[1:]
    multiple = _explained(S, range(n_r), n_r)
    without = np.stack([_explained(S, [k for k in range(n_r) if k != j], n_r) for j in range(n_r)], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        partial = np.where(without < 1, (multiple[:, :, None] - without) / (1 - without), 0.0)
    return Coherence(
        w=2 * np.pi / (length * h) * np.arange(1, length // 2 + 1),
        multiple=multiple,
        partial=np.clip(partial, 0.0, 1.0),
        level=float(beta.ppf(1 - significance, n_r, independent - n_r)),
        partial_level=float(beta.ppf(1 - significance, 1, independent - n_r)),
        windows=float(independent),
        significance=significance,
        which=which,
    )


def _powers(x: Array, length: int) -> tuple[ComplexArray, int]:
    """(length // 2 + 1, n, n) spectral matrix summed over Hann windows of half overlap without their means, and how
    many they are."""
    total, windows = np.zeros((length // 2 + 1, x.shape[1], x.shape[1]), dtype=complex), 0
    if length < levels.SHORTEST_WINDOW:
        return total, windows
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    for spectra in window_spectra(x, hann, length - length // 2):
        total += np.einsum("kfi,kfj->fij", spectra.conj(), spectra)
        windows += len(spectra)
    return total, windows


def _explained(S: ComplexArray, chosen: Sequence[int], n_r: int) -> Array:
    """(n_w, n_z) share of each signal's power that the chosen references explain, of the spectral matrix S."""
    n_z = S.shape[1] - n_r
    if not len(chosen):
        return np.zeros((len(S), n_z))
    pick = list(chosen)
    power = np.sqrt(np.einsum("fii->fi", S[:, pick][:, :, pick]).real.max(axis=0))
    between = S[:, pick][:, :, pick] / np.outer(power, power)
    across = S[:, pick, n_r:] / power[:, None]
    values, vectors = np.linalg.eigh(between)
    inverse = np.where(values > levels.ABSENT_POWER, 1 / np.where(values > levels.ABSENT_POWER, values, 1.0), 0.0)
    along = vectors.conj().transpose(0, 2, 1) @ across
    explained = np.sum(np.abs(along) ** 2 * inverse[:, :, None], axis=1)
    total = np.einsum("fii->fi", S[:, n_r:, n_r:]).real
    share: Array = np.clip(np.where(total > 0, explained / np.where(total > 0, total, 1.0), 0.0), 0.0, 1.0)
    return share
