"""Transfer functions and matrices with exact dead time.

A transfer function is a sum of terms ``B(s)/A(s) exp(-theta s)``; a matrix holds one in each
element. Nothing is approximated: the response at any complex s is evaluated term by term, and
matrices are combined through their responses, never symbolically.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import FormulaError


def _trimmed(polynomial: ArrayLike) -> tuple[float, ...]:
    """Coefficients in descending powers without leading zeros, at least one."""
    coefficients = np.atleast_1d(np.asarray(polynomial, dtype=float)).ravel()
    if coefficients.size == 0 or not np.all(np.isfinite(coefficients)):
        raise FormulaError("a polynomial needs finite coefficients; correct the transfer function")
    return tuple(float(c) for c in np.trim_zeros(coefficients, "f")) or (0.0,)


@dataclass(frozen=True)
class Term:
    """``num(s)/den(s) exp(-dead_time s)``; coefficients in descending powers of s."""

    num: tuple[float, ...]
    den: tuple[float, ...] = (1.0,)
    dead_time: float = 0.0

    def __post_init__(self) -> None:
        num, den = _trimmed(self.num), _trimmed(self.den)
        if den == (0.0,):
            raise FormulaError("division by zero: the denominator of a term is 0")
        if not (np.isfinite(self.dead_time) and self.dead_time >= 0):
            raise FormulaError(f"dead time must be 0 or more, not {self.dead_time:g}: exp(-theta s) only delays")
        lead = den[0]
        num, den = tuple(c / lead for c in num), tuple(c / lead for c in den)
        if not np.all(np.isfinite(num + den)):
            raise FormulaError("a transfer function's coefficients overflow; express it in other units")
        object.__setattr__(self, "num", num)
        object.__setattr__(self, "den", den)
        object.__setattr__(self, "dead_time", float(self.dead_time))

    def __call__(self, s: ArrayLike) -> ComplexArray:
        z = np.asarray(s, dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.polyval(self.num, z) / np.polyval(self.den, z) * np.exp(-self.dead_time * z), complex)

    @property
    def is_proper(self) -> bool:
        return len(self.num) <= len(self.den)

    @property
    def is_zero(self) -> bool:
        return self.num == (0.0,)


@dataclass(frozen=True)
class TransferFunction:
    """A sum of `Term`. The empty sum is zero. Compares by its terms, not by its values."""

    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        merged: dict[tuple[tuple[float, ...], float], Term] = {}
        for term in self.terms:
            key = (term.den, term.dead_time)
            if key in merged:
                term = Term(tuple(np.polyadd(merged[key].num, term.num)), term.den, term.dead_time)
            merged[key] = term
        object.__setattr__(self, "terms", tuple(t for t in merged.values() if not t.is_zero))

    @classmethod
    def rational(cls, num: ArrayLike, den: ArrayLike = 1.0, dead_time: float = 0.0) -> TransferFunction:
        """``num/den exp(-dead_time s)``; coefficients in descending powers."""
        return cls((Term(_trimmed(num), _trimmed(den), dead_time),))

    def __call__(self, s: ArrayLike) -> ComplexArray:
        """Response at any complex s, of the shape of s."""
        z = np.asarray(s, dtype=complex)
        return sum((term(z) for term in self.terms), np.zeros(z.shape, dtype=complex))

    def __add__(self, other: TransferFunction | float) -> TransferFunction:
        return TransferFunction(self.terms + _as_transfer_function(other).terms)

    __radd__ = __add__

    def __neg__(self) -> TransferFunction:
        return self * -1.0

    def __sub__(self, other: TransferFunction | float) -> TransferFunction:
        return self + (-_as_transfer_function(other))

    def __rsub__(self, other: TransferFunction | float) -> TransferFunction:
        return _as_transfer_function(other) + (-self)

    def __mul__(self, other: TransferFunction | float) -> TransferFunction:
        return TransferFunction(
            tuple(
                Term(tuple(np.polymul(a.num, b.num)), tuple(np.polymul(a.den, b.den)), a.dead_time + b.dead_time)
                for a in self.terms
                for b in _as_transfer_function(other).terms
            )
        )

    __rmul__ = __mul__

    @property
    def is_zero(self) -> bool:
        return not self.terms

    @property
    def is_proper(self) -> bool:
        return all(term.is_proper for term in self.terms)

    @property
    def dc_gain(self) -> float:
        """Limit for s -> 0 from above; infinite with an integrator that no other term cancels.

        Read off the Laurent series of the sum about 0, so (1 - exp(-s))/s has the gain 1.
        """
        order = max((_integrators(term.den) for term in self.terms), default=0)
        series, size = np.zeros(order + 1), np.zeros(order + 1)
        for term in self.terms:
            first = order - _integrators(term.den)
            coefficients, scale = _taylor(term, order + 1 - first)
            series[first:] += coefficients
            size[first:] += scale
        series[np.abs(series) <= 1e-12 * size] = 0.0
        integrating = np.flatnonzero(series[:-1])
        return float(np.copysign(np.inf, series[integrating[0]]) if integrating.size else series[-1])

    @property
    def poles(self) -> ComplexArray:
        """Poles of all terms, repeated denominators counted once."""
        dens = dict.fromkeys(t.den for t in self.terms)
        return np.concatenate([np.roots(d).astype(complex) for d in dens]) if dens else np.zeros(0, complex)

    def __str__(self) -> str:
        from trueplant.lti.printing import to_formula

        return to_formula(self)

    def _repr_latex_(self) -> str:
        from trueplant.lti.printing import to_latex

        return f"${to_latex(self)}$"


def _integrators(den: tuple[float, ...]) -> int:
    return len(den) - len(np.trim_zeros(den, "b"))


def _taylor(term: Term, count: int) -> tuple[Array, Array]:
    """The first coefficients of s^k term(s) about 0, k its integrators, and their sizes without cancellation."""
    num, den = np.array(term.num[::-1]), np.trim_zeros(np.array(term.den[::-1]), "f")
    powers = np.arange(1, count)
    delay = np.cumprod(np.concatenate([[1.0], -term.dead_time / powers]))
    inverse = np.zeros(count)
    inverse[0] = 1 / den[0]
    for k in powers:
        past = den[1 : k + 1]
        inverse[k] = -past @ inverse[k - len(past) : k][::-1] / den[0]
    exact = np.convolve(np.convolve(num, delay), inverse)
    size = np.convolve(np.convolve(np.abs(num), np.abs(delay)), np.abs(inverse))
    return exact[:count], size[:count]


def _as_transfer_function(value: TransferFunction | float) -> TransferFunction:
    return value if isinstance(value, TransferFunction) else TransferFunction.rational([float(value)])


@dataclass(frozen=True)
class TransferMatrix:
    """n_y by n_u transfer functions, rows are outputs; names and time unit for display only."""

    elements: tuple[tuple[TransferFunction, ...], ...]
    time_unit: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        rows = tuple(tuple(row) for row in self.elements)
        if not rows or not rows[0] or any(len(row) != len(rows[0]) for row in rows):
            raise FormulaError("a transfer matrix needs rows of equal, non-zero length")
        object.__setattr__(self, "elements", rows)

    @classmethod
    def of(cls, rows: Iterable[Sequence[TransferFunction | str | float]], time_unit: str = "") -> TransferMatrix:
        """From rows of transfer functions, formulas or numbers."""
        from trueplant.lti.formula import tf

        return cls(tuple(tuple(tf(cell) for cell in row) for row in rows), time_unit)

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.elements), len(self.elements[0])

    def __getitem__(self, index: tuple[int, int]) -> TransferFunction:
        return self.elements[index[0]][index[1]]

    def __call__(self, s: ArrayLike) -> ComplexArray:
        """Response at the complex points s (n_s,): array (n_s, n_y, n_u)."""
        z = np.atleast_1d(np.asarray(s, dtype=complex))
        value = np.zeros((z.size, *self.shape), dtype=complex)
        for i, row in enumerate(self.elements):
            for j, element in enumerate(row):
                if not element.is_zero:
                    value[:, i, j] = element(z)
        return value

    def columns(self, start: int = 0, stop: int | None = None) -> TransferMatrix:
        """The columns from `start` to before `stop`, such as those of the inputs without the disturbances."""
        return TransferMatrix(tuple(row[start:stop] for row in self.elements), self.time_unit)

    def _combine(self, other: TransferMatrix, sign: float) -> TransferMatrix:
        if self.shape != other.shape:
            raise FormulaError(f"matrices of shape {self.shape} and {other.shape} cannot be added")
        return TransferMatrix(
            tuple(
                tuple(a + b * sign for a, b in zip(x, y, strict=True))
                for x, y in zip(self.elements, other.elements, strict=True)
            ),
            self.time_unit,
        )

    def __add__(self, other: TransferMatrix) -> TransferMatrix:
        return self._combine(other, 1.0)

    def __sub__(self, other: TransferMatrix) -> TransferMatrix:
        return self._combine(other, -1.0)

    def __str__(self) -> str:
        return "\n".join(", ".join(str(element) for element in row) for row in self.elements)

    def _repr_latex_(self) -> str:
        from trueplant.lti.printing import to_latex

        rows = r" \\ ".join(" & ".join(to_latex(element) for element in row) for row in self.elements)
        return rf"$\begin{{bmatrix}} {rows} \end{{bmatrix}}$"

    @property
    def dc_gain(self) -> Array:
        """Values at s = 0, (n_y, n_u)."""
        return np.array([[element.dc_gain for element in row] for row in self.elements])
