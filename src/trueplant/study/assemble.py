"""From estimates to the result: elements with verdicts, fits, notes, provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trueplant import detect
from trueplant.detect import Found
from trueplant.identify import OutputEstimate
from trueplant.lti import TransferFunction, TransferMatrix, simplified, to_formula
from trueplant.study.band import band_test
from trueplant.study.believed import plant_matrix
from trueplant.study.cascade import cascade_notes, check_cascades
from trueplant.study.causes import causes_of
from trueplant.study.curves import curves_of, model_frequencies
from trueplant.study.datatables import data_tables, fit_rows, provenance
from trueplant.study.detectors import published_detections
from trueplant.study.more_data import more_data
from trueplant.study.nonparametric import coherence_curves, coherence_of, coherence_rows
from trueplant.study.notes import controller_notes, grouped, notes_of
from trueplant.study.parameters import parameters_of
from trueplant.study.result import Element, Importance, Parameter, Reason, Result
from trueplant.study.retuning import Retuning, retuning_of
from trueplant.study.robustness import LoopToday, robustness_of

if TYPE_CHECKING:
    from trueplant.study.methods import Compared
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]
KEPT = "kept at its declared value (estimate = false)"


def assemble(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    others: Compared,
    consistency: Sequence[Mapping[str, Any]],
    reasons: Sequence[Reason],
) -> Result:
    """The result of an analysis that answered at least in part; refused if no parameter is answered."""
    found = detect.elements_found(study.model, estimates)
    plant = plant_matrix(study, estimates)
    elements = _elements(study, estimates, found, plant)
    answered = any(p.plant is not None for e in elements for p in e.parameters)
    notes = [*study.notes, *notes_of(study, estimates, consistency)]
    if not answered:
        reasons = [*reasons, Reason("not-identifiable", "no parameter of any element can be told from these data")]
        reasons += [
            Reason("not-identifiable", p.reason, f"{p.name} of {e.input} -> {e.output}")
            for e in elements
            for p in e.parameters
            if p.reason
        ]
    direct = [{"output": e.output, "input": e.input, "parameters": [_short(p) for p in e.parameters]} for e in elements]
    methods: dict[str, Any] = {"direct": direct, **others.elements, "agreement": list(others.agreement)}
    if any(others.not_applied.values()):
        methods["not_applied"] = dict(others.not_applied)
    if others.remarks:
        methods["remarks"] = dict(others.remarks)
    if others.black_box:
        methods["black_box"] = dict(others.black_box)
    if others.assumed:
        methods["assumed"] = others.assumed
    if others.disturbance:
        methods["disturbance"] = list(others.disturbance)
    notes += others.notes
    cascades = check_cascades(study, plant)
    if cascades:
        methods["cascade"] = cascades
        notes += cascade_notes(cascades)
    if consistency:
        methods["controller_consistency"] = list(consistency)
    if answered:
        inside, outside = band_test(study, plant, others.response)
        if inside:
            methods["band"] = inside
        notes += outside
        notes += causes_of(study, estimates, found, elements)
    explained = coherence_of(study)
    if explained is not None:
        methods["coherence"] = coherence_rows(study, explained)
    if study.project.analysis.detectors:
        methods["detectors"] = published_detections(study)
    notes += [Reason("methods", sentence) for sentence in others.agreement if "disagree" in sentence]
    updated = {(i, j): plant[i, j] for i, j in found}
    loop = robustness_of(study, plant, estimates) if answered else LoopToday()
    retuned = retuning_of(study, plant, estimates, others.response) if answered else Retuning()
    curves = curves_of(study, estimates, found, plant, others.response)
    if explained is not None:
        curves = replace(curves, coherence=coherence_curves(study, explained))
    plans = more_data(study, estimates, plant)
    notes += [Reason("more-data", f"to settle what is open: {plan['sentence']}") for plan in plans[:1]]
    return Result(
        status="ok" if answered else "refused",
        reasons=grouped(reasons),
        provenance=provenance(study),
        data=data_tables(study),
        elements=elements,
        fit=fit_rows(study, estimates, plant),
        methods=methods,
        robustness=loop.table,
        controllers=retuned.table,
        more_data=tuple(plans),
        notes=grouped([*loop.notes, *retuned.notes, *notes]),
        curves=replace(curves, mu=loop.mu, retuning=retuned.curves),
        plant_toml=study.project.with_model(updated).to_toml(),
    )


def refused(study: Study, reasons: Sequence[Reason], consistency: Sequence[Mapping[str, Any]]) -> Result:
    """The result where nothing can be answered."""
    elements = tuple(
        Element(
            output=study.project.output_names[i],
            input=study.columns[j],
            structure=str(spec.structure),
            tf_model=to_formula(study.model[i, j]),
            tf_plant=None,
            tf_mismatch=None,
            parameters=(),
            verdict="not identifiable",
            reason=reasons[0].message if reasons else "",
            p_adjusted=None,
            importance=Importance(None, "open loop"),
            grade="D",
        )
        for (i, j), spec in sorted(study.specs.items())
    )
    methods: dict[str, Any] = {"controller_consistency": list(consistency)} if consistency else {}
    cascades = check_cascades(study)
    if cascades:
        methods["cascade"] = cascades
    if study.project.analysis.detectors:
        methods["detectors"] = published_detections(study)
    return Result(
        status="refused",
        reasons=tuple(reasons) or (Reason("no-data", "no usable data are left after screening"),),
        provenance=provenance(study),
        data=data_tables(study),
        elements=elements,
        methods=methods,
        notes=grouped([*study.notes, *controller_notes(consistency), *cascade_notes(cascades)]),
        plant_toml=study.project.to_toml(),
    )


def _short(p: Parameter) -> dict[str, Any]:
    return {"name": p.name, "plant": p.plant, "std_error": p.std_error, "ci": p.ci}


def _elements(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    found: Mapping[tuple[int, int], Found],
    plant: TransferMatrix,
) -> tuple[Element, ...]:
    settings = study.project.analysis
    verdicts = detect.judge_elements(found, estimates, settings.confidence, settings.tolerance_percent)
    importance = _importance(study, plant)
    elements = []
    for i in range(study.model.shape[0]):
        for j in range(study.model.shape[1]):
            if (i, j) in found:
                judged = verdicts[i, j]
                elements.append(_element(study, estimates[i], found[i, j], judged, plant[i, j], i, j, importance))
            elif not study.model[i, j].is_zero:
                elements.append(_held_element(study, i, j))
    return tuple(elements)


def _held_element(study: Study, i: int, j: int) -> Element:
    formula = to_formula(study.model[i, j])
    if (i, j) in study.specs:
        why = (
            f"the PV of {study.project.output_names[i]} cannot be used in these data, or nothing moves it from outside"
        )
        return Element(
            study.project.output_names[i],
            study.columns[j],
            str(study.specs[i, j].structure),
            formula,
            None,
            None,
            (),
            "not identifiable",
            why,
            None,
            Importance(None, "open loop"),
            "D",
        )
    return Element(
        study.project.output_names[i],
        study.columns[j],
        "",
        formula,
        formula,
        "0",
        (),
        "not identifiable",
        KEPT,
        None,
        Importance(0.0, "open loop"),
        "D",
    )


def _element(
    study: Study,
    estimate: OutputEstimate,
    found: Found,
    verdict: detect.Verdict,
    system: TransferFunction,
    i: int,
    j: int,
    importance: tuple[Array, str],
) -> Element:
    units = found.spec.structure.units(study.project.outputs[i].unit, _input_unit(study, j), study.project.time_unit)
    parameters = parameters_of(found, verdict, units)
    answered = [p.plant is not None for p in parameters]
    peak, basis = importance
    mismatch = simplified(system - study.model[i, j])
    sound = estimate.tests.whiteness_p > 1e-3 and not estimate.undermodelled
    return Element(
        output=study.project.output_names[i],
        input=study.columns[j],
        structure=str(found.spec.structure),
        tf_model=to_formula(study.model[i, j]),
        tf_plant=to_formula(system) if any(answered) else None,
        tf_mismatch=to_formula(mismatch) if any(answered) else None,
        parameters=parameters,
        verdict=verdict.verdict,
        reason=_reason(found, answered),
        p_adjusted=verdict.p_adjusted,
        importance=Importance(float(peak[i, j]) if any(answered) else None, basis),
        grade=detect.grade(_half_widths(found), answered, sound),
    )


def _input_unit(study: Study, j: int) -> str:
    inputs = study.project.inputs
    return inputs[j].unit if j < len(inputs) else study.project.disturbances[j - len(inputs)].unit


def _reason(found: Found, answered: Sequence[bool]) -> str:
    if all(answered):
        return ""
    names = found.spec.structure.names
    grouped: dict[str, list[str]] = {}
    for k, why in found.reasons.items():
        grouped.setdefault(why, []).append(names[k].replace("_", " "))
    return "; ".join(f"{', '.join(which)}: {why}" for why, which in grouped.items())


def _half_widths(found: Found) -> list[float]:
    """Half of each interval relative to the parameter, of a dead time to dead time plus lag."""
    names = found.spec.structure.names
    lag = sum(v for name, v in zip(names, found.theta, strict=True) if name.startswith("tau"))
    sizes = [abs(v) + (lag if n.startswith("dead") else 0.0) for n, v in zip(names, found.theta, strict=True)]
    half = (found.intervals[:, 1] - found.intervals[:, 0]) / 2
    return [float(h / s) if s > 0 else np.inf for h, s in zip(half, sizes, strict=True)]


def _importance(study: Study, plant: TransferMatrix) -> tuple[Array, str]:
    """Of every element, and on which basis: in the loop with a declared controller, else open loop."""
    s = 1j * model_frequencies(study, plant)
    model = study.model(s)
    delta = plant(s) - model
    k = study.loop_experiment
    controller = None if k is None else study.project.controller(k)
    n_u = len(study.project.inputs)
    if k is None or controller is None:
        return detect.importance_open_loop(delta, model), "open loop"
    law = controller.linearised(np.nanmean(study.screened[k].record.y, axis=0))(s)
    sensitivity = np.linalg.inv(np.eye(model.shape[1]) + model[:, :, :n_u] @ law)
    loop = detect.importance_in_loop(delta[:, :, :n_u], law @ sensitivity)
    rest = detect.importance_open_loop(delta, model)[:, n_u:]
    return np.hstack([loop, rest]), "loop"
