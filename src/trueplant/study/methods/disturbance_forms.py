"""The fit and (17) with the declared unmeasured disturbance estimated along, as methods beside the direct fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError, Refused, TrueplantError
from trueplant.record import Segment
from trueplant.study.methods.agreement import Estimated
from trueplant.study.methods.closed_form import closed_form
from trueplant.study.methods.paper_forms import problem, why_not
from trueplant.study.plant.disturbance import Disturbed, acts_alike, without_measured, without_unmeasured
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study

WITH_FIT = "fit with disturbance estimate"
WITH_CLOSED_FORM = "closed-form with disturbance estimate"


def answers_with_disturbance(
    study: Study, identified: Identified, disturbed: Disturbed, segments: Sequence[Segment]
) -> tuple[dict[str, Estimated], dict[str, str]]:
    """What those two answer, and why one does not; `disturbed` was recovered in these `segments`."""
    wanted = study.project.analysis.method
    if wanted not in ("auto", "all", "direct", "closed-form"):
        return {}, {}
    fit = Estimated.by_fits(disturbed.fits)
    answers = {} if wanted == "closed-form" else {WITH_FIT: fit}
    why = "" if wanted == "direct" else why_not(study, identified.segments, "closed-form", taken_along=True)
    if why is None:
        try:
            answers[WITH_CLOSED_FORM] = _closed_form(study, identified, disturbed, fit.covariance, segments)
        except (TrueplantError, np.linalg.LinAlgError) as error:
            why = str(error)
    return answers, {WITH_CLOSED_FORM: why} if why else {}


def _closed_form(
    study: Study,
    identified: Identified,
    disturbed: Disturbed,
    of_fits: Mapping[tuple[int, int], Array],
    segments: Sequence[Segment],
) -> Estimated:
    """(17) on closed-loop segments from which the recovered disturbance is taken off."""
    model, structures, controller = problem(study, identified, [s for s in segments if s.closed])
    if controller is not None and not acts_alike(controller):
        raise Refused(
            "a controller acts otherwise on its set-point than on PV: what v does to the loop is not told by r - v"
        )
    cleaned = [s for s in without_unmeasured(disturbed, segments, controller) if s.closed]
    cleaned = without_measured(study, cleaned, disturbed.plant, controller)
    if controller is None:
        raise LoopError("the closed form needs a declared controller")
    local = closed_form(study, cleaned, model, structures, controller)
    # At the frequencies that the disturbance could have made, the answer is that of the fit which told them apart, and
    # no surer than it.
    wider = {place: c + of_fits.get(place, 0.0) for place, c in local.covariance.items()}
    return replace(local, covariance=wider)
