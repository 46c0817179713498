"""How far the elements are known as a whole, and what their standard errors are made of, as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trueplant.report.numbers import MISSING, interval, number, to_precision
from trueplant.result import Derived, Element, Source

MEANING = {
    Source.NOISE: "chance, as the prediction errors show it",
    Source.SLOW_NOISE: "noise so slow that the record shows little of it",
    Source.START: "the state of the plant where the record begins, and after gaps",
    Source.COLOUR: "noise that comes and goes, or that its model does not describe",
    Source.EXPERIMENTS: "how far one experiment differs from another",
    Source.NOISE_MODEL: "how far another order of the noise model moves the answer",
    Source.LEFT_OUT: "a dead time that may be there, too short for the record to show",
    Source.NOT_SHOWN: "how far elements that the record does not show would move it, were they there",
    Source.STRUCTURE: "a richer structure, which suits the record too, has another gain or time to answer",
    Source.ROUNDING: "recorded numbers and instants are rounded",
    Source.MINIMA: "other sets of parameters that the record does not rule out",
    Source.PROFILE: "the interval reaches further to one side than the standard error by itself would say",
    Source.SHARED_DISTURBANCE: "a disturbance that reaches several outputs",
    Source.DISTURBANCE: "the disturbance that the project declares and nobody measured",
    Source.HOLD: "how a measured disturbance runs between its samples",
    Source.HISTORIAN: "how PV ran between the samples that the historian stored",
    Source.VALVE: "whether the valve follows OP, and if not, how far",
}
QUANTITIES = {"net_gain": "net gain", "net_slope": "net slope", "total_delay": "total delay"}


@dataclass(frozen=True)
class KnownRow:
    """One quantity of an element as text."""

    name: str
    unit: str
    where: str
    model: str
    plant: str
    interval: str
    reason: str


@dataclass(frozen=True)
class BudgetTable:
    """Shares in percent; a source that is nowhere as much as 1 % has no column."""

    sources: tuple[tuple[str, str], ...]
    """Name and meaning of each column."""
    elements: tuple[tuple[str, tuple[BudgetRow, ...]], ...]


@dataclass(frozen=True)
class BudgetRow:
    """What the standard error of one parameter is made of."""

    name: str
    error: str
    unit: str
    percents: tuple[int, ...]


def known_table(elements: Sequence[Element]) -> list[tuple[str, list[KnownRow]]]:
    """The quantities of each element that has any, by its name."""
    return [(_name(e), [_known(one, e.reason) for one in e.derived]) for e in elements if e.derived]


def _known(one: Derived, said: str) -> KnownRow:
    """`said`: of the element, above its parameters."""
    where = "at rest" if one.at == "rest" else f"at {number(one.frequency, 3)} ({one.at})"
    return KnownRow(
        QUANTITIES.get(one.name, one.name),
        one.unit,
        where,
        to_precision(one.model, one.std_error),
        to_precision(one.plant, one.std_error),
        interval(*one.ci, resolution=one.std_error) if one.ci is not None else MISSING,
        "as above" if one.reason and one.reason in said else one.reason,
    )


def budget_table(elements: Sequence[Element]) -> BudgetTable:
    """Only parameters that are answered have a row."""
    found = [
        (e, {b.parameter: {part.source: round(100 * part.share) for part in b.parts} for b in e.budget})
        for e in elements
        if e.budget
    ]
    shown = [s for s in Source if any(parts.get(s, 0) for _, budgets in found for parts in budgets.values())]
    return BudgetTable(
        tuple((source.value, MEANING[source]) for source in shown),
        tuple(
            (
                _name(e),
                tuple(
                    BudgetRow(
                        p.name.replace("_", " "),
                        number(p.std_error, 2),
                        p.unit,
                        tuple(budgets[p.name].get(source, 0) for source in shown),
                    )
                    for p in e.parameters
                    if p.name in budgets
                ),
            )
            for e, budgets in found
        ),
    )


def _name(element: Element) -> str:
    return f"{element.input} → {element.output}"
