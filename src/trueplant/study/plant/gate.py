"""The last gate before an answer: estimates that predict worse than the model they are to replace are not given, nor
those from an OP that seems to have gone on where it acted no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from trueplant.identify import OutputEstimate, Validation, WhyUnanswered, Worse, worse_than_model
from trueplant.record import Kind
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


def through_the_gate(study: Study, identified: Identified) -> Identified:
    """What was identified, without the answers for outputs that the model predicts better."""
    estimates = dict(identified.estimates)
    for i, worse in worse_than_model(estimates, study.model).items():
        text = _sentence(study, study.project.output_names[i], worse, estimates[i].validation)
        estimates[i] = estimates[i].without_answers(WhyUnanswered.MODEL_PREDICTS_BETTER, text)
    for i, text in _beyond_an_end(study, estimates).items():
        estimates[i] = estimates[i].without_answers(WhyUnanswered.OP_CEASES_TO_ACT, text)
    return replace(identified, estimates=estimates)


def _beyond_an_end(study: Study, estimates: Mapping[int, OutputEstimate]) -> dict[int, str]:
    """What screening found, by output that such an OP moves."""
    ended = {
        study.project.input_names.index(found.signal): found.message
        for screened in study.screened
        for found in (screened.findings if screened.refusal is None else ())
        if found.kind is Kind.END
    }
    columns = {i: [spec.column for spec in estimate.row.specs] for i, estimate in estimates.items()}
    return {i: ended[j] for i, own in columns.items() for j in own if j in ended}


def _sentence(study: Study, name: str, worse: Worse, validation: Validation | None) -> str:
    where = study.project.experiments[worse.experiment].name
    several = len({segment.experiment for segment in study.segments}) > 1
    size = f"its prediction errors are {100 * (1 - 1 / worse.ratio):.2g} % smaller, p = {worse.p_value:.1g}"
    if worse.unseen and validation is not None:
        part = where if validation.kind == "other experiments" else f"the {validation.kind} of {where}"
        what = f"the model predicts {name} in {part} better than an estimate made without it ({size})"
    else:
        what = f"the model predicts {name} in {where} better than the estimate does ({size})"
    advice = (
        "see whether all experiments are of one state of the plant and leave out those that are not, "
        if several
        else "leave out stretches in which something else acted (data.exclude), "
    )
    return f"{what}: {advice}or ask for another structure"
