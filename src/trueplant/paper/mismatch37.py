"""The mismatch (37) of the mill, element by element, and the contradiction between (34) and (37)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trueplant.lti import Term, TransferFunction, TransferMatrix
from trueplant.paper.entry import Entry, Value, rounds_to

FACTOR = {"printed": "1.1014 as (34) prints it", "eq37": "1.0137 as (37) implies"}

PRINTED_37: dict[tuple[int, int], tuple[tuple[str, ...], tuple[str, ...], str]] = {
    (0, 0): (("0.0232",), ("1", "0.9", "0.2"), "0.68"),
    (0, 1): (("-0.0066",), ("1", "0.667", "0.0833"), "0.67"),
    (1, 0): (("-0.0333",), ("1", "0.3182", "0.0253"), "0.6"),
    (1, 1): (("-0.0809",), ("1", "0.2857"), "0.13"),
}
"""Numerators, denominators and dead times of (37), in descending powers of s, as printed."""


def mismatch(model: TransferMatrix, plants: dict[str, TransferMatrix]) -> Iterator[Entry]:
    """(37) element by element; only g12 differs between the variants."""
    for i, j in PRINTED_37:
        yield _element_37(f"eq37.delta{i + 1}{j + 1}", i, j, _one_fraction(plants["printed"][i, j], model[i, j]))
    name = "eq37.delta12.eq37"
    yield _element_37(name, 0, 1, _one_fraction(plants["eq37"][0, 1], model[0, 1]), "eq37")
    # the factor that gives (37)'s numerator: 4 (0.9938 - f)/12 = -0.0066
    implied = 0.9938 + 0.0066 * 12 / 4
    yield Entry(
        "eq34.factor",
        "factor of the recycled term in (34) that gives the element (1, 2) printed in (37)",
        "1.1014",
        implied,
        rounds_to("1.1014", implied),
        "to within the rounding of -0.0066 (0.00015 in the factor); 0.9938 raised by 2 % is 1.0137. Very likely "
        "1.1014 is "
        "a misprint: both variants are computed here",
    )
    s = 1j * np.geomspace(0.01, 6, 50)
    delta = TransferMatrix(tuple(tuple(_printed_37(i, j) for j in range(2)) for i in range(2)))
    lead = {
        name: float(np.max(np.abs(model(s) + delta(s) - target(s)) / np.abs(model(s))))
        for name, target in {"(22) - (25)": model, "(33) - (36)": plants["eq37"]}.items()
    }
    nearest = min(lead, key=lambda name: lead[name])
    yield Entry(
        "eq37.reference",
        "the plant that the model plus (37) leads to",
        "(22) - (25)",
        nearest,
        nearest == "(22) - (25)",
        "the sentence after (37) should name (33) - (36). Largest difference of model plus (37), with the s that "
        "is missing "
        "in its element (2, 1), relative to the model's element: "
        + ", ".join(f"{distance:.2g} from {name}" for name, distance in lead.items()),
    )


def _printed_37(i: int, j: int) -> TransferFunction:
    """An element of (37) with its printed digits, the missing s of element (2, 1) put in."""
    num, den, dead = PRINTED_37[i, j]
    above = [float(c) for c in num] + ([0.0] if (i, j) == (1, 0) else [])
    return TransferFunction.rational(above, [float(c) for c in den], float(dead))


def _one_fraction(plant: TransferFunction, model: TransferFunction) -> TransferFunction:
    """plant - model over one denominator for each dead time; terms whose numerators cancel are dropped."""
    by_delay: dict[float, Term] = {}
    for term in (plant - model).terms:
        near = next((d for d in by_delay if abs(d - term.dead_time) < 1e-9), term.dead_time)
        old = by_delay.get(near)
        if old is None:
            by_delay[near] = Term(term.num, term.den, near)
        else:
            num = np.polyadd(np.polymul(old.num, term.den), np.polymul(term.num, old.den))
            num[np.abs(num) < 1e-12 * np.max(np.abs(np.polymul(old.num, term.den)))] = 0.0
            by_delay[near] = Term(tuple(num), tuple(np.polymul(old.den, term.den)), near)
    kept = [t for t in by_delay.values() if np.max(np.abs(t.num)) > 1e-12]
    return TransferFunction(tuple(kept))


def _element_37(id: str, i: int, j: int, delta: TransferFunction, variant: str = "printed") -> Entry:
    (term,) = delta.terms
    num, den, dead = PRINTED_37[i, j]
    shape = len(term.num) == len(num) and len(term.den) == len(den)
    numbers = (*term.num, *term.den, term.dead_time)
    agrees = shape and all(rounds_to(text, number) for text, number in zip((*num, *den, dead), numbers, strict=True))
    computed: Value = {"numerator": list(term.num), "denominator": list(term.den), "dead_time": term.dead_time}
    note = "coefficients in descending powers of s; tolerance: half a unit of the last printed digit of each"
    if (i, j) == (0, 1):
        note = f"with {FACTOR[variant]}; {note}"
    if (i, j) == (1, 0):
        note = f"the printed numerator lacks a factor s, for the gains of (24) and (35) are equal; {note}"
    printed = f"{' '.join(num)} exp(-{dead} s)/({_polynomial(den)})"
    return Entry(id, f"mismatch of the mill's element ({i + 1}, {j + 1})", printed, computed, agrees, note)


def _polynomial(den: tuple[str, ...]) -> str:
    powers = {2: ("s^2", "s", ""), 1: ("s", "")}[len(den) - 1]
    return " + ".join(f"{'' if c == '1' else c + ' '}{p}".strip() for c, p in zip(den, powers, strict=True))
