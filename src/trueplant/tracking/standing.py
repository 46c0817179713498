"""How elements that did not change over the record stand to the model: one estimate of all of it together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant import detect
from trueplant.result import Change, ChangeKind, WindowElement
from trueplant.study.data.declared import declared_covariances
from trueplant.study.plant.parameters import parameters_of
from trueplant.study.study import Place, Progress
from trueplant.tracking.series import Followed
from trueplant.tracking.windows import Stretch


def standings(
    followed: Sequence[Followed], changes: Sequence[Change], say: Progress
) -> dict[tuple[str, str], WindowElement]:
    """By output and input: the element judged against the model, familywise over the matrix.

    From the whole record, or the longest stretch of it in which nothing of that output changed in a step. Outputs of
    which an element drifted, or changed at a time that is not known, have no such stretch.
    """
    estimates = {}
    for one in followed:
        project = one.row.study.project
        output = project.output_names[one.row.output]
        if any(c.output == output and c.kind != ChangeKind.STEP for c in changes) or not one.fitted:
            continue
        say(f"{output}: all of it together")
        start, end = max(one.sections(), key=lambda section: _errors(one, section))
        found = one.row.estimate(one.row.stretch_segments(Stretch(start, end)), one.plan.settle)
        if found is not None:
            estimates[one.row.output] = found
    if not estimates:
        return {}
    study = followed[0].row.study
    settings, names = study.project.analysis, study.project.output_names
    elements = detect.elements_found(study.model, estimates, declared_covariances(study))
    verdicts = detect.judge_elements(
        elements, estimates, settings.confidence, settings.tolerance_percent, settings.worth_knowing_percent / 100
    )
    units = {one.row.output: one.row.units for one in followed}

    def judged(place: Place) -> WindowElement:
        verdict = verdicts[place]
        parameters = parameters_of(elements[place], verdict, units[place[0]](place[1]))
        return WindowElement(study.columns[place[1]], verdict.verdict, verdict.p_adjusted, parameters)

    return {(names[i], study.columns[j]): judged((i, j)) for i, j in elements}


def _errors(one: Followed, section: tuple[float, float]) -> float:
    """Prediction errors in a section."""
    blocks = one.plan.blocks
    return float(np.sum(blocks.errors[(blocks.start >= section[0]) & (blocks.end <= section[1])]))
