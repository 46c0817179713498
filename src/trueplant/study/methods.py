"""The other ways to the same answer: mismatch expression, joint form and what else is asked for, beside the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from trueplant.errors import Refused, TrueplantError
from trueplant.identify import OutputEstimate, paper_route, unanswered
from trueplant.loop import Controller
from trueplant.lti import Structure, TransferMatrix
from trueplant.mismatch import FrequencyResponse, fit_locally, period_of
from trueplant.record import Segment
from trueplant.study.asked import ask
from trueplant.study.disturbed import (
    Disturbed,
    acts_alike,
    assumed,
    declared_parts,
    estimate_disturbed,
    without_measured,
    without_unmeasured,
)
from trueplant.study.nonparametric import best_known
from trueplant.study.result import Reason
from trueplant.study.words import number

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]

WITH_FIT = "fit with disturbance estimate"
WITH_CLOSED_FORM = "closed-form with disturbance estimate"
LARGEST = 200_000
"""Longer segments are left to the fit."""
MOST_BOUND = 0.05
"""Share of a record with OP at a limit beyond which the loop does not count as linear."""
HOPELESS = 0.5
"""Relative standard error of a gain beyond which a method has nothing to say of the element."""


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


@dataclass(frozen=True, eq=False)
class Estimated:
    """Parameters and covariance of the elements that a method answered."""

    parameters: Mapping[tuple[int, int], Array]
    covariance: Mapping[tuple[int, int], Array]
    response: FrequencyResponse | None = None


def compare_methods(study: Study, estimates: Mapping[int, OutputEstimate]) -> Compared:
    """Run what applies: the joint form (open loop: the response to OP), (17) where a controller is declared, fit and
    (17) with the unmeasured disturbance estimated along where one is declared, and the estimators that are asked for.
    """
    from trueplant.study.believed import plant_matrix

    wanted = study.project.analysis.method
    plant = plant_matrix(study, estimates)
    found: dict[str, Estimated] = {}
    refused: dict[str, str] = {}
    for name in ("joint", "closed-form", "open-loop response", "periodic"):
        if wanted not in ("auto", "all", name):
            continue
        why = _why_not(study, name)
        if why is None:
            try:
                found[name] = _run(study, name, plant)
            except (TrueplantError, np.linalg.LinAlgError) as error:
                why = str(error)
        if why:
            refused[name] = why
    disturbed = _with_disturbance(study, estimates, plant, found, refused)
    everything = [s for s in study.segments if len(s) <= LARGEST]
    asked = ask(study, estimates, plant, everything, _lasting(study))
    for name, answer in asked.answers.items():
        parameters = {place: p for place, (p, _) in answer.found.items()}
        found[name] = Estimated(parameters, {place: covariance for place, (_, covariance) in answer.found.items()})
    first = best_known(fit.response for fit in found.values())
    elements = {name: _summaries(study, fit) for name, fit in found.items()}
    formed = found["closed-form"].response if "closed-form" in found else None
    if formed is not None and not formed.periods:  # it reads frequencies between the lines too, where nothing moves
        elements["paper-route"] = _paper_route(study, plant)
    return Compared(
        elements,
        {**refused, **asked.not_applied},
        (*_agreement(study, estimates, found, asked.remarks), *asked.agreement),
        first,
        () if disturbed is None else disturbed.table,
        assumed(study, estimates) if first is not None else "",
        () if disturbed is None else disturbed.notes,
        asked.remarks,
        asked.black_box,
    )


def _with_disturbance(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    plant: TransferMatrix,
    found: dict[str, Estimated],
    refused: dict[str, str],
) -> Disturbed | None:
    """The fit and (17) with the declared unmeasured disturbance estimated along, put into `found`."""
    wanted = study.project.analysis.method
    everything = [s for s in study.segments if len(s) <= LARGEST]
    disturbed = estimate_disturbed(study, estimates, plant, everything)
    if disturbed is None or wanted not in ("auto", "all", "direct", "closed-form"):
        return disturbed
    slices = {
        (i, spec.column): part
        for i, fit in disturbed.fits.items()
        for spec, part in zip(fit.row.specs, fit.row.slices, strict=True)
    }
    covariance = {(i, j): disturbed.fits[i].covariance[part, part] for (i, j), part in slices.items()}
    if wanted != "closed-form":
        parameters = {(i, j): disturbed.fits[i].theta[part] for (i, j), part in slices.items()}
        found[WITH_FIT] = Estimated(parameters, covariance)
    why = "" if wanted == "direct" else _why_not(study, "closed-form", taken_along=True)
    if why is None:
        model, structures, controller = _problem(study, _segments(study, closed=True))
        if controller is not None and not acts_alike(controller):
            why = (
                "a controller acts otherwise on its set-point than on PV: what v does to the loop is not told by r - v"
            )
    if why is None:
        cleaned = [s for s in without_unmeasured(disturbed, everything, controller) if s.closed]
        cleaned = without_measured(study, cleaned, disturbed.plant, controller)
        try:
            local = fit_locally(cleaned, structures, model, "closed-form", controller)
        except (TrueplantError, np.linalg.LinAlgError) as error:
            why = str(error)
        else:
            # At the frequencies that the disturbance could have made, the answer is that of the fit which told them
            # apart, and no surer than it.
            wider = {place: c + covariance.get(place, 0.0) for place, c in local.covariance.items()}
            found[WITH_CLOSED_FORM] = Estimated(local.parameters, wider, local.response)
    if why:
        refused[WITH_CLOSED_FORM] = why
    return disturbed


def _segments(study: Study, closed: bool) -> list[Segment]:
    return [s for s in study.segments if s.closed == closed and len(s) <= LARGEST]


def _in_closed_loop(study: Study, name: str) -> bool:
    """Which records a method takes; averages over periods take those in open loop where there are no others."""
    return bool(_segments(study, closed=True)) if name == "periodic" else name != "open-loop response"


def _repeat(segments: Sequence[Segment], closed: bool) -> bool:
    """Does what moves any of them repeat with a period."""
    for segment in segments:
        try:
            period_of(segment.r if closed else segment.u, segment.h)
        except TrueplantError:
            continue
        return True
    return False


def _why_not(study: Study, name: str, taken_along: bool = False) -> str | None:
    """Why a method does not apply to these data; an empty text where it has no business at all."""
    closed = _in_closed_loop(study, name)
    segments = _segments(study, closed)
    if not segments:
        return ""
    if name == "periodic" and study.project.analysis.method != name and not _repeat(segments, closed):
        return ""
    lasting = _lasting(study)
    if lasting and not taken_along:
        return lasting
    bound = max(float(1 - segment.free.all(axis=1).mean()) for segment in segments) if closed else 0.0
    at_limit = f"OP was at a limit or in manual for {100 * bound:.2g} % of a record"
    if bound > MOST_BOUND:
        return f"{at_limit}: the loop is not linear from set-point to OP, and set-points cannot be told apart within it"
    if name != "closed-form":
        return None
    experiments = sorted({segment.experiment for segment in segments})
    if any(study.project.controller(k) is None for k in experiments):
        return ""
    if len({repr(study.project.controller(k)) for k in experiments}) > 1:
        return "the experiments ran under different controllers: (17) takes one"
    if len(study.project.outputs) != len(study.project.inputs):
        return "(17)-(20) need as many inputs as outputs"
    if bound > 0:
        return f"{at_limit}, and (17) holds for a free OP only"
    return None


def _lasting(study: Study) -> str:
    """Why a method that takes all disturbances for stationary noise does not apply; empty where it does."""
    lasting = [i for i, parts in declared_parts(study).items() if any(p.kind != "ar1" for p in parts)]
    if not lasting:
        return ""
    names = ", ".join(study.project.output_names[i] for i in lasting)
    return f"a step or drift is declared at {names}: as noise it is not stationary, and has to be estimated along"


def _problem(
    study: Study, segments: Sequence[Segment]
) -> tuple[TransferMatrix, dict[tuple[int, int], Structure], Controller | None]:
    """Model, structures and controller of the inputs alone, as the mismatch expression takes them."""
    n_u = len(study.project.inputs)
    model = TransferMatrix(tuple(row[:n_u] for row in study.model.elements), study.model.time_unit)
    structures = {place: spec.structure for place, spec in study.specs.items() if place[1] < n_u}
    k = segments[0].experiment
    controller = study.project.controller(k)
    if controller is not None:
        controller = controller.linearised(np.nanmean(study.screened[k].record.y, axis=0))
    return model, structures, controller


def _run(study: Study, name: str, plant: TransferMatrix) -> Estimated:
    closed = _in_closed_loop(study, name)
    segments = _segments(study, closed)
    model, structures, controller = _problem(study, segments)
    segments = without_measured(study, segments, plant, controller if closed else None)
    law = controller if name == "closed-form" else None
    form = ("joint" if name == "periodic" else name) if closed else "direct"
    try:
        fit = fit_locally(segments, structures, model, form, law, periodic=name == "periodic")
    except Refused:
        if name != "closed-form" or not _repeat(segments, closed):
            raise
        fit = fit_locally(segments, structures, model, form, law, periodic=True)
    return Estimated(fit.parameters, fit.covariance, fit.response)


def _paper_route(study: Study, plant: TransferMatrix) -> list[dict[str, Any]]:
    """The paper's own estimate (43)-(47), for comparison: it has no covariance, so that it cannot disagree."""
    segments = _segments(study, closed=True)
    model, structures, controller = _problem(study, segments)
    assert controller is not None
    segments = without_measured(study, segments, plant, controller)
    try:
        parameters = paper_route(segments, model, controller, structures).parameters
    except (TrueplantError, np.linalg.LinAlgError):
        return []
    return [
        {
            "output": study.project.output_names[i],
            "input": study.columns[j],
            "parameters": [
                {"name": name, "plant": float(value), "std_error": None, "ci": None}
                for name, value in zip(study.specs[i, j].structure.names, p, strict=True)
            ],
        }
        for (i, j), p in sorted(parameters.items())
    ]


