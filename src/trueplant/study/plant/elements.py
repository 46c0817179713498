"""The elements of the plant with their verdicts, as the result has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant import detect
from trueplant.arrays import Array
from trueplant.detect import Found
from trueplant.identify import OutputEstimate, WhyUnanswered
from trueplant.lti import TransferFunction, TransferMatrix, simplified, to_formula
from trueplant.result import Code, Element, ElementVerdict, Importance, Reason
from trueplant.result.numbers import number
from trueplant.result.parameter_words import change_of
from trueplant.study import levels
from trueplant.study.data.declared import declared_covariances
from trueplant.study.plant.causes import causes_of
from trueplant.study.plant.identified import Identified
from trueplant.study.plant.parameters import budgets_of, parameters_of
from trueplant.study.plant.structures import restructured
from trueplant.study.study import Place, Study

KEPT = "kept at its declared value (estimate = false)"
NOT_SHOWN = "nothing in these data shows it beyond chance"


@dataclass(frozen=True, eq=False)
class Judged:
    """The verdict on every element, and what lies behind it."""

    found: Mapping[Place, Found]
    """The estimated elements."""
    elements: tuple[Element, ...]
    """Those of the model and of the estimates, row by row."""
    causes: tuple[Reason, ...]
    restructured: tuple[Reason, ...] = ()
    """A note on each element whose structure is not the declared one."""

    @property
    def powerless(self) -> tuple[Reason, ...]:
        """A note on each element that was tested without being able to find a change worth knowing."""
        tested = (e for e in self.elements if e.verdict == ElementVerdict.NOT_IDENTIFIABLE and e.p_adjusted is not None)
        # what of it is not answered, and why, is said with its parameters
        missed = ((e, _missed(e.detectable_change, e.detectable_of)) for e in tested)
        return tuple(
            Reason(Code.NO_POWER, said if said in e.reason else e.reason, f"{e.input} -> {e.output}")
            for e, said in missed
        )

    @property
    def answered(self) -> bool:
        """Is any parameter of any element answered?"""
        return _answered(self.elements)


def judge(study: Study, identified: Identified, plant: TransferMatrix) -> Judged:
    """Verdicts, importance, grades and causes; `plant` (n_y, n_u + n_d) as estimated."""
    found = {
        place: replace(one, model=(None,) * len(one.model), rejected=None) if place in study.wanted else one
        for place, one in detect.elements_found(study.model, identified.estimates, declared_covariances(study)).items()
    }
    elements = _elements(study, identified, found, plant)
    causes = causes_of(study, identified, found, elements) if _answered(elements) else []
    return Judged(found, elements, tuple(causes), restructured(study, found))


def _answered(elements: Sequence[Element]) -> bool:
    """Is anything said: a parameter, or that an element is not what the model has?"""
    return any(e.verdict == ElementVerdict.CHANGED for e in elements) or any(
        p.plant is not None for e in elements for p in e.parameters
    )


def _elements(
    study: Study, identified: Identified, found: Mapping[Place, Found], plant: TransferMatrix
) -> tuple[Element, ...]:
    settings = study.project.analysis
    first = {place: _first(found[place], p) for place, p in identified.absence_p.items() if place in found}
    verdicts = first | detect.judge_elements(
        {place: one for place, one in found.items() if place not in study.wanted},
        identified.estimates,
        settings.confidence,
        settings.tolerance_percent,
        settings.worth_knowing_percent / 100,
    )
    importance = _importance(study, plant)
    elements = []
    for i in range(study.model.shape[0]):
        for j in range(study.model.shape[1]):
            if (i, j) in found:
                judged = verdicts[i, j]
                elements.append(
                    _element(study, identified.estimates[i], found[i, j], judged, plant[i, j], i, j, importance)
                )
            elif (i, j) in identified.absence_p:
                elements.append(_none_found(study, identified, i, j))
            elif not study.model[i, j].is_zero or (i, j) in study.wanted:
                elements.append(_held_element(study, identified, i, j))
    return tuple(elements)


def _first(found: Found, absence_p: float) -> detect.Verdict:
    """On an element of which nobody said whether it is there, and which the record shows."""
    answered = len(found.reasons) < found.theta.size
    verdict = ElementVerdict.FOUND if answered else ElementVerdict.NOT_IDENTIFIABLE
    return detect.Verdict(verdict, absence_p, (detect.ParameterVerdict(None, None, None),) * found.theta.size)


def _none_found(study: Study, identified: Identified, i: int, j: int) -> Element:
    """An element that was looked for and is not there, or of which these data could show nothing."""
    still = all(np.ptp(np.hstack([segment.u, segment.d])[:, j]) == 0 for segment in study.segments)
    verdict, reason = ElementVerdict.NONE_FOUND, NOT_SHOWN
    if still:
        reason = f"{study.columns[j]} never moves in these data"
    elif (i, j) in identified.unreached:
        verdict, reason = ElementVerdict.NOT_IDENTIFIABLE, WhyUnanswered.NOTHING_FROM_OUTSIDE.value
    return Element(
        output=study.project.output_names[i],
        input=study.columns[j],
        structure="",
        tf_model=None,
        tf_plant=None,
        tf_mismatch=None,
        parameters=(),
        verdict=verdict,
        reason=reason,
        p_adjusted=identified.absence_p[i, j],
        importance=Importance(None, "open loop"),
        grade="",
    )


def _held_element(study: Study, identified: Identified, i: int, j: int) -> Element:
    formula = None if (i, j) in study.wanted else to_formula(study.model[i, j])
    if (i, j) in identified.specs:
        why = f"the PV of {study.project.output_names[i]} cannot be used in these data"
        return Element(
            study.project.output_names[i],
            study.columns[j],
            str(identified.specs[i, j].structure),
            formula,
            None,
            None,
            (),
            ElementVerdict.NOT_IDENTIFIABLE,
            why,
            None,
            Importance(None, "open loop"),
            "D",
        )
    return Element(
        study.project.output_names[i],
        study.columns[j],
        "",
        formula,
        formula,
        "0",
        (),
        ElementVerdict.NOT_IDENTIFIABLE,
        KEPT,
        None,
        Importance(0.0, "open loop"),
        "D",
    )


def _element(
    study: Study,
    estimate: OutputEstimate,
    found: Found,
    verdict: detect.Verdict,
    system: TransferFunction,
    i: int,
    j: int,
    importance: tuple[Array, str],
) -> Element:
    units = found.spec.structure.units(study.project.outputs[i].unit, study.input_unit(j), study.project.time_unit)
    parameters = parameters_of(found, verdict, units)
    answered = [p.plant is not None for p in parameters]
    peak, basis = importance
    known = (i, j) not in study.wanted
    mismatch = to_formula(simplified(system - study.model[i, j])) if known else None
    of = ""
    if known and verdict.detectable is not None and not study.model[i, j].is_zero:
        of = detect.least_known(found.spec.structure, found.theta, found.joint, found.lag, found.model)
    sound = estimate.tests.whiteness_p > levels.GRADED_WHITE and not estimate.undermodelled
    return Element(
        output=study.project.output_names[i],
        input=study.columns[j],
        structure=str(found.spec.structure),
        tf_model=to_formula(study.model[i, j]) if known else None,
        tf_plant=to_formula(system) if any(answered) else None,
        tf_mismatch=mismatch if any(answered) else None,
        parameters=parameters,
        verdict=verdict.verdict,
        reason="; ".join(filter(None, [_power_reason(verdict, of), _reason(found, answered)])),
        p_adjusted=verdict.p_adjusted,
        importance=Importance(float(peak[i, j]) if known and any(answered) else None, basis),
        grade=detect.grade(_half_widths(found), answered, sound),
        detectable_change=verdict.detectable,
        detectable_of=of,
        rejected_structure=None if found.rejected is None else str(found.rejected.structure),
        budget=budgets_of(found),
    )


def _power_reason(verdict: detect.Verdict, of: str) -> str:
    return _missed(verdict.detectable, of) if verdict.lacks_power and verdict.detectable is not None else ""


def _missed(share: float | None, of: str) -> str:
    if share is None or not np.isfinite(share):
        return "no change, however large, would have been seen for certain"
    size = f"less than {number(100 * share, 2)} %"
    return f"a change {change_of(of, size)} would not have been seen for certain"


def _reason(found: Found, answered: Sequence[bool]) -> str:
    if all(answered):
        return ""
    names = found.spec.structure.names
    grouped: dict[str, list[str]] = {}
    for k, why in found.reasons.items():
        grouped.setdefault(why.text, []).append(names[k].replace("_", " "))
    return "; ".join(f"{', '.join(which)}: {why}" for why, which in grouped.items())


def _half_widths(found: Found) -> list[float]:
    """Half of each interval relative to the parameter, of a dead time to dead time plus lag."""
    structure = found.spec.structure
    sizes = np.abs(found.theta) + np.where(structure.is_dead_time, found.lag, 0.0)
    half = (found.intervals[:, 1] - found.intervals[:, 0]) / 2
    return [float(h / s) if s > 0 else np.inf for h, s in zip(half, sizes, strict=True)]


def _importance(study: Study, plant: TransferMatrix) -> tuple[Array, str]:
    """Of every element, and on which basis: in the loop with a declared controller, else open loop."""
    s = 1j * model_frequencies(study, plant)
    study = study.with_first_model(plant)
    model = study.model(s)
    delta = plant(s) - model
    loop = study.loop(study.model)
    open_loop = detect.importance_open_loop(delta, model)
    if loop is None:
        return open_loop, "open loop"
    law = loop.controller(s)
    sensitivity = np.linalg.inv(np.eye(model.shape[1]) + loop.plant(s) @ law)
    in_loop = detect.importance_in_loop(delta[:, :, : study.n_u], law @ sensitivity)
    return np.hstack([in_loop, open_loop[:, study.n_u :]]), "loop"


def model_frequencies(study: Study, plant: TransferMatrix) -> Array:
    """(n_w,) rad per time unit, from the longest segment's span (or the slowest lag) to half the sampling rate."""
    segments = study.segments
    span = max(segment.t[-1] - segment.t[0] for segment in segments)
    slowest = max((-1 / p.real for row in plant.elements for e in row for p in e.poles if p.real < 0), default=span)
    low = min(2 * np.pi / span, 0.1 / slowest)
    return np.geomspace(max(low, 1e-3 / span), np.pi / segments[0].h, levels.FREQUENCIES)
