"""The model as it was declared: what its conversion cost, and how its own step response lies against the plant's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.lti import MeasuredStep, TransferMatrix, sampled_response, to_formula
from trueplant.project import Project
from trueplant.result import Code, Curves, DeclaredStep, Element, Interval, Reason
from trueplant.study import levels
from trueplant.study.study import Place, Study


def conversion_notes(project: Project) -> tuple[Reason, ...]:
    """One for each element that was given as coefficients: what stands for it in the analysis, and how well."""
    return tuple(
        Reason(
            Code.MODEL_CONVERTED,
            f"the model's step response ({one.source}) was converted to {to_formula(one.system)}, to which parameters "
            f"and verdict refer: the two step responses differ by at most {100 * one.error:.2g} % of the gain"
            + (f", at {one.at:g} {project.time_unit}" if one.error else ""),
            f"{source} -> {output}",
        )
        for (output, source), one in project.models.items()
        if one.measured is not None
    )


def declared_steps(study: Study) -> Mapping[Place, MeasuredStep]:
    """The elements from the inputs that were given as coefficients."""
    return {
        (study.project.output_names.index(output), study.project.input_names.index(source)): one.measured
        for (output, source), one in study.project.models.items()
        if one.measured is not None and source in study.project.input_names
    }


def declared_covariances(study: Study) -> Mapping[Place, Array]:
    """Of the parameters of elements that were given as coefficients, by the scatter of these."""
    return {
        (study.project.output_names.index(output), study.columns.index(source)): one.covariance
        for (output, source), one in study.project.models.items()
        if one.covariance is not None
    }


def model_steps(study: Study, t: Array) -> Array:
    """(n_t, n_y, n_u) unit step responses of the model at even times from 0, as they were declared."""
    out = step_responses(study.inputs_model, t)
    for (i, j), measured in declared_steps(study).items():
        out[:, i, j] = measured(t)
    return out


def model_response(study: Study, w: Array) -> ComplexArray:
    """(n_w, n_y, n_u) of the model at w > 0, as it was declared; NaN where coefficients say nothing."""
    out = study.inputs_model(1j * w)
    for (i, j), measured in declared_steps(study).items():
        out[:, i, j] = measured.frequency_response(w)
    return out


def step_responses(matrix: TransferMatrix, t: Array) -> Array:
    """(n_t, n_y, n_columns) unit step responses at even times from 0."""
    one = np.ones(t.size)
    rows = [[sampled_response(element, one, t[1], "zoh") for element in row] for row in matrix.elements]
    return np.moveaxis(np.array(rows), -1, 0)


def beside_the_band(study: Study, elements: Sequence[Element], curves: Curves) -> tuple[Element, ...]:
    """The elements, those that were given as coefficients with what these say of the plant's band."""
    found = {}
    for (i, j), measured in declared_steps(study).items():
        name = study.project.output_names[i], study.project.input_names[j]
        one = study.project.models[name]
        outside = _outside(measured, curves.step_t, curves.step_low[:, i, j], curves.step_high[:, i, j])
        found[name] = DeclaredStep(one.source, one.error, one.at, outside)
    return tuple(
        replace(e, declared_step=_answered(e, found[e.output, e.input])) if (e.output, e.input) in found else e
        for e in elements
    )


def band_notes(study: Study, elements: Sequence[Element]) -> list[Reason]:
    """Whether each declared step response lies within the plant's band."""
    unit, confidence = study.project.time_unit, f"{100 * study.project.analysis.confidence:g} %"
    notes = []
    for element in elements:
        declared = element.declared_step
        if declared is None or declared.outside is None:
            continue
        where = ", ".join(f"{a:g} to {b:g} {unit}" for a, b in declared.outside[: levels.SHOWN_SPANS])
        text = (
            f"the model's own step response leaves the {confidence} band of the plant's: {where}"
            if declared.outside
            else f"the model's own step response lies within the {confidence} band of the plant's throughout"
        )
        more = len(declared.outside) - levels.SHOWN_SPANS
        text += f" and {more} more" if more > 0 else ""
        notes.append(Reason(Code.MODEL_STEP, text, f"{element.input} -> {element.output}"))
    return notes


def _answered(element: Element, declared: DeclaredStep) -> DeclaredStep:
    """Without an estimate there is no band."""
    return declared if element.tf_plant is not None else replace(declared, outside=None)


def _outside(measured: MeasuredStep, t: Array, low: Array, high: Array) -> tuple[Interval, ...] | None:
    """From when to when the coefficients lie outside of a band; None where the band is not known."""
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        return None
    at = measured.t[measured.t <= t[-1]]
    values, room = measured.values[: at.size], levels.STEP_NEGLIGIBLE * measured.size
    beyond: BoolArray = (values < np.interp(at, t, low) - room) | (values > np.interp(at, t, high) + room)
    spans = []
    for out, run in groupby(range(at.size), key=lambda k: bool(beyond[k])):
        places = list(run)
        if out:
            spans.append((float(at[places[0]]), float(at[places[-1]])))
    return tuple(spans)
