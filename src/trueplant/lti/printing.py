"""Transfer functions to formula text that `tf` reads back."""

from __future__ import annotations

from collections.abc import Sequence

from trueplant.lti.polynomial import distinct_roots
from trueplant.lti.transfer import Term, TransferFunction


def to_formula(g: TransferFunction, digits: int = 6) -> str:
    """Readable text of ``g`` in time-constant form, numbers with so many significant digits.

    ``"-0.58 exp(-0.68 s)/(2.5 s + 1)"``; terms over one denominator share it. With 17 digits the text
    parses back to the same function up to rounding.
    """
    groups: dict[tuple[float, ...], list[Term]] = {}
    for term in g.terms:
        groups.setdefault(term.den, []).append(term)
    return _sum([_group(terms, digits) for terms in groups.values()]) or "0"


def _group(terms: list[Term], digits: int) -> str:
    """The terms over their common denominator."""
    scale, below = _factored(terms[0].den, digits)
    pieces = []
    for term in terms:
        gain, above = _factored(term.num, digits)
        number = _number(gain / scale, digits)
        delay = [_delay(term.dead_time, digits)] if term.dead_time else []
        factors = [" ".join(above).replace(") (", ")("), *delay] if above else delay
        if number in ("1", "-1") and factors:
            pieces.append(number[:-1] + " ".join(factors))
        else:
            pieces.append(" ".join([number, *factors]))
    top = _sum(pieces)
    if not below:
        return top
    bottom = " ".join(below).replace(") (", ")(")
    return f"{top if len(pieces) == 1 else f'({top})'}/{bottom if len(below) == 1 else f'({bottom})'}"


def _factored(polynomial: Sequence[float], digits: int) -> tuple[float, list[str]]:
    """Constant and factors: s, (T s + 1), (a s^2 + b s + 1), each with its power."""
    roots = distinct_roots(polynomial)
    # Far beyond any plant, time constants or their squares would overflow.
    if roots is None or any(p and not 1e-150 < abs(p) < 1e150 for p, _ in roots):
        return 1.0, [f"({_polynomial(polynomial, digits)})"]
    constant, factors = float(polynomial[0]), []
    for root, multiplicity in sorted(roots, key=lambda r: (r[0] != 0, -abs(r[0]) or 0.0)):
        power = f"^{multiplicity}" if multiplicity > 1 else ""
        if root == 0:
            factors.append(f"s{power}")
            continue
        if root.imag == 0:
            constant *= abs(root.real) ** multiplicity
            coefficients = [1 / abs(root.real), -1.0 if root.real > 0 else 1.0]
        else:
            size = abs(root) ** 2
            constant *= size**multiplicity
            coefficients = [1 / size, -2 * root.real / size, 1.0]
        factors.append(f"({_polynomial(coefficients, digits)}){power}")
    return constant, factors


def _polynomial(coefficients: Sequence[float], digits: int) -> str:
    pieces = []
    for power, coefficient in zip(range(len(coefficients) - 1, -1, -1), coefficients, strict=True):
        if coefficient == 0:
            continue
        number = _number(coefficient, digits)
        variable = ("", "s")[power] if power < 2 else f"s^{power}"
        if variable and number in ("1", "-1"):
            pieces.append(number[:-1] + variable)
        else:
            pieces.append(f"{number} {variable}".rstrip())
    return _sum(pieces)


def _delay(dead_time: float, digits: int) -> str:
    number = _number(dead_time, digits)
    return "exp(-s)" if number == "1" else f"exp(-{number} s)"


def _sum(pieces: Sequence[str]) -> str:
    text = " + ".join(pieces)
    return text.replace("+ -", "- ")


def _number(value: float, digits: int) -> str:
    # Beyond 16 digits the shortest text that reads back exactly is the better one.
    return repr(float(value)).removesuffix(".0") if digits > 16 else f"{value:.{digits}g}"


def to_latex(g: TransferFunction, digits: int = 4) -> str:
    """LaTeX of ``g`` in time-constant form, without dollar signs: ``\\frac{3.2}{18 s + 1} e^{-3 s}``."""
    parts = [_latex_term(term, digits) for term in g.terms]
    return _sum(parts) or "0"


def _latex_term(term: Term, digits: int) -> str:
    (gain, above), (scale, below) = _factored(term.num, digits), _factored(term.den, digits)
    number = _number(gain / scale, digits)
    sign, number = ("-", number[1:]) if number.startswith("-") else ("", number)
    top = " ".join(([] if number == "1" and above else [number]) + above)
    text = f"\\frac{{{top}}}{{{_bare(below)}}}" if below else top
    return f"{sign}{text} e^{{{_delay(term.dead_time, digits)[4:-1]}}}" if term.dead_time else f"{sign}{text}"


def _bare(factors: Sequence[str]) -> str:
    """The factors side by side; one alone needs no brackets."""
    if len(factors) == 1 and factors[0].startswith("(") and factors[0].endswith(")"):
        return factors[0][1:-1]
    return " ".join(factors)
