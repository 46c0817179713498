"""The mismatch expression on records: joint form, (17), response to OP and averages over periods, where they apply."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import TrueplantError
from trueplant.identify import paper_route
from trueplant.loop import Controller
from trueplant.lti import Structure, TransferMatrix
from trueplant.mismatch import fit_locally
from trueplant.record import Segment
from trueplant.result import MethodElement, MethodParameter
from trueplant.study import levels
from trueplant.study.methods.agreement import Estimated
from trueplant.study.methods.closed_form import closed_form, repeat
from trueplant.study.plant.disturbance import declared_parts, without_measured
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study

FORMS = ("joint", "closed-form", "open-loop response", "periodic")


def short_segments(segments: Iterable[Segment]) -> list[Segment]:
    """The segments that are not left to the fit alone."""
    return [s for s in segments if len(s) <= levels.LARGEST_SEGMENT]


def answer_of(study: Study, identified: Identified, name: str, plant: TransferMatrix) -> Estimated:
    """What one of FORMS answers; `plant` (n_y, n_u + n_d) tells what measured disturbances did.

    (17) takes what of the records is linear (`closed_form`), and is read from averages over periods where local
    polynomials cannot tell. Raises TrueplantError or LinAlgError where the records do not tell.
    """
    closed = _in_closed_loop(identified.segments, name)
    segments = _segments(identified.segments, closed)
    model, structures, controller = problem(study, identified, segments)
    segments = without_measured(study, segments, plant, controller if closed else None)
    if name == "closed-form":
        assert controller is not None
        found = closed_form(study, segments, model, structures, controller, or_periods=True)
    else:
        form = ("joint" if name == "periodic" else name) if closed else "direct"
        fit = fit_locally(segments, structures, model, form, periodic=name == "periodic")
        found = Estimated(fit.parameters, fit.covariance, fit.response)
    return replace(found, covariance=_no_surer_than_what_was_taken_off(study, identified, found.covariance))


def _no_surer_than_what_was_taken_off(
    study: Study, identified: Identified, covariance: Mapping[tuple[int, int], Array]
) -> dict[tuple[int, int], Array]:
    """Where the fit has estimated what a measured disturbance does to an output, the answer for it rests on that fit.

    OP answers disturbances, too: what is wrong in their elements passes for the plant.
    """
    along = {i for i, j in identified.specs if j >= study.n_u}
    of_fits = Estimated.by_fits({i: fit for i, fit in identified.estimates.items() if i in along}).covariance
    return {place: own + of_fits.get(place, 0.0) for place, own in covariance.items()}


def why_not(study: Study, every: Sequence[Segment], name: str, taken_along: bool = False) -> str | None:
    """Why one of FORMS does not apply to these data; an empty text where it has no business at all.

    `taken_along`: declared unmeasured disturbances are estimated along, and taken off the records first.
    """
    closed = _in_closed_loop(every, name)
    segments = _segments(every, closed)
    if not segments:
        return ""
    if name == "periodic" and study.project.analysis.method != name and not repeat(segments, closed):
        return ""
    if not taken_along and (reason := not_stationary(study)):
        return reason
    bound = max(float(1 - segment.free.all(axis=1).mean()) for segment in segments) if closed else 0.0
    at_limit = f"OP was at a limit or in manual for {100 * bound:.2g} % of a record"
    if name != "closed-form" and bound > levels.MOST_AT_LIMIT:
        return f"{at_limit}: the loop is not linear from set-point to OP, and set-points cannot be told apart within it"
    if name != "closed-form":
        return None
    experiments = sorted({segment.experiment for segment in segments})
    if any(study.records.declared[k] is None for k in experiments):
        return ""
    if len({repr(study.records.declared[k]) for k in experiments}) > 1:
        return "the experiments ran under different controllers: (17) takes one"
    if beyond := ", ".join(filter(None, (study.project.experiments[k].beyond() for k in experiments))):
        return f"the controller has {beyond}: (17) takes a linear law of set-point and PV"
    if len(study.project.outputs) != len(study.project.inputs):
        return "(17)-(20) need as many inputs as outputs"
    return None


def not_stationary(study: Study) -> str:
    """Why a method that takes all disturbances for stationary noise does not apply; empty where it does."""
    lasting = [i for i, parts in declared_parts(study).items() if any(p.kind != "ar1" for p in parts)]
    if not lasting:
        return ""
    names = ", ".join(study.project.output_names[i] for i in lasting)
    return f"a step or drift is declared at {names}: as noise it is not stationary, and has to be estimated along"


def problem(
    study: Study, identified: Identified, segments: Sequence[Segment]
) -> tuple[TransferMatrix, dict[tuple[int, int], Structure], Controller | None]:
    """Model, structures and controller of the inputs alone, as the mismatch expression takes them."""
    structures = {place: spec.structure for place, spec in identified.specs.items() if place[1] < study.n_u}
    return study.inputs_model, structures, study.records.linear[segments[0].experiment]


def paper_route_rows(study: Study, identified: Identified, plant: TransferMatrix) -> tuple[MethodElement, ...]:
    """The paper's own estimate (43)-(47), as the result has it: without a covariance, so that it cannot disagree."""
    segments = _segments(identified.segments, closed=True)
    model, structures, controller = problem(study, identified, segments)
    assert controller is not None
    # it starts from rest: as far as the loop is linear from the beginning on
    segments = [_until_limit(segment) for segment in without_measured(study, segments, plant, controller)]
    try:
        found = paper_route(segments, model, controller, structures).parameters
    except (TrueplantError, np.linalg.LinAlgError):
        return ()
    return tuple(
        MethodElement(
            study.project.output_names[i],
            study.columns[j],
            tuple(
                MethodParameter(name, float(value), None, None)
                for name, value in zip(identified.specs[i, j].structure.names, p, strict=True)
            ),
        )
        for (i, j), p in sorted(found.items())
    )


def _segments(every: Sequence[Segment], closed: bool) -> list[Segment]:
    return [s for s in short_segments(every) if s.closed == closed]


def _in_closed_loop(every: Sequence[Segment], name: str) -> bool:
    """Which records a form takes; averages over periods take those in open loop where there are no others."""
    return bool(_segments(every, closed=True)) if name == "periodic" else name != "open-loop response"


def _until_limit(segment: Segment) -> Segment:
    """What comes before the first sample at which an OP is at a limit or in manual."""
    stuck = ~segment.free.all(axis=1)
    return segment.part(0, int(np.argmax(stuck))) if stuck.any() else segment
