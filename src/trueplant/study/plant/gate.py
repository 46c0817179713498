"""The last gate before an answer: estimates that predict worse than the model they are to replace are not given."""

from __future__ import annotations

from dataclasses import replace

from trueplant.identify import Validation, WhyUnanswered, Worse, worse_than_model
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


def through_the_gate(study: Study, identified: Identified) -> Identified:
    """What was identified, without the answers for outputs that the model predicts better."""
    estimates = dict(identified.estimates)
    for i, worse in worse_than_model(estimates, study.model).items():
        text = _sentence(study, study.project.output_names[i], worse, estimates[i].validation)
        estimates[i] = estimates[i].without_answers(WhyUnanswered.MODEL_PREDICTS_BETTER, text)
    return replace(identified, estimates=estimates)


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
