"""The estimators of the literature and the black box, where the project asks for them: beside the fit.

Verdicts, loops and settings rest on the direct fit whatever is asked for here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from trueplant.identify import OutputEstimate, samples_per_update
from trueplant.loop import Controller
from trueplant.lti import TransferMatrix, sampled_response
from trueplant.record import Segment
from trueplant.result import BlackBox, BlackBoxElement
from trueplant.result.budget import Source
from trueplant.study.data.timing import update_interval
from trueplant.study.methods.black_box import Opinion, second_opinion
from trueplant.study.methods.estimators import ESTIMATORS, Answer, Task, estimate_by, plant_of
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study

BLACK_BOX = "black-box"
DIRECT = "direct"


@dataclass(frozen=True, eq=False)
class Requested:
    """What the requested estimators found."""

    answers: Mapping[str, Answer] = field(default_factory=dict)
    not_applied: Mapping[str, str] = field(default_factory=dict)
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """What to know of each method, in sentences."""
    biases: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Those of the remarks that say where a method is known to be biased."""
    black_box: BlackBox | None = None
    disagreements: Mapping[str, str] = field(default_factory=dict)
    """Where the black box, if it ran, and the fit differ; as `agreement.disagreements` has it."""


def names_asked(method: str) -> tuple[str, ...]:
    """The estimators (and the black box) that a value of `analysis.method` asks for."""
    every = (*(name for name in ESTIMATORS if name != DIRECT), BLACK_BOX)
    return every if method == "all" else tuple(name for name in every if name == method)


def request(
    study: Study, identified: Identified, plant: TransferMatrix, segments: Sequence[Segment], why: str
) -> Requested:
    """Run what `analysis.method` asks for on `segments`; `why` is said instead where the noise cannot be stationary.

    No answer is surer than the instants of the record, and what OP does between them, let the fit be.
    """
    names = names_asked(study.project.analysis.method)
    if not names:
        return Requested()
    if why := why or _why_nothing(study, segments):
        return Requested(not_applied=dict.fromkeys(names, why))
    estimates = identified.estimates
    task = Task(
        segments,
        {place: spec.structure for place, spec in identified.specs.items() if place[0] in estimates},
        _law(study, segments),
        study.model,
        study.project.output_names,
        study.columns,
    )
    answers, refused = {}, {}
    for name in names:
        if name == BLACK_BOX:
            continue
        other = _controllers_differ(study, segments) if name == "clsrivc" else ""
        answer = Answer({}, other) if other else estimate_by(name, task)
        if answer.refused:
            refused[name] = answer.refused
        if answer.found:
            answers[name] = _at_least(estimates, answer)
    remarks = {name: answer.notes for name, answer in answers.items() if answer.notes}
    biases = {name: answer.biases for name, answer in answers.items()}
    if any(found.disputed for found in estimates.values()):
        apart = "the experiments disagree, which its intervals do not count (those of the direct fit do)"
        remarks = {name: (*remarks.get(name, ()), apart) for name in answers}
    if BLACK_BOX not in names:
        return Requested(answers, refused, remarks, biases)
    shape = len(study.project.outputs), study.n_u
    plants = {"model": study.model, DIRECT: plant}
    plants = {name: matrix.columns(0, study.n_u) for name, matrix in plants.items()}
    plants |= {name: plant_of(task, answer.found, shape) for name, answer in answers.items()}
    opinion = second_opinion(_without_disturbances(study, segments, plant), plants)
    if opinion.refused:
        refused[BLACK_BOX] = opinion.refused
    table, disagreement = _table(study, opinion, answers), _disagreement(study, estimates, opinion)
    return Requested(answers, refused, remarks, biases, table, disagreement)


def _why_nothing(study: Study, segments: Sequence[Segment]) -> str:
    if not segments:
        return "every usable stretch of these records is too long for it: cut a record in several files"
    if samples_per_update(update_interval(study), segments[0].h) > 1:
        return (
            "PV is recorded more often than it is updated, and a value that only stood still would count as measured: "
            "export the record at the interval of the updates"
        )
    return ""


def _closed(segments: Sequence[Segment]) -> list[int]:
    return sorted({segment.experiment for segment in segments if segment.closed})


def _controllers_differ(study: Study, segments: Sequence[Segment]) -> str:
    """Why no one controller can drive the instrument; empty where one can, or none is declared at all."""
    laws = {repr(study.records.declared[k]) for k in _closed(segments)}
    return "the experiments ran under different controllers: its instrument takes one" if len(laws) > 1 else ""


def _law(study: Study, segments: Sequence[Segment]) -> Controller | None:
    closed = _closed(segments)
    return study.records.linear[closed[0]] if closed else None


def _at_least(estimates: Mapping[int, OutputEstimate], answer: Answer) -> Answer:
    """The answer, as uncertain as no method can be spared: instants are rounded, and OP moves between samples."""
    least = {
        (i, spec.column): one.uncounted[Source.ROUNDING][part, part]
        for i, one in estimates.items()
        for spec, part in zip(one.row.specs, one.row.slices, strict=True)
    }
    found = {place: (p, covariance + least[place]) for place, (p, covariance) in answer.found.items()}
    return replace(answer, found=found)


def _without_disturbances(study: Study, segments: Sequence[Segment], plant: TransferMatrix) -> list[Segment]:
    """The segments without what the measured disturbances make of PV, by the fit."""
    n_u = len(study.project.inputs)
    cleaned = []
    for segment in segments:
        y = segment.y.copy()
        for i in range(y.shape[1]):
            for j in range(n_u, plant.shape[1]):
                if not plant[i, j].is_zero:
                    d = segment.d[:, j - n_u]
                    y[:, i] -= sampled_response(plant[i, j], d - d[0], segment.h, segment.holds[j])
        cleaned.append(replace(segment, y=y))
    return cleaned


def _table(study: Study, opinion: Opinion, answers: Mapping[str, Answer]) -> BlackBox | None:
    box = opinion.black_box
    if box is None:
        return None
    rows = []
    for i, output in enumerate(study.project.output_names):
        for j, name in enumerate(study.project.input_names):
            tested = {
                method: float(p[i, j])
                for method, p in opinion.p_values.items()
                if method in ("model", DIRECT) or (i, j) in answers[method].found
            }
            if tested:
                rows.append(BlackBoxElement(output, name, tested))
    return BlackBox(
        lags=box.first.lags,
        remembers=box.first.lags * box.h,
        states=box.order,
        states_reason=box.reason,
        elements=tuple(rows),
    )


def _disagreement(study: Study, estimates: Mapping[int, OutputEstimate], opinion: Opinion) -> dict[str, str]:
    """Does the fit lie where the black box says, over all elements at the level of the verdicts?"""
    who, p = "the black box", opinion.p_values.get(DIRECT)
    if p is None:
        return {}
    level = 1 - study.project.analysis.confidence
    rows = [(i, j) for i in estimates for j in range(p.shape[1])]
    clear = [place for place in rows if p[place] * len(rows) < level]
    if not clear:
        return {who: ""}
    named = ", ".join(
        f"{study.columns[j]} -> {study.project.output_names[i]} (p = {p[i, j]:.1g})" for i, j in clear[:4]
    )
    return {
        who: f"{who} and the fit disagree beyond their uncertainties: {named}. The structure of the element, or "
        "another element of the same input, may be too simple"
    }
