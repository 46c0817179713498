"""Does a parametric plant lie within the band that the data leave to any plant?

The local frequency response knows no structure. Where the plant as estimated lies outside its band, the structure
is too simple (or the plant not linear), and small standard errors of its parameters mean nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher

from trueplant.arrays import Array
from trueplant.lti.transfer import TransferMatrix
from trueplant.mismatch import levels
from trueplant.mismatch.local import FrequencyResponse
from trueplant.mismatch.sampling import sampled_frequency_response


@dataclass(frozen=True, eq=False)
class BandTest:
    """For each element (n_y, n_u); NaN where no window of frequencies can be trusted."""

    p_value: Array
    """That the plant is the one behind the data."""
    worst: Array
    """Frequency (rad per time unit) of the window that fits least."""


def within_band(response: FrequencyResponse, plant: TransferMatrix) -> BandTest:
    """Test each element of `plant` against the non-parametric response over all frequencies.

    In each window of p frequencies d* C^-1 d / p, with d the difference and C its covariance estimated with nu complex
    degrees of freedom, has the F distribution with 2 p and 2 nu degrees; the windows are independent and joined by
    Fisher's method. The plant may have been estimated from the same data: it then lies a little closer than chance.
    """
    n_p, (n_y, n_u) = response.points, response.sampled.shape[1:]
    trusted = response.reliable.reshape(-1, n_p).all(axis=1)
    p_value, worst = np.full((n_y, n_u), np.nan), np.full((n_y, n_u), np.nan)
    if not trusted.any():
        return BandTest(p_value, worst)
    expected = sampled_frequency_response(plant, response.w, response.h, response.hold)
    apart = (response.sampled - expected).reshape(-1, n_p, n_y, n_u)[trusted]
    size = np.abs(response.sampled).reshape(-1, n_p, n_y, n_u)[trusted]
    middle = response.w.reshape(-1, n_p)[trusted].mean(axis=1)
    for i in range(n_y):
        for j in range(n_u):
            covariance = response.covariance[trusted][..., i, j]
            allowed = (levels.BAND_NEGLIGIBLE * size[..., i, j]) ** 2
            covariance = covariance + np.eye(n_p) * allowed[:, :, None]
            d = apart[..., i, j]
            distance = np.einsum("wp,wp->w", d.conj(), np.linalg.solve(covariance, d[..., None])[..., 0]).real
            p = fisher.sf(np.maximum(distance, 0.0) / n_p, 2 * n_p, 2 * response.dof)
            p_value[i, j] = chi2.sf(-2 * np.sum(np.log(np.maximum(p, 1e-300))), 2 * p.size)
            worst[i, j] = middle[int(np.argmin(p))]
    return BandTest(p_value, worst)
