"""What each element is known to as a whole: net gain, total delay, and its response where the loop works.

To first order in the errors of its parameters, with their whole covariance: two gains of which neither is known may
have a sum that is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.detect import Found
from trueplant.identify import WhyUnanswered
from trueplant.identify.levels import TOO_UNCERTAIN
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.lti.delay import phase, total_delay
from trueplant.lti.structure import gain_unit, structure_of
from trueplant.result import Derived
from trueplant.study.loops.targets import crossover
from trueplant.study.plant.elements import Judged
from trueplant.study.study import Study


@dataclass(frozen=True, eq=False)
class _Quantity:
    """One quantity, before it is known whether the data tell it."""

    name: str
    unit: str
    model: float | None
    value: float
    gradient: Array
    """(n,) by the element's parameters."""
    size: float
    """What its standard error is compared with; infinite where any is of use."""
    least: float = -np.inf


def with_derived(study: Study, plant: TransferMatrix, judged: Judged) -> Judged:
    """The elements with what follows from their parameters; `plant` (n_y, n_u + n_d) as estimated."""
    places = {(study.project.output_names[i], study.columns[j]): (i, j) for i, j in judged.found}
    elements = []
    for element in judged.elements:
        place = places.get((element.output, element.input))
        if place is not None:
            units = {p.name: p.unit for p in element.parameters}
            # of a gain that is 0 nothing else follows, and no number that does not exist is answered
            with np.errstate(divide="ignore", invalid="ignore"):
                derived = tuple(_derived(study, plant, judged.found[place], place, units))
            if place in study.wanted:
                derived = tuple(replace(one, model=None) for one in derived)
            element = replace(element, derived=derived)
        elements.append(element)
    return replace(judged, elements=tuple(elements))


def _derived(
    study: Study, plant: TransferMatrix, found: Found, place: tuple[int, int], units: dict[str, str]
) -> Iterator[Derived]:
    confidence, time_unit = study.project.analysis.confidence, study.project.time_unit
    model = study.model[place]
    for quantity in _at_rest(found, model, units[found.spec.structure.names[0]], time_unit):
        yield _told(found, quantity, "rest", 0.0, confidence)
    at, w = _frequency(study, plant, found, place[1])
    if not np.isfinite(w):
        return
    unit = gain_unit(study.project.outputs[place[0]].unit, study.input_unit(place[1]))
    for quantity in _response(found, model, w, unit, time_unit):
        yield _told(found, quantity, at, w, confidence)


def _frequency(study: Study, plant: TransferMatrix, found: Found, column: int) -> tuple[str, float]:
    """Where the loop that its input closes has a gain of 1; without one, at the element's own corner."""
    loop = study.loop(plant)
    if loop is not None:
        places = [place for place in loop.controller.entries if place[0] == column]
        at = [crossover(plant[i, column], loop.controller, (column, i)) for _, i in places]
        if known := [w for w in at if w is not None]:
            return "crossover", max(known)
    structure, theta = found.spec.structure, found.theta
    slow = structure.lag(theta) + structure.longest_dead_time(theta)
    return "corner", 1 / slow if slow > 0 else np.inf


def _at_rest(found: Found, model: TransferFunction, unit: str, time_unit: str) -> Iterator[_Quantity]:
    structure, theta = found.spec.structure, found.theta
    value, old = float(theta[structure.is_gain].sum()), 0.0 if model.is_zero else None
    if not model.is_zero:
        own, values = structure_of(model)
        old = float(values[own.is_gain].sum()) if own.integrators == structure.integrators else None
    # of an element that the model lacks any gain is of use
    size = max(abs(value), abs(old or 0.0)) if old != 0 else np.inf
    name = "net_slope" if structure.integrators else "net_gain"
    yield _Quantity(name, unit, old, value, structure.is_gain.astype(float), size)
    yield _delay(found, model, 0.0, time_unit)


def _delay(found: Found, model: TransferFunction, w: float, time_unit: str) -> _Quantity:
    structure, theta = found.spec.structure, found.theta
    value, gradient = total_delay(structure, theta, w)
    old = None if model.is_zero else total_delay(*structure_of(model), w)[0]
    slow = found.lag + structure.longest_dead_time(theta)
    least = -np.inf if structure.is_lead.any() else 0.0
    return _Quantity("total_delay", time_unit, old, value, gradient, max(abs(value), abs(old or 0.0), slow), least)


def _response(found: Found, model: TransferFunction, w: float, unit: str, time_unit: str) -> Iterator[_Quantity]:
    structure, theta = found.spec.structure, found.theta
    yield _delay(found, model, w, time_unit)
    s = np.array([1j * w])
    value, old = structure.transfer(theta)(s)[0], model(s)[0]
    relative = structure.gradient(theta, s)[0] / value
    size = float(max(abs(value), abs(old))) if old else np.inf
    yield _Quantity("magnitude", unit, float(abs(old)), float(abs(value)), abs(value) * relative.real, size, least=0.0)
    turned = phase(structure, theta, w)
    before = float(np.degrees(turned + np.angle(old / value))) if old else None
    yield _Quantity("phase", "deg", before, float(np.degrees(turned)), np.degrees(relative.imag), np.degrees(1.0))


def _told(found: Found, quantity: _Quantity, at: str, w: float, confidence: float) -> Derived:
    """With its interval, or why there is none."""
    gradient = quantity.gradient
    told = Derived(quantity.name, quantity.unit, at, w, quantity.model, None, None, None)
    for k, reason in found.reasons.items():
        # that one parameter is uncertain does not say that this is
        if gradient[k] and reason.why is not WhyUnanswered.TOO_UNCERTAIN:
            return replace(told, reason=reason.text)
    both = (found.covariance, found.covariance_by_data)
    error, by_data = (float(np.sqrt(max(float(gradient @ covariance @ gradient), 0.0))) for covariance in both)
    if not max(error, by_data) <= TOO_UNCERTAIN * quantity.size:
        return replace(told, reason=WhyUnanswered.TOO_UNCERTAIN.value)
    half = float(norm.ppf(0.5 + confidence / 2)) * error
    ends = max(quantity.value - half, quantity.least), quantity.value + half
    return replace(told, plant=quantity.value, std_error=error, ci=ends)
