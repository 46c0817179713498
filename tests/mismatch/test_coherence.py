"""Coherence against closed forms and another library; its level against signals that are not related.

All records are simulated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from scipy.signal import lfilter
from scipy.stats import binom

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.errors import Refused, UsageError
from trueplant.loop import simulate
from trueplant.mismatch import coherence
from trueplant.record import Segment

H = 0.5


def segment(r, y, u=None):
    r, y = np.asarray(r, dtype=float).reshape(len(r), -1), np.asarray(y, dtype=float).reshape(len(y), -1)
    u = r if u is None else u
    n = len(r)
    shape = np.ones((n, u.shape[1]), dtype=bool)
    return Segment(0, H, H * np.arange(n), r, u, y, np.zeros((n, 0)), shape, ("zoh",) * u.shape[1])


def test_one_setpoint_is_the_coherence_of_another_library():
    rng = np.random.default_rng(0)
    r = random_switching(rng, 3000, 1, 10.0)
    y = lfilter([0.2], [1, -0.8], r, axis=0) + 0.5 * rng.standard_normal((3000, 1))
    for length in (200, 151):
        found = coherence([segment(r, y)], window=length)
        f, expected = scipy.signal.coherence(
            r[:, 0], y[:, 0], fs=1 / H, nperseg=length, noverlap=length // 2, window="hann", detrend="constant"
        )
        np.testing.assert_allclose(found.w, 2 * np.pi * f[1:])
        np.testing.assert_allclose(found.multiple[:, 0], expected[1:], rtol=1e-9)
        np.testing.assert_allclose(found.partial[:, 0, 0], expected[1:], rtol=1e-9)


def test_two_white_setpoints_give_the_known_share_of_signal_in_the_whole():
    """gamma^2 = S/(S + N), S by both set-points, of which each has its own share; bias and scatter below 0.01."""
    rng = np.random.default_rng(1)
    n = 200_000
    r = rng.standard_normal((n, 2))
    first, second = lfilter([1.0], [1, -0.7], r[:, 0]), lfilter([1.0, 0.5], [1.0], r[:, 1])
    noise = rng.standard_normal(n)
    found = coherence([segment(r, first + second + noise)], window=128)
    z = np.exp(1j * found.w * H)
    one, two = 1 / np.abs(1 - 0.7 / z) ** 2, np.abs(1 + 0.5 / z) ** 2
    np.testing.assert_allclose(found.multiple[:, 0], (one + two) / (one + two + 1), atol=0.025)
    np.testing.assert_allclose(found.partial[:, 0, 0], one / (one + 1), atol=0.035)
    np.testing.assert_allclose(found.partial[:, 0, 1], two / (two + 1), atol=0.035)
    assert abs(np.mean(found.multiple[:, 0] - (one + two) / (one + two + 1))) < 0.003


@pytest.mark.parametrize("n_r", [1, 2, 3])
def test_noise_alone_exceeds_the_level_in_one_of_twenty(n_r):
    """40 seeded records of AR(1) noise beside set-points that switch at random: 5 % over frequencies and runs.

    Passes with more than 0.999 at that level, with less than 1e-6 at 20 %.
    """
    above, partial, count = 0, 0, 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        r = random_switching(rng, 2400, n_r, 15.0)
        found = coherence([segment(r, coloured(rng, 2400, 1, [1, -0.7], [1], 1.0))])
        apart = slice(1, None, 3)  # neighbouring bins of a Hann window share their noise
        above += int(np.sum(found.multiple[apart, 0] > found.level))
        partial += int(np.sum(found.partial[apart, 0] > found.partial_level)) / n_r
        count += found.multiple[apart, 0].size
    print(f"\n{n_r}: {above / count:.4f}, partial {partial / count:.4f} of {count}")
    low, high = binom.ppf([0.0005, 0.9995], count, 0.05) / count
    # windows that share half of their samples count as their effective number: right to a fifth
    assert 0.8 * low < above / count < 1.2 * high
    assert 0.8 * low < partial / count < 1.2 * high


def test_a_closed_loop_without_noise_is_explained_in_full_and_noise_takes_over_at_high_frequency():
    rng = np.random.default_rng(4)
    r = random_switching(rng, 6000, 2, 25.0)
    quiet, loud = (
        segment_of(
            simulate(WOOD_BERRY, BLT, r, 1.0, v=coloured(np.random.default_rng(5), 6000, 2, [1, -0.8], [1], std))
        )
        for std in (1e-9, 0.3)
    )
    clear, hidden = coherence([quiet]), coherence([loud])
    assert clear.multiple.shape[1] == 4
    assert np.median(clear.multiple) > 0.97
    slow, fast = hidden.w < 0.1, hidden.w > 1.5
    assert hidden.multiple[slow, :2].mean() > 0.8
    assert hidden.multiple[fast, :2].mean() < 0.5
    opened = coherence([loud], which="u")
    assert opened.multiple.shape[1] == 2
    assert opened.which == "u"


def test_records_are_pooled_and_setpoints_that_move_alike_count_once():
    rng = np.random.default_rng(6)
    r = random_switching(rng, 2000, 1, 10.0)
    y = r + rng.standard_normal((2000, 1))
    both = coherence([segment(r, y), segment(r, y)], window=250)
    one = coherence([segment(r, y)], window=250)
    np.testing.assert_allclose(both.multiple, one.multiple, rtol=1e-9)
    assert both.windows == pytest.approx(2 * one.windows, rel=0.01)
    assert both.level < one.level
    twice = coherence([segment(np.hstack([r, r]), y)], window=250)
    np.testing.assert_allclose(twice.multiple[:, 0], one.multiple[:, 0], rtol=1e-6)
    np.testing.assert_allclose(twice.partial, 0.0, atol=1e-6)


def test_what_cannot_be_answered_is_refused():
    rng = np.random.default_rng(7)
    whole = segment(random_switching(rng, 300, 1, 10.0), rng.standard_normal((300, 1)))
    with pytest.raises(Refused, match="300 samples hold too few windows"):
        coherence([whole], window=200)
    with pytest.raises(Refused, match="30 samples hold too few windows"):
        coherence([segment(whole.r[:30], whole.y[:30])])
    with pytest.raises(Refused, match="set-point 1 does not move"):
        coherence([replace(whole, r=0 * whole.r)])
    with pytest.raises(UsageError, match="not 'y'"):
        coherence([whole], which="y")
