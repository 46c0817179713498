"""The other ways to the same answer: mismatch expression, joint form and what else is asked for, beside the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.errors import TrueplantError
from trueplant.identify import OutputEstimate
from trueplant.lti import TransferMatrix
from trueplant.mismatch import FrequencyResponse
from trueplant.study.agreement import Estimated, disagreements, in_sentences, rows_of
from trueplant.study.asked import ask
from trueplant.study.believed import plant_matrix
from trueplant.study.disturbed import assumed, estimate_disturbed
from trueplant.study.disturbed_forms import answers_with_disturbance
from trueplant.study.local_forms import FORMS, answer_of, not_stationary, paper_route_rows, short_segments, why_not
from trueplant.study.nonparametric import best_known
from trueplant.study.result import Reason

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study


@dataclass(frozen=True, eq=False)
class Compared:
    """What the other methods found, for result.json, and the frequency response that the report draws."""

    elements: Mapping[str, list[dict[str, Any]]]
    not_applied: Mapping[str, str]
    agreement: tuple[str, ...]
    response: FrequencyResponse | None
    disturbance: tuple[Mapping[str, Any], ...] = ()
    """Of each output with a declared unmeasured disturbance: what was found of it."""
    assumed: str = ""
    """What taking measured disturbances off the record rests on."""
    notes: tuple[Reason, ...] = ()
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """What to know of an estimator that was asked for."""
    black_box: Mapping[str, Any] = field(default_factory=dict)


def compare_methods(study: Study, estimates: Mapping[int, OutputEstimate]) -> Compared:
    """Run what applies: the joint form (open loop: the response to OP), (17) where a controller is declared, fit and
    (17) with the unmeasured disturbance estimated along where one is declared, and the estimators that are asked for.
    """
    plant = plant_matrix(study, estimates)
    segments = short_segments(study)
    found, refused = _local_answers(study, plant)
    disturbed = estimate_disturbed(study, estimates, plant, segments)
    if disturbed is not None:
        along, why = answers_with_disturbance(study, disturbed, segments)
        found, refused = found | along, refused | why
    asked = ask(study, estimates, plant, segments, not_stationary(study))
    for name, answer in asked.answers.items():
        parameters = {place: p for place, (p, _) in answer.found.items()}
        found[name] = Estimated(parameters, {place: covariance for place, (_, covariance) in answer.found.items()})
    response = best_known(answer.response for answer in found.values())
    elements = {name: rows_of(study, answer) for name, answer in found.items()}
    formed = found["closed-form"].response if "closed-form" in found else None
    if formed is not None and not formed.periods:  # it reads frequencies between the lines too, where nothing moves
        elements["paper-route"] = paper_route_rows(study, plant)
    said = {**disagreements(study, estimates, found, asked.remarks), **asked.disagreements}
    return Compared(
        elements,
        {**refused, **asked.not_applied},
        in_sentences(said),
        response,
        () if disturbed is None else disturbed.table,
        assumed(study, estimates) if response is not None else "",
        () if disturbed is None else disturbed.notes,
        asked.remarks,
        asked.black_box,
    )


def _local_answers(study: Study, plant: TransferMatrix) -> tuple[dict[str, Estimated], dict[str, str]]:
    """What each of FORMS that is asked for answers, and why one does not."""
    found: dict[str, Estimated] = {}
    refused: dict[str, str] = {}
    for name in FORMS:
        if study.project.analysis.method not in ("auto", "all", name):
            continue
        why = why_not(study, name)
        if why is None:
            try:
                found[name] = answer_of(study, name, plant)
            except (TrueplantError, np.linalg.LinAlgError) as error:
                why = str(error)
        if why:
            refused[name] = why
    return found, refused
