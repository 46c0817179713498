"""How many poles and zeros an element needs, with the reason for the choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.errors import Refused
from trueplant.identify import levels
from trueplant.identify.instrumental.noise import ArmaNoise, fit_arma
from trueplant.identify.instrumental.open_loop import best_from_guesses
from trueplant.identify.instrumental.order import Order
from trueplant.identify.instrumental.refine import Refined, refine
from trueplant.identify.instrumental.result import PolynomialFit, finished
from trueplant.identify.instrumental.samples import Samples, samples_of
from trueplant.record.types import Segment


@dataclass(frozen=True)
class Candidate:
    """One structure of one element, and how it does."""

    order: Order
    bic: float
    """-2 log likelihood + log(samples) coefficients, up to a constant; less is better."""
    fit_percent: float
    """100 (1 - |y - yhat|/|y - mean y|)."""


@dataclass(frozen=True, eq=False)
class OrderChoice:
    """The chosen orders, one an element, with their fit and why."""

    orders: tuple[Order, ...]
    fit: PolynomialFit
    candidates: tuple[tuple[Candidate, ...], ...]
    """For each element, best first, the others as chosen."""
    reason: str


def choose_orders(
    segments: Sequence[Segment],
    output: int,
    columns: Sequence[int],
    dead_time: float | tuple[float, float] | None = None,
    listed: Sequence[tuple[int, int, int]] = levels.ORDERS,
) -> OrderChoice:
    """Poles, zeros and integrators of the element from each of the `columns`, by a criterion over a short list.

    Elements are chosen in turn, the others kept, until nothing changes. All candidates are weighed by the Bayesian
    criterion with one autoregressive noise model (in closed loop too, where the output error alone would choose too
    much); the dead time is estimated for each.

    Raises Refused where nothing on the list can be fitted.
    """
    samples = samples_of(segments, output)
    orders = [_listed(column, listed[0], dead_time) for column in columns]
    noise = _whitening(orders, samples)
    tables: list[tuple[Candidate, ...]] = [() for _ in columns]
    for _ in range(2 if len(columns) > 1 else 1):
        before = list(orders)
        for k, column in enumerate(columns):
            found: list[Candidate] = []
            for one in listed:
                trial = [*orders[:k], _listed(column, one, dead_time), *orders[k + 1 :]]
                candidate = _weighed(trial, k, samples, noise)
                if candidate is not None:
                    found.append(candidate)
            if not found:
                raise Refused(
                    f"none of {len(listed)} structures of input {column + 1} could be fitted to output {output + 1}"
                )
            tables[k] = tuple(sorted(found, key=lambda c: c.bic))
            orders[k] = tables[k][0].order
            noise = _whitening(orders, samples)
        if orders == before:
            break
    refined = refine(orders, best_from_guesses(orders, samples).theta, samples, noise=noise)
    reason = "; ".join(_said(table) for table in tables)
    return OrderChoice(tuple(orders), finished("RIVC", orders, samples, refined, noise), tuple(tables), reason)


def _listed(column: int, one: tuple[int, int, int], dead_time: float | tuple[float, float] | None) -> Order:
    poles, zeros, integrators = one
    return Order(column, poles, zeros, dead_time if poles > zeros else 0.0, integrators)


def _whitening(orders: Sequence[Order], samples: Sequence[Samples]) -> ArmaNoise:
    point = best_from_guesses(orders, samples).point
    return fit_arma(point.raw, [s.valid for s in samples], levels.ORDER_WHITENING, 0)


def _weighed(orders: Sequence[Order], k: int, samples: Sequence[Samples], noise: ArmaNoise) -> Candidate | None:
    try:
        begun = best_from_guesses(orders, samples)
        refined = refine(orders, begun.theta, samples, noise=noise)
    except (Refused, np.linalg.LinAlgError):
        return None
    point = refined.point
    if not np.isfinite(point.cost) or point.cost <= 0:
        return None
    bic = point.count * np.log(point.cost / point.count) + np.log(point.count) * refined.theta.size
    return Candidate(orders[k], float(bic), _fit_percent(refined, samples))


def _fit_percent(refined: Refined, samples: Sequence[Samples]) -> float:
    power = sum(float(np.sum((s.y[s.valid] - s.y[s.valid].mean()) ** 2)) for s in samples)
    left = sum(float(v @ v) for v in refined.point.raw)
    return float(100 * (1 - np.sqrt(left / power)))


def _words(order: Order) -> str:
    def counted(n: int, noun: str) -> str:
        return f"{n} {noun}{'' if n == 1 else 's'}"

    words = counted(order.poles, "pole")
    if order.integrators:
        words += f" ({order.integrators} at 0)"
    return f"{words}, {counted(order.zeros, 'zero')}" if order.zeros else f"{words}, no zero"


def _said(table: tuple[Candidate, ...]) -> str:
    best = table[0]
    first = f"input {best.order.column + 1}: {_words(best.order)}"
    if len(table) == 1:
        return f"{first}, the only structure that could be fitted"
    second = table[1]
    gap = second.bic - best.bic
    firm = "clearly better" if gap > levels.ORDER_CLEAR else "hardly better"
    return (
        f"{first}, {firm} than {_words(second.order)}: Bayesian criterion lower by {gap:.3g}, "
        f"fit {best.fit_percent:.3g} % against {second.fit_percent:.3g} %"
    )
