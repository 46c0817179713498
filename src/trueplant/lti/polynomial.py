"""Roots of real polynomials that can be trusted: every factorisation is checked by multiplying out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueplant.arrays import ComplexArray
from trueplant.lti import levels


def natural_scale(coefficients: ArrayLike) -> NDArray[np.float64]:
    """Size that each coefficient would have if the roots' contributions never cancelled, descending powers."""
    polynomial = np.trim_zeros(np.asarray(coefficients, dtype=float), "f")
    radii = np.abs(np.roots(polynomial))
    return np.asarray(
        np.abs(polynomial[:1]) * np.abs(np.poly(-radii)) if len(radii) else np.abs(polynomial), dtype=float
    )


def distinct_roots(coefficients: Sequence[float]) -> list[tuple[complex, int]] | None:
    """Roots with multiplicity; of a complex pair only the one above the real axis.

    Roots at zero are exact. None if no set of roots multiplies back to the polynomial up to rounding,
    relative to the natural scale of each coefficient.
    """
    trimmed = np.trim_zeros(np.asarray(coefficients, dtype=float), "b")
    at_zero = len(coefficients) - len(trimmed)
    found = np.roots(trimmed).astype(complex)
    scale = natural_scale(trimmed)
    for circle in levels.SCATTER:
        clusters = _clustered(found, circle)
        pairs = [(p, m) for p, m in clusters if p.imag >= 0]
        if sum(m * (1 if p.imag == 0 else 2) for p, m in pairs) != len(found):
            continue
        product = np.abs(multiplied_out(trimmed[0], pairs) - trimmed)
        if np.all(product <= levels.MULTIPLIED_OUT * scale):
            return ([(0j, at_zero)] if at_zero else []) + pairs
    return None


def multiplied_out(lead: float, roots: Sequence[tuple[complex, int]]) -> NDArray[np.float64]:
    """Polynomial from its leading coefficient and what `distinct_roots` returns."""
    product = np.array([lead], dtype=float)
    for root, multiplicity in roots:
        factor = [1.0, -root.real] if root.imag == 0 else [1.0, -2 * root.real, abs(root) ** 2]
        for _ in range(multiplicity):
            product = np.convolve(product, factor)
    return product


def _clustered(roots: ComplexArray, circle: float) -> list[tuple[complex, int]]:
    clusters: list[list[complex]] = []
    for root in roots:
        near = [c for c in clusters if abs(np.mean(c) - root) <= circle * abs(root)]
        if near:
            near[0].append(root)
        else:
            clusters.append([root])
    means = [(complex(np.mean(c)), len(c)) for c in clusters]
    return [(complex(p.real) if abs(p.imag) <= circle * abs(p) else p, m) for p, m in means]
