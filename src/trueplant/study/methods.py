"""The other ways to the same answer: the mismatch expression and the joint form, beside the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from trueplant.errors import TrueplantError
from trueplant.identify import OutputEstimate, paper_route, unanswered
from trueplant.loop import Controller
from trueplant.lti import Structure, TransferMatrix
from trueplant.mismatch import FrequencyResponse, LocalFit, fit_locally
from trueplant.record import Segment

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

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


def compare_methods(study: Study, estimates: Mapping[int, OutputEstimate]) -> Compared:
    """Run what applies: the joint form (open loop: the response to OP), and (17) where a controller is declared."""
    wanted = study.project.analysis.method
    found: dict[str, LocalFit] = {}
    refused: dict[str, str] = {}
    for name in ("joint", "closed-form", "open-loop response"):
        if wanted not in ("auto", name):
            continue
        why = _why_not(study, name)
        if why is None:
            try:
                found[name] = _run(study, name)
            except (TrueplantError, np.linalg.LinAlgError) as error:
                why = str(error)
        if why:
            refused[name] = why
    first = next(iter(found.values()), None)
    elements = {name: _summaries(study, fit) for name, fit in found.items()}
    if "closed-form" in found:
        elements["equation-error"] = _paper_route(study)
    return Compared(
        elements,
        refused,
        tuple(_agreement(study, estimates, found)),
        None if first is None else first.response,
    )


def _segments(study: Study, closed: bool) -> list[Segment]:
    return [s for s in study.segments if s.closed == closed and len(s) <= LARGEST]


def _why_not(study: Study, name: str) -> str | None:
    """Why a method does not apply to these data; an empty text where it has no business at all."""
    closed = name != "open-loop response"
    segments = _segments(study, closed)
    if not segments:
        return ""
    if study.project.disturbances:
        return "measured disturbances are part of the model: only the fit takes them along"
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
    if study.model.shape[0] != study.model.shape[1]:
        return "(17)-(20) need as many inputs as outputs"
    if bound > 0:
        return f"{at_limit}, and (17) holds for a free OP only"
    return None


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


def _run(study: Study, name: str) -> LocalFit:
    closed = name != "open-loop response"
    segments = _segments(study, closed)
    model, structures, controller = _problem(study, segments)
    if name == "closed-form":
        return fit_locally(segments, structures, model, name, controller)
    return fit_locally(segments, structures, model, name if closed else "direct")


def _paper_route(study: Study) -> list[dict[str, Any]]:
    """The paper's own estimate (43)-(47), for comparison: it has no covariance, so that it cannot disagree."""
    segments = _segments(study, closed=True)
    model, structures, controller = _problem(study, segments)
    assert controller is not None
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


def _hopeless(fit: LocalFit, place: tuple[int, int]) -> bool:
    return bool(np.sqrt(fit.covariance[place][0, 0]) > HOPELESS * abs(fit.parameters[place][0]))


def _summaries(study: Study, fit: LocalFit) -> list[dict[str, Any]]:
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
                    {
                        "name": name,
                        "plant": float(p[k]),
                        "std_error": float(errors[k]),
                        "ci": (float(p[k] - z * errors[k]), float(p[k] + z * errors[k])),
                    }
                    for name, k in zip(structure.names, order, strict=True)
                ],
            }
        )
    return rows


def _agreement(study: Study, estimates: Mapping[int, OutputEstimate], found: Mapping[str, LocalFit]) -> Sequence[str]:
    """A sentence for each method: whether it agrees with the fit within both their uncertainties."""
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
                    if part.start + k in open_ones:
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
            f"{a:.3g} by the fit, {b:.3g}"
            for _, (i, j), label, a, b in clear[:4]
        )
        more = f" and {len(clear) - 4} more" if len(clear) > 4 else ""
        sentences.append(f"{name} and the fit disagree beyond their uncertainties: {named}{more}")
    return sentences
