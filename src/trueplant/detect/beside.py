"""Two results of one plant: which of its parameters differ beyond chance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from scipy.stats import norm

from trueplant.calendar import unit_seconds
from trueplant.detect.verdict import holm
from trueplant.result import (
    Code,
    Derived,
    Element,
    ExperimentData,
    Interval,
    LoopRetuning,
    Parameter,
    Reason,
    Result,
    Status,
)
from trueplant.result.comparison import (
    ComparedElement,
    ComparedFit,
    ComparedLoop,
    ComparedParameter,
    Comparison,
)


def compare_results(first: Result, second: Result) -> Comparison:
    """Two results of the same plant, parameter by parameter, with the second brought to the first one's time unit.

    A difference is one beyond chance where its familywise p-value (Holm) over all parameters compared is below one
    minus the confidence, the higher of both. That holds for independent records; for the same data no p-value is given.
    """
    confidence = max(r.provenance.settings.confidence for r in (first, second))
    shared = _shared(first, second)
    scale = unit_seconds(second.provenance.time_unit) / unit_seconds(first.provenance.time_unit)
    both = _Both(_z(first), _z(second), scale, first.provenance.time_unit, second.provenance.time_unit)
    there = {(e.output, e.input): e for e in second.elements}
    elements = tuple(
        _element(e, there[e.output, e.input], both) for e in first.elements if (e.output, e.input) in there
    )
    judged = _unjudged(elements) if shared else _judged(elements, confidence)
    answered = any(p.difference is not None for e in elements for p in e.parameters)
    notes = (*([shared] if shared else []), *_left_over(first, second))
    return Comparison(
        status=Status.OK if answered else Status.REFUSED,
        reasons=() if answered else (Reason(Code.NOTHING_COMMON, "no parameter is answered by both results"),),
        notes=notes,
        provenance=(first.provenance, second.provenance),
        confidence=confidence,
        independent=shared is None,
        elements=judged,
        fit=_fits(first, second),
        controllers=_loops(first.controllers, second.controllers),
    )


@dataclass(frozen=True)
class _Both:
    """What the numbers of both results are to be read with."""

    first_z: float
    second_z: float
    """Quantiles that their intervals were made with."""
    scale: float
    """Length of the second's time unit in that of the first."""
    first_unit: str
    second_unit: str

    def converted(self, one: _Known) -> _Known:
        """A quantity of the second in the time unit of the first."""
        if self.first_unit == self.second_unit:
            return one
        if one.unit == self.second_unit:
            return one.times(self.scale, self.first_unit)
        ending = f"/{self.second_unit}"
        if one.unit.endswith(ending) and "gain" not in one.name:  # a gain may be one of a flow in m3/h
            return one.times(1 / self.scale, f"{one.unit.removesuffix(ending)}/{self.first_unit}")
        return one


@dataclass(frozen=True)
class _Known:
    """One quantity of one result."""

    name: str
    unit: str
    value: float | None
    std_error: float | None
    ci: Interval | None

    @classmethod
    def of(cls, one: Parameter | Derived) -> _Known:
        return cls(one.name, one.unit, one.plant, one.std_error, one.ci)

    def times(self, factor: float, unit: str) -> _Known:
        if self.value is None:
            return replace(self, unit=unit)
        error = None if self.std_error is None else self.std_error * factor
        ci = None if self.ci is None else (self.ci[0] * factor, self.ci[1] * factor)
        return _Known(self.name, unit, self.value * factor, error, ci)

    def error_towards(self, other: float, z: float) -> float | None:
        """Standard error, or what the interval says on the side of the other value where that is more."""
        if self.value is None or self.std_error is None:
            return None
        if self.ci is None:
            return self.std_error
        side = self.ci[1] - self.value if other > self.value else self.value - self.ci[0]
        return max(self.std_error, side / z)


def _element(first: Element, second: Element, both: _Both) -> ComparedElement:
    ours, theirs = _quantities(first, second), _quantities(second, first)
    found = {one.name: both.converted(one) for one in theirs}
    return ComparedElement(
        first.output,
        first.input,
        (first.verdict, second.verdict),
        (first.structure, second.structure),
        (first.tf_model, second.tf_model),
        (first.tf_plant, second.tf_plant),
        tuple(_compared(one, found[one.name], both) for one in ours if one.name in found),
    )


def _quantities(element: Element, other: Element) -> list[_Known]:
    """Its parameters, or what elements of two structures have in common."""
    if element.structure == other.structure:
        return [_Known.of(one) for one in element.parameters]
    return [_Known.of(one) for one in element.derived if one.at == "rest"]