def _hopeless(fit: Estimated, place: tuple[int, int]) -> bool:
    return bool(np.sqrt(fit.covariance[place][0, 0]) > HOPELESS * abs(fit.parameters[place][0]))


def _summaries(study: Study, fit: Estimated) -> list[dict[str, Any]]:
    z = norm.ppf(0.5 + study.project.analysis.confidence / 2)
    rows = []
    for (i, j), p in sorted(fit.parameters.items()):
        structure = study.specs[i, j].structure
        if _hopeless(fit, (i, j)):
            continue
        order = structure.sorted(p)
        errors = np.sqrt(np.diag(fit.covariance[i, j]))
        rows.append(
            {
                "output": study.project.output_names[i],
                "input": study.columns[j],
                "parameters": [
                    _parameter(name, float(p[k]), float(errors[k]), z)
                    for name, k in zip(structure.names, order, strict=True)
                ],
            }
        )
    return rows


def _parameter(name: str, value: float, error: float, z: float) -> dict[str, Any]:
    """As in result.json; without an error where the method gives none."""
    known = bool(np.isfinite(error))
    interval = (value - z * error, value + z * error) if known else None
    return {"name": name, "plant": value, "std_error": error if known else None, "ci": interval}


def _agreement(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    found: Mapping[str, Estimated],
    remarks: Mapping[str, Sequence[str]],
) -> Sequence[str]:
    """A sentence for each method: whether it agrees with the fit within both their uncertainties.

    Of one that does not, the remark that says why it need not is added.
    """
    level = 1 - study.project.analysis.confidence
    sentences = []
    for name, other in found.items():
        apart, compared = [], 0
        for i, estimate in estimates.items():
            open_ones = unanswered(estimate)
            for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
                place = (i, spec.column)
                if place not in other.parameters or _hopeless(other, place):
                    continue
                theta, variance = estimate.theta[part], np.diag(estimate.covariance)[part]
                for k, label in enumerate(spec.structure.names):
                    if part.start + k in open_ones or not np.isfinite(other.covariance[place][k, k]):
                        continue
                    compared += 1
                    gap = theta[k] - other.parameters[place][k]
                    error = np.sqrt(variance[k] + other.covariance[place][k, k])
                    apart.append((2 * norm.sf(abs(gap) / error), place, label, theta[k], other.parameters[place][k]))
        clear = [a for a in apart if a[0] * compared < level]
        if not compared:
            continue
        if not clear:
            sentences.append(f"{name} and the fit agree within their uncertainties")
            continue
        named = "; ".join(
            f"{label.replace('_', ' ')} of {study.columns[j]} -> {study.project.output_names[i]}: "
            f"{number(a)} by the fit, {number(b)} by {name}"
            for _, (i, j), label, a, b in clear[:4]
        )
        more = f" and {len(clear) - 4} more" if len(clear) > 4 else ""
        known = "".join(f" ({remark})" for remark in remarks.get(name, ()) if "biase" in remark)
        sentences.append(f"{name} and the fit disagree beyond their uncertainties: {named}{more}{known}")
    return sentences
