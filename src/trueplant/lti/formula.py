"""Formulas in s: text to transfer functions.

Rational functions of s, dead times ``exp(-theta s)``, and sums and products of them. A sum is put
over one denominator only where that does not raise the order, so what was written as a sum of
simple terms stays one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from trueplant.errors import FormulaError
from trueplant.lti import levels
from trueplant.lti.grammar import Call, Name, Node, Number, Operation, fail, parse
from trueplant.lti.printing import to_formula
from trueplant.lti.transfer import Term, TransferFunction
from trueplant.lti.transform import Transform, parse_pv

__all__ = ["Transform", "parse_pv", "require_proper", "tf", "to_formula"]

Polynomial = tuple[float, ...]
_ONE: Polynomial = (1.0,)


def tf(value: TransferFunction | str | float) -> TransferFunction:
    """Transfer function from formula text in s, a number, or a transfer function.

    ``"4 (1 - 0.9 exp(-0.5 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"``, ``"3.2 e^(-3s)/(18s+1)"``, ``"1/s"``, ``0``.
    Improper functions are accepted; see `require_proper`. Raises FormulaError with the column at fault.
    """
    if isinstance(value, TransferFunction):
        return value
    if isinstance(value, bool):
        raise FormulaError(f"a transfer function cannot be {value}; give a formula or a number")
    if isinstance(value, (int, float, np.integer, np.floating)):
        if not math.isfinite(value):
            raise FormulaError(f"a transfer function cannot be {value}; give a finite number")
        return TransferFunction.rational([float(value)])
    tree = parse(value, "s", ("exp",))
    return TransferFunction(
        tuple(
            Term(fraction.num, reduce(_product, fraction.den, _ONE), dead_time)
            for dead_time, fractions in _Reader(value).read(tree).items()
            for fraction in fractions
        )
    )


def require_proper(g: TransferFunction, what: str) -> TransferFunction:
    """``g`` itself; FormulaError, naming ``what``, if a numerator's order is above its denominator's."""
    for term in g.terms:
        if not term.is_proper:
            raise FormulaError(
                f"{what} is improper: order {len(term.num) - 1} over order {len(term.den) - 1} in {to_formula(g)}; "
                f"divide it by a filter such as (0.1 s + 1)"
            )
    return g


def _product(a: Polynomial, b: Polynomial) -> Polynomial:
    return tuple(float(c) for c in np.polymul(a, b))


@dataclass(frozen=True)
class _Fraction:
    """``num`` over the product of the polynomials ``den``, kept as they were written."""

    num: Polynomial
    den: tuple[Polynomial, ...] = ()

    def over(self, den: Counter[Polynomial]) -> Polynomial:
        """The numerator once brought to the denominator ``den``, a multiple of the own one."""
        return reduce(_product, (den - Counter(self.den)).elements(), self.num)


# Dead time to the fractions that it delays: one each for denominators of which none contains another.
_Value = dict[float, list[_Fraction]]


def _polynomial(value: _Value) -> Polynomial | None:
    """The coefficients if the value is a polynomial in s."""
    if not value:
        return (0.0,)
    first = next(iter(value.values()))
    return first[0].num if list(value) == [0.0] and len(first) == 1 and not first[0].den else None


class _Reader:
    """Walks a syntax tree; keeps the text for messages."""

    def __init__(self, text: str) -> None:
        self.text = text

    def read(self, node: Node) -> _Value:
        if isinstance(node, Number):
            return self._collected([(0.0, _Fraction((node.value,)))], node.at)
        if isinstance(node, Name):
            return {0.0: [_Fraction((1.0, 0.0))]}
        if isinstance(node, Call):
            return {self._dead_time(node): [_Fraction((1.0,))]}
        left = self.read(node.left)
        if node.sign == "^":
            return self._power(left, node)
        right = self.read(node.right)
        if node.sign == "*":
            return self._multiplied(left, right, node.at)
        if node.sign == "/":
            return self._multiplied(left, self._inverse(right, node), node.at)
        if node.sign == "-":
            right = self._multiplied(right, {0.0: [_Fraction((-1.0,))]}, node.at)
        return self._collected([(t, f) for value in (left, right) for t, fs in value.items() for f in fs], node.at)

    def _dead_time(self, node: Call) -> float:
        argument = _polynomial(self.read(node.argument))
        if argument is None or len(argument) > 2 or argument[-1] != 0:
            fail(self.text, node.at, "the argument of exp must be -theta s, as in exp(-0.5 s) or e^(-0.5 s)")
        if argument[0] > 0:
            fail(
                self.text, node.at, "this exp looks into the future; a dead time is exp(-theta s) with a positive theta"
            )
        return -argument[0] or 0.0

    def _power(self, base: _Value, node: Operation) -> _Value:
        exponent = _polynomial(self.read(node.right))
        if exponent is None or len(exponent) != 1 or not exponent[0].is_integer():
            fail(self.text, node.at, "a power must be a whole number; fractional orders are not transfer functions")
        power = exponent[0]
        if abs(power) > levels.HIGHEST_POWER:
            fail(self.text, node.at, f"power {power:g} is too high; at most {levels.HIGHEST_POWER} is read")
        if power < 0:
            base = self._inverse(base, node)
        result: _Value = {0.0: [_Fraction((1.0,))]}
        for _ in range(abs(int(power))):
            result = self._multiplied(result, base, node.at)
        return result

    def _inverse(self, value: _Value, node: Operation) -> _Value:
        """1/value, which must be one rational function."""
        if not value:
            fail(self.text, node.at, "division by zero; what follows / is 0")
        if list(value) != [0.0]:
            what = (
                "dividing by a dead time would look into the future"
                if len(value) == 1
                else ("dividing by a sum with different dead times gives no finite sum of delayed rational functions")
            )
            fail(self.text, node.at, f"{what}; only rational functions of s may stand below /")
        common = Counter[Polynomial]()
        for fraction in value[0.0]:
            common |= Counter(fraction.den)
        total = np.zeros(1)
        for fraction in value[0.0]:
            total = np.asarray(np.polyadd(total, fraction.over(common)), dtype=float)
        below = np.trim_zeros(total)
        if not below.size:
            fail(self.text, node.at, "division by zero; what follows / is 0")
        powers_of_s = len(np.trim_zeros(total, "f")) - len(below)
        den = ((1.0, 0.0),) * powers_of_s
        num = reduce(_product, common.elements(), _ONE)
        if below.size == 1:
            return {0.0: [_Fraction(tuple(c / float(below[0]) for c in num), den)]}
        return {0.0: [_Fraction(num, (*den, tuple(map(float, below))))]}

    def _multiplied(self, left: _Value, right: _Value, at: int) -> _Value:
        size = sum(map(len, left.values())) * sum(map(len, right.values()))
        if size > levels.MOST_TERMS:
            fail(self.text, at, f"multiplying out gives {size} terms; at most {levels.MOST_TERMS} are handled")
        # Sums of dead times keep the 15 digits that decimal input has: 0.2 + 0.47 is 0.67.
        return self._collected(
            [
                (float(f"{s + t:.15g}") if s and t else s + t, _Fraction(_product(a.num, b.num), a.den + b.den))
                for s, fractions in left.items()
                for t, others in right.items()
                for a in fractions
                for b in others
            ],
            at,
        )

    def _collected(self, parts: Iterable[tuple[float, _Fraction]], at: int) -> _Value:
        """Parts of equal dead time added where one denominator contains the other."""
        value: _Value = {}
        for dead_time, part in parts:
            if not math.isfinite(dead_time):
                fail(self.text, at, "the dead times add up to infinity here; use smaller numbers")
            kept = value.setdefault(dead_time, [])
            for index, other in enumerate(kept):
                small, large = Counter(part.den), Counter(other.den)
                if small <= large or large <= small:
                    common = small | large
                    total = np.polyadd(part.over(common), other.over(common))
                    part = _Fraction(tuple(float(c) for c in total), tuple(common.elements()))
                    kept.pop(index)
                    break
            part = self._checked(part, at)
            if part.num:
                kept.append(part)
        if sum(map(len, value.values())) > levels.MOST_TERMS:
            fail(self.text, at, f"more than {levels.MOST_TERMS} different terms; at most that many are handled")
        return {dead_time: fractions for dead_time, fractions in value.items() if fractions}

    def _checked(self, part: _Fraction, at: int) -> _Fraction:
        """Leading zeros dropped, powers of s cancelled; refused beyond the limits."""
        num = tuple(np.trim_zeros(part.num, "f"))
        den = sorted(part.den)
        while num and num[-1] == 0 and (1.0, 0.0) in den:
            num = num[:-1]
            den.remove((1.0, 0.0))
        order = max(len(num) - 1, sum(len(p) - 1 for p in den))
        if order > levels.HIGHEST_ORDER:
            fail(self.text, at, f"order {order} is too high; at most {levels.HIGHEST_ORDER} is handled")
        if not all(map(math.isfinite, num + sum(den, ()))):
            fail(self.text, at, "the coefficients overflow here; use smaller numbers")
        return _Fraction(num, tuple(den))
