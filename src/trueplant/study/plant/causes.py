"""What lies behind a verdict: plant, disturbance, controller, valve, sensor, or that these data cannot say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.detect import CommonFactor, Found, common_factors
from trueplant.identify import FoundValve, OperatingPoints, OutputEstimate, operating_points
from trueplant.identify.pieces import Piece
from trueplant.record import Segment
from trueplant.result import Code, Element, ElementVerdict, Reason
from trueplant.result.headline import only_simpler
from trueplant.study import levels
from trueplant.study.plant.identified import Identified
from trueplant.study.plant.meanwhile import changed_meanwhile
from trueplant.study.study import Study

TESTED = (Code.CAUSE_DISTURBANCE, Code.CAUSE_MOVED_MEANWHILE, Code.CAUSE_OPERATING_POINT)
"""The causes with a test of their own; the others follow from verdicts, or from the test of valves."""


def causes_of(
    study: Study, identified: Identified, found: Mapping[tuple[int, int], Found], elements: Sequence[Element]
) -> list[Reason]:
    """A sentence with its evidence for each cause that the data show; codes "cause-..." as in docs/verdicts.md.

    A controller that is not the declared one is said by the check of the controllers (code "controller").
    """
    estimates = {i: estimate for i, estimate in identified.estimates.items() if estimate.refuted is None}
    level = levels.CAUSES * (1 - study.project.analysis.confidence) / len(TESTED)
    causes = [*_saturated(study), *_valves(study, identified.valves), *changed_meanwhile(study, estimates, level)]
    causes += _levels(study, identified.segments, estimates, level)
    return causes + _plant(study, estimates, found, elements)


def _saturated(study: Study) -> list[Reason]:
    shares, places = [], []
    for screened in study.screened:
        if screened.refusal is not None or not screened.saturated.size:
            continue
        for name, share in zip(study.project.input_names, screened.saturated.mean(axis=0), strict=True):
            if share > levels.WORTH_SAYING_AT_LIMIT:
                shares.append(f"{100 * share:.2g}")
                places.append(f"{screened.record.name}, {name}")
    if not places:
        return []
    message = (
        f"the actuator was saturated: OP stood at a limit in {_respectively(shares)} % of the samples. The estimate "
        "takes OP as it was recorded, but meanwhile there was no control: the loop was not what its tuning makes of it"
    )
    return [Reason(Code.CAUSE_VALVE_SATURATED, message, "; ".join(places))]


def _respectively(values: Sequence[str]) -> str:
    """Values in the order of the places that a sentence holds for."""
    return values[0] if len(values) == 1 else f"{', '.join(values[:-1])} and {values[-1]}"


def _valves(study: Study, valves: Mapping[int, FoundValve]) -> list[Reason]:
    causes = []
    for j, found in valves.items():
        band = f"{found.band:.3g} {study.project.inputs[j].unit}".rstrip()
        does = (
            f"has a backlash: the records fit better with a stem that follows OP only when it has gone back by {band}"
            if found.valve.backlash
            else f"sticks: the records fit better with a stem that stays until OP is {band} away and then jumps to it"
        )
        message = f"the valve {does} (p = {found.p_value:.1g}). The plant's numbers are those behind the valve"
        causes.append(Reason(Code.CAUSE_VALVE_STICKING, message, study.project.input_names[j]))
    return causes


def _levels(
    study: Study, segments: Sequence[Segment], estimates: Mapping[int, OutputEstimate], level: float
) -> list[Reason]:
    """Where PV sits at another level than in the first experiment, for the same OP."""
    sizes, places = [], []
    found = {i: _operating_points(study, segments, estimate, i) for i, estimate in estimates.items()}
    tests = sum(max(len(points.levels) - 1, 0) for points in found.values() if points is not None)
    for i, points in found.items():
        if points is None:
            continue
        covariance = points.covariance
        for n, k in enumerate(points.experiments[1:], start=1):
            shift = points.levels[n] - points.levels[0]
            sigma = float(np.sqrt(covariance[n, n] + covariance[0, 0] - 2 * covariance[n, 0]))
            # where nothing is known of a gain, sigma may be no number
            if not 2 * norm.sf(abs(shift) / max(sigma, 1e-300)) * tests < level:
                continue
            unit = study.project.outputs[i].unit
            half = norm.isf((1 - study.project.analysis.confidence) / 2) * sigma
            sizes.append(f"{shift:+.3g} ± {half:.2g} {unit}".rstrip())
            places.append(f"{study.project.output_names[i]}, {study.project.experiments[k].name}")
    if not places:
        return []
    message = (
        f"PV sits {_respectively(sizes)} from where the same OP held it in the first experiment: a sensor bias, or a "
        "load that has come to stay. It moves no gain and no time constant"
    )
    return [Reason(Code.CAUSE_OPERATING_POINT, message, "; ".join(places))]


def _operating_points(
    study: Study, segments: Sequence[Segment], estimate: OutputEstimate, i: int
) -> OperatingPoints | None:
    """The output's level in each experiment, by the first piece that is long enough.

    None where there are not two to compare, or where nothing settles it.
    """
    row, taken = estimate.row, {spec.column for spec in estimate.row.specs}
    fixed = np.array([0.0 if j in taken else study.model[i, j].dc_gain for j in range(len(study.columns))])
    if any(spec.structure.integrators for spec in row.specs) or not np.isfinite(fixed).all():
        return None
    starts: dict[int, Array] = {}
    seen: set[int] = set()
    for k, piece in enumerate(row.pieces):
        if piece.experiment in seen or piece.valid[:: row.stride].sum() < levels.FEWEST_ERRORS:
            continue
        segment = _begun_in(segments, piece)
        first = min(round((piece.start - segment.t[0]) / segment.h), len(segment) - 1)
        starts[k] = np.hstack([segment.u, segment.d])[first]
        seen.add(piece.experiment)
    if len(starts) < 2:
        return None
    return operating_points(estimate.fit, estimate.theta, estimate.covariance, starts, fixed)


def _begun_in(segments: Sequence[Segment], piece: Piece) -> Segment:
    """The segment in which a piece of an output begins, or that before the gap in which it does."""
    before = [s for s in segments if s.experiment == piece.experiment and s.t[0] < piece.start + 0.5 * s.h]
    return before[-1]


def _parts(estimate: OutputEstimate) -> list[tuple[Any, slice]]:
    return list(zip(estimate.row.specs, estimate.row.slices, strict=True))


def _plant(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    found: Mapping[tuple[int, int], Found],
    judged: Sequence[Element],
) -> list[Reason]:
    """Sensor span and actuator gain where whole rows or columns scale alike, else the plant itself."""
    changed = [e for e in judged if e.verdict == ElementVerdict.CHANGED and not only_simpler(e)]
    if not changed:
        return []
    dynamics = {(e.output, e.input) for e in changed if _dynamics_changed(study, found, e)}
    outputs, inputs = study.project.output_names, study.project.input_names
    common = [
        factor
        for factor in _common(study, estimates, found)
        if not any((outputs, inputs)[factor.kind == "column"][factor.index] in place for place in dynamics)
    ]
    explained: set[tuple[str, str]] = set()
    causes = []
    for factor in common:
        name = (outputs, inputs)[factor.kind == "column"][factor.index]
        explained |= {(e.output, e.input) for e in changed if name == (e.output, e.input)[factor.kind == "column"]}
        causes.append(_factor_cause(factor, name, study))
    rest = [e for e in changed if (e.output, e.input) not in explained]
    beside = {(e.output, e.input) for e in judged if e.verdict == ElementVerdict.UNCHANGED}
    asked = {(outputs[i], study.columns[j]) for i, j in study.specs}
    for e in rest:
        message = "the plant itself has changed"
        other_dynamics = bool(dynamics) or e.rejected_structure is not None
        if (e.output, e.input) not in asked:
            continue  # of what the record showed unasked the note says all
        if e.tf_model == "0":
            message = "the plant has an element here that the model lacks"
        elif len(outputs) == len(inputs) == 1 and not other_dynamics:
            causes.append(_one_loop(e))
            continue
        elif any(other is not e and (other.output == e.output or other.input == e.input) for other in rest):
            message += ": several elements of a row or column have, and not by one factor as with a sensor or a valve"
        elif any(i == e.output or j == e.input for i, j in beside):
            message += ": no other element of its row and column that these data can judge moves with it"
        elif other_dynamics:
            message += ": a sensor's span or a valve's gain would move the gain alone"
        causes.append(Reason(Code.CAUSE_PLANT, message, f"{e.input} -> {e.output}"))
    return causes


def _one_loop(element: Element) -> Reason:
    """One input, one output, and no change of the dynamics: what that may be."""
    if not any(p.changed for p in element.parameters):
        message = (
            "the element has changed as a whole, and these data cannot say what of it: the plant, or an instrument"
        )
    else:
        known = all(p.plant is not None for p in element.parameters)
        message = (
            ("only the gain has changed" if known else "the gain has changed, and these data do not tell the dynamics")
            + ": with one output and one input that can be the sensor's span, the valve or the plant, and these data "
            "cannot say which. Check the instrument first"
        )
    return Reason(Code.CAUSE_UNKNOWN, message, f"{element.input} -> {element.output}")


def _dynamics_changed(study: Study, found: Mapping[tuple[int, int], Found], element: Element) -> bool:
    """Has anything but a gain of this element changed?"""
    place = study.project.output_names.index(element.output), study.columns.index(element.input)
    is_gain = found[place].spec.structure.is_gain
    return any(p.changed and not gain for p, gain in zip(element.parameters, is_gain, strict=True))


def _factor_cause(factor: CommonFactor, name: str, study: Study) -> Reason:
    size = f"{factor.factor:.3g} ± {norm.isf((1 - study.project.analysis.confidence) / 2) * factor.std_error:.2g}"
    if factor.kind == "row":
        message = (
            f"all gains to this output have changed by the same factor {size} (p = {factor.p_equal:.2g} that they are "
            "equal): its sensor's span is the likely cause, not the plant"
        )
        return Reason(Code.CAUSE_SENSOR_SPAN, message, name)
    message = (
        f"all gains from this input have changed by the same factor {size} (p = {factor.p_equal:.2g} that they are "
        "equal): its valve or actuator is the likely cause, not the plant"
    )
    return Reason(Code.CAUSE_ACTUATOR_GAIN, message, name)


def _common(
    study: Study, estimates: Mapping[int, OutputEstimate], found: Mapping[tuple[int, int], Found]
) -> list[CommonFactor]:
    """Rows and columns of inputs that scale alike; elements with several delayed gains take no part."""
    n_y, n_u = study.model.shape[0], len(study.project.inputs)
    ratio, covariance = np.full((n_y, n_u), np.nan), np.zeros((n_y * n_u, n_y * n_u))
    present = np.array([[not study.model[i, j].is_zero for j in range(n_u)] for i in range(n_y)])
    for i, estimate in estimates.items():
        places, index, scale, of_model = [], [], [], []
        for spec, part in _parts(estimate):
            known = found.get((i, spec.column))
            if spec.column >= n_u or known is None or spec.structure.delayed > 1 or 0 in known.reasons:
                continue
            if known.model[0]:
                places.append(i * n_u + spec.column)
                index.append(part.start)
                scale.append(known.model[0])
                of_model.append(0.0 if known.of_model is None else known.of_model[0, 0])
        if index:
            ratio.ravel()[places] = estimate.theta[index] / scale
            own = estimate.covariance[np.ix_(index, index)] + np.diag(of_model)
            covariance[np.ix_(places, places)] = own / np.outer(scale, scale)
    return common_factors(ratio, covariance, present, 1 - study.project.analysis.confidence)
