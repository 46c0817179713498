"""The other ways to the same answer: mismatch expression, joint form and what else is asked for, beside the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trueplant.errors import TrueplantError
from trueplant.lti import TransferMatrix
from trueplant.mismatch import FrequencyResponse
from trueplant.result import BandTest, BlackBox, DisturbanceFit, MethodElement, Reason
from trueplant.study.data.band import band_test
from trueplant.study.data.nonparametric import best_known
from trueplant.study.methods.agreement import Estimated, clear_differences, disagreements, in_sentences, rows_of
from trueplant.study.methods.disturbance_forms import answers_with_disturbance
from trueplant.study.methods.paper_forms import (
    FORMS,
    answer_of,
    not_stationary,
    paper_route_rows,
    short_segments,
    why_not,
)
from trueplant.study.methods.requested import request
from trueplant.study.plant.disturbance import assumed, estimate_disturbed
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


@dataclass(frozen=True, eq=False)
class Compared:
    """What the other methods found, for result.json, and the frequency response that the report draws."""

    elements: Mapping[str, tuple[MethodElement, ...]]
    not_applied: Mapping[str, str]
    agreement: tuple[str, ...]
    """Sentences: who agrees with the fit, and who does not."""
    disagreements: tuple[str, ...]
    """Those of `agreement` that say so."""
    response: FrequencyResponse | None
    disturbance: tuple[DisturbanceFit, ...] = ()
    """Of each output with a declared unmeasured disturbance: what was found of it."""
    assumed: str = ""
    """What taking measured disturbances off the record rests on."""
    notes: tuple[Reason, ...] = ()
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """What to know of an estimator that was asked for."""
    black_box: BlackBox | None = None
    band: tuple[BandTest, ...] = ()
    """Does the plant lie in the band of the response?"""
    outside_band: tuple[Reason, ...] = ()


def compare_methods(study: Study, identified: Identified, plant: TransferMatrix) -> Compared:
    """Run what applies: the joint form (open loop: the response to OP), (17) where a controller is declared, fit and
    (17) with the unmeasured disturbance estimated along where one is declared, and the estimators that are asked for.
    """
    estimates = identified.estimates
    segments = short_segments(identified.segments)
    found, refused = _local_answers(study, identified, plant)
    disturbed = estimate_disturbed(study, identified.disturbed, estimates, plant, segments)
    if disturbed is not None:
        along, why = answers_with_disturbance(study, identified, disturbed, segments)
        found, refused = found | along, refused | why
    requested = request(study, identified, plant, segments, not_stationary(study))
    for name, answer in requested.answers.items():
        parameters = {place: p for place, (p, _) in answer.found.items()}
        found[name] = Estimated(parameters, {place: covariance for place, (_, covariance) in answer.found.items()})
    response = best_known(answer.response for answer in found.values())
    apart = {name: clear_differences(study, estimates, answer) for name, answer in found.items()}
    elements = {name: rows_of(study, identified.specs, answer, apart[name] or ()) for name, answer in found.items()}
    formed = found["closed-form"].response if "closed-form" in found else None
    if formed is not None and not formed.periods:  # it reads frequencies between the lines too, where nothing moves
        elements["paper-route"] = paper_route_rows(study, identified, plant)
    remarks = {name: answer.notes for name, answer in found.items() if answer.notes}
    said = {**disagreements(study, apart, requested.biases), **requested.disagreements}
    inside, outside = band_test(study, identified.specs, plant, response)
    return Compared(
        elements,
        {**refused, **requested.not_applied},
        in_sentences(said),
        tuple(sentence for sentence in said.values() if sentence),
        response,
        () if disturbed is None else disturbed.table,
        assumed(study, identified.specs, estimates) if response is not None else "",
        () if disturbed is None else disturbed.notes,
        {**remarks, **requested.remarks},
        requested.black_box,
        inside,
        outside,
    )


def _local_answers(
    study: Study, identified: Identified, plant: TransferMatrix
) -> tuple[dict[str, Estimated], dict[str, str]]:
    """What each of FORMS that is asked for answers, and why one does not."""
    found: dict[str, Estimated] = {}
    refused: dict[str, str] = {}
    for name in FORMS:
        if study.project.analysis.method not in ("auto", "all", name):
            continue
        why = why_not(study, identified.segments, name)
        if why is None:
            try:
                found[name] = answer_of(study, identified, name, plant)
            except (TrueplantError, np.linalg.LinAlgError) as error:
                why = str(error)
        if why:
            refused[name] = why
    return found, refused
