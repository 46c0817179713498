"""Tests of residuals beside whiteness and the inputs: they are reported, and no verdict rests on them."""

from __future__ import annotations

from collections.abc import Callable

from trueplant.identify.fit import RowFit
from trueplant.identify.sandwich import homoscedastic_p

RESIDUAL_TESTS: dict[str, Callable[[RowFit], float]] = {
    "constant variance": homoscedastic_p,
}
"""By name: the p-value that the prediction errors of a fit are as the test expects them."""