def _compared(a: _Known, b: _Known, both: _Both) -> ComparedParameter:
    found = ComparedParameter(a.name, a.unit, a.value, a.ci, b.value, b.ci, None, None, None, None, None)
    if a.unit != b.unit:
        return replace(found, second=None, second_ci=None, reason=f"the second is in {b.unit or 'no unit'}")
    if a.value is None or b.value is None:
        which = "both" if a.value is b.value else "the first" if a.value is None else "the second"
        return replace(found, reason=f"not answered by {which}")
    errors = a.error_towards(b.value, both.first_z), b.error_towards(a.value, both.second_z)
    if any(e is None or not math.isfinite(e) for e in errors):
        return replace(found, reason="its standard error is not known")
    error = math.hypot(*(e for e in errors if e is not None))
    p = float(2 * norm.sf(abs(b.value - a.value) / error)) if error > 0 else None
    return replace(found, difference=b.value - a.value, std_error=error, p_value=p)


def _judged(elements: Sequence[ComparedElement], confidence: float) -> tuple[ComparedElement, ...]:
    raw = [p.p_value for e in elements for p in e.parameters if p.p_value is not None]
    adjusted = iter(holm(raw))

    def judged(one: ComparedParameter) -> ComparedParameter:
        if one.p_value is None:
            return one
        p = float(next(adjusted))
        return replace(one, p_adjusted=p, differs=p <= 1 - confidence)

    return tuple(replace(e, parameters=tuple(judged(p) for p in e.parameters)) for e in elements)


def _unjudged(elements: Sequence[ComparedElement]) -> tuple[ComparedElement, ...]:
    """Without what holds for independent records only."""
    return tuple(
        replace(e, parameters=tuple(replace(p, std_error=None, p_value=None) for p in e.parameters)) for e in elements
    )


def _z(result: Result) -> float:
    return float(norm.isf((1 - result.provenance.settings.confidence) / 2))


def _shared(first: Result, second: Result) -> Reason | None:
    """Why the two are not independent: they use a stretch of one file, or of two files with the same time stamps."""
    same_hours = None
    for a in first.data:
        for b in second.data:
            one_file = _sum(a, first) == _sum(b, second) != ""
            same_clock = a.start == b.start if one_file else _stamped_alike(a, b)
            if not same_clock or not _overlap(_used(a, first), _used(b, second)):
                continue
            if one_file:
                what = f"{a.name} is in both"
                return Reason(Code.SAME_DATA, f"{what}: the two are not independent, and no p-value is given")
            same_hours = same_hours or Reason(
                Code.SAME_HOURS,
                f"{a.name} and {b.name} are different files of the same hours: the two may not be independent, and no "
                "p-value is given; compare records of different hours",
            )
    return same_hours


def _sum(one: ExperimentData, result: Result) -> str:
    return result.provenance.data_sha256.get(one.name, "")


def _stamped_alike(a: ExperimentData, b: ExperimentData) -> bool:
    if a.start is None or b.start is None:
        return False
    return (datetime.fromisoformat(a.start).tzinfo is None) == (datetime.fromisoformat(b.start).tzinfo is None)


def _used(one: ExperimentData, result: Result) -> list[Interval]:
    """The stretches that are used, in seconds: since an epoch where there are time stamps."""
    unit = unit_seconds(result.provenance.time_unit)
    start = 0.0
    if one.start is not None:
        moment = datetime.fromisoformat(one.start)
        start = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return [(start + unit * a, start + unit * b) for a, b in one.used or (one.span,)]


def _overlap(first: Sequence[Interval], second: Sequence[Interval]) -> bool:
    return any(a < d and c < b for a, b in first for c, d in second)


def _left_over(first: Result, second: Result) -> Iterator[Reason]:
    """The elements that only one of the two has."""
    ours, others = ({(e.output, e.input) for e in result.elements} for result in (first, second))
    for which, mine, theirs in (("first", ours, others), ("second", others, ours)):
        only = ", ".join(f"{source} -> {output}" for output, source in sorted(mine - theirs))
        if only:
            yield Reason(Code.ONLY_IN_ONE, f"only the {which} has {only}")


def _fits(first: Result, second: Result) -> tuple[ComparedFit, ...]:
    worst: list[dict[str, float]] = [{}, {}]
    for found, result in zip(worst, (first, second), strict=True):
        for row in result.fit:
            if math.isfinite(row.fit_percent_plant):
                found[row.output] = min(found.get(row.output, math.inf), row.fit_percent_plant)
    names = dict.fromkeys([*worst[0], *worst[1]])
    return tuple(ComparedFit(name, (worst[0].get(name), worst[1].get(name))) for name in names)


def _loops(first: Sequence[LoopRetuning], second: Sequence[LoopRetuning]) -> tuple[ComparedLoop, ...]:
    there = {(loop.input, loop.output): loop for loop in second}
    return tuple(
        ComparedLoop(
            loop.input,
            loop.output,
            (loop.recommended, there[loop.input, loop.output].recommended),
            _settings(loop),
            _settings(there[loop.input, loop.output]),
        )
        for loop in first
        if (loop.input, loop.output) in there
    )


def _settings(loop: LoopRetuning) -> dict[str, float | str | None]:
    return {} if loop.chosen is None or loop.chosen.settings is None else loop.chosen.settings.values
