"""Correlations in place of sums of products written out, against those sums."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.identify.lagged import at_samples, gram_of_past, moments_of_past, with_past

ORDER, N = 12, 200


@pytest.mark.parametrize("gaps", [(), (3, 60, 61, 150), tuple(range(40, 120))])
def test_sums_of_products_with_the_past(gaps):
    rng = np.random.default_rng(2)
    past, rows = 5 + rng.standard_normal(N), rng.standard_normal((3, N - ORDER))
    whole = ~np.isin(np.arange(N - ORDER), gaps)
    lags = np.array([past[ORDER - i : N - i] for i in range(1, ORDER + 1)])[:, whole]
    use = whole if gaps else slice(0, None)
    found = with_past(at_samples(rows[:, whole], use, ORDER, N), past, ORDER)
    assert np.allclose(found, rows[:, whole] @ lags.T, rtol=0, atol=1e-11 * N)
    assert np.allclose(gram_of_past(past, use, ORDER), lags @ lags.T, rtol=1e-12)
    moment, gram = moments_of_past(past, use, ORDER)
    assert np.allclose(moment, lags @ past[ORDER:][whole], rtol=1e-12)
    assert np.allclose(gram, lags @ lags.T, rtol=1e-12)


def test_each_row_has_a_past_of_its_own():
    rng = np.random.default_rng(3)
    now, past = rng.standard_normal((4, N)), rng.standard_normal((4, N))
    now[:, :ORDER] = 0.0
    expected = [[now[k, ORDER:] @ past[k, ORDER - i : N - i] for i in range(1, ORDER + 1)] for k in range(4)]
    assert np.allclose(with_past(now, past, ORDER), expected, rtol=0, atol=1e-11)


def test_samples_may_begin_late():
    past = np.random.default_rng(4).standard_normal(N)
    lags = np.array([past[ORDER + 30 - i : N - i] for i in range(1, ORDER + 1)])
    assert np.allclose(gram_of_past(past, slice(30, None), ORDER), lags @ lags.T, rtol=0, atol=1e-11)
