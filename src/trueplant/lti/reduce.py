"""Sums and differences of transfer functions in lowest terms, as far as the dead times allow.

Rounding is told from structure by the natural scale: the size that a quantity would have if
nothing in it cancelled. What is below 1e-12 of that is rounding and becomes an exact zero.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import reduce

import numpy as np

from trueplant.arrays import Array
from trueplant.lti import levels
from trueplant.lti.polynomial import distinct_roots, natural_scale
from trueplant.lti.transfer import Term, TransferFunction, TransferMatrix

Factor = tuple[float, ...]


def simplified(g: TransferFunction) -> TransferFunction:
    """The same function with terms of equal dead time over one denominator, common roots cancelled.

    Terms of different dead time stay apart. Values agree with those of ``g`` to 1e-9 of the terms' size.
    """
    groups: list[list[Term]] = []
    for term in sorted(g.terms, key=lambda t: t.dead_time):
        last = groups[-1][0].dead_time if groups else -1.0
        if groups and term.dead_time - last <= levels.SAME_DEAD_TIME * last:
            groups[-1].append(term)
        else:
            groups.append([term])
    return TransferFunction(tuple(_lowest(group) for group in groups))


def simplified_matrix(g: TransferMatrix) -> TransferMatrix:
    """`simplified`, element by element."""
    return TransferMatrix(tuple(tuple(simplified(element) for element in row) for row in g.elements), g.time_unit)


def _lowest(terms: Sequence[Term]) -> Term:
    """One term equal to the sum of terms of one dead time."""
    known: list[Factor] = []
    owned = [_factored(term.den, known) for term in terms]
    common: Counter[Factor] = reduce(lambda a, b: a | b, owned)
    num: Array = np.zeros(1)
    scale: Array = np.zeros(1)
    for term, own in zip(terms, owned, strict=True):
        cofactor = _multiplied(common - own)
        num = np.asarray(np.polyadd(num, np.convolve(term.num, cofactor)), dtype=float)
        scale = np.asarray(
            np.polyadd(scale, np.convolve(natural_scale(term.num), natural_scale(cofactor))), dtype=float
        )
    num = np.trim_zeros(np.where(np.abs(num) <= levels.ROUNDING * scale, 0.0, num), "f")
    if not num.size:
        return Term((0.0,))
    den = np.convolve(terms[0].den, _multiplied(common - owned[0]))
    left = common.copy()
    reduced = num
    for factor, multiplicity in common.items():
        reduced, times = _divided(reduced, factor, multiplicity, num, scale)
        left[factor] -= times
    if left != common:
        num = np.where(np.abs(reduced) <= levels.ROUNDING * natural_scale(reduced), 0.0, reduced)
        den = _multiplied(left)
    return Term(tuple(num), tuple(den), terms[0].dead_time)


def _factored(polynomial: Sequence[float], known: list[Factor]) -> Counter[Factor]:
    """Monic factors with multiplicity; a factor already ``known`` is taken for a new one that equals it.

    A polynomial whose roots cannot be trusted is its own only factor.
    """
    roots = distinct_roots(polynomial)
    if roots is None:
        factors = [(tuple(polynomial), 1)]
    else:
        factors = [((1.0, -p.real) if p.imag == 0 else (1.0, -2 * p.real, abs(p) ** 2), m) for p, m in roots]
    counts: Counter[Factor] = Counter()
    for factor, multiplicity in factors:
        twin = next((k for k in known if _equal(k, factor)), None)
        if twin is None:
            known.append(factor)
        counts[twin or factor] += multiplicity
    return counts


def _equal(a: Factor, b: Factor) -> bool:
    if len(a) != len(b):
        return False
    radius = abs(a[-1]) ** (1 / (len(a) - 1))
    return bool(np.all(np.abs(np.subtract(a, b)) <= levels.SAME_FACTOR * radius ** np.arange(len(a))))


def _multiplied(factors: Counter[Factor]) -> Array:
    return reduce(np.convolve, factors.elements(), np.ones(1))


def _divided(num: Array, factor: Factor, at_most: int, whole: Array, scale: Array) -> tuple[Array, int]:
    """``num`` divided by ``factor`` while its roots are zeros of num up to rounding, and how often that was.

    ``scale`` is the natural scale of ``whole``, the numerator before any division: where much cancelled
    in it, its zeros are known that much less surely.
    """
    roots = np.roots(factor)
    radius = np.abs(roots)
    with np.errstate(divide="ignore", invalid="ignore"):
        rounding = levels.ROUNDING * np.nan_to_num(
            np.polyval(scale, radius) / np.polyval(np.abs(whole), radius), nan=1.0
        )
    times = 0
    while times < at_most and len(num) >= len(factor):
        if np.any(np.abs(np.polyval(num, roots)) > rounding * np.polyval(np.abs(num), radius)):
            break
        num = np.asarray(np.polydiv(num, factor)[0], dtype=float)
        times += 1
    return num, times
