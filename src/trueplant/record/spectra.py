"""Spectra of overlapping windows, over which cross spectra are averaged (Welch 1967)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trueplant.arrays import Array, ComplexArray

BATCH = 2**16
"""Samples that are transformed at once: memory stays small in long records."""


def window_spectra(x: Array, taper: Array, step: int, centred: bool = True) -> Iterator[ComplexArray]:
    """Spectra (windows, L // 2 + 1, n) of signals x (N, n) under a taper (L,), a window every `step` samples.

    They come in batches of windows, none where x is shorter than the taper. Each window is freed of its mean if
    `centred`.
    """
    length = taper.size
    if len(x) < length:
        return
    cut = np.lib.stride_tricks.sliding_window_view(x, length, axis=0)[::step].transpose(0, 2, 1)
    batch = max(1, BATCH // length)
    for k in range(0, len(cut), batch):
        some = cut[k : k + batch]
        level = some.mean(axis=1, keepdims=True) if centred else 0.0
        yield np.fft.rfft((some - level) * taper[:, None], axis=1)
