"""What lies behind a verdict: plant, disturbance, controller, valve, sensor, or that these data cannot say."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.detect import CommonFactor, Explanation, Found, blocks, explanations
from trueplant.detect.causes import Cause
from trueplant.identify import FoundValve, OperatingPoints, OutputEstimate, operating_points
from trueplant.identify.pieces import Piece
from trueplant.record import Segment
from trueplant.result import Code, Element, ElementVerdict, Reason
from trueplant.result.headline import only_simpler
from trueplant.study import levels
from trueplant.study.plant.identified import Identified
from trueplant.study.plant.meanwhile import changed_meanwhile
from trueplant.study.plant.notes import time_unit_note
from trueplant.study.study import Place, Study

TESTED = (Code.CAUSE_DISTURBANCE, Code.CAUSE_MOVED_MEANWHILE, Code.CAUSE_OPERATING_POINT)
"""The causes with a test of their own; the others follow from verdicts, or from the test of valves."""


def causes_of(
    study: Study, identified: Identified, found: Mapping[Place, Found], elements: Sequence[Element]
) -> list[Reason]:
    """A sentence with its evidence for each cause that the data show; codes "cause-..." as in docs/verdicts.md.

    A controller that is not the declared one is said by the check of the controllers (code "controller").
    """
    estimates = {i: estimate for i, estimate in identified.estimates.items() if estimate.refuted is None}
    level = levels.CAUSES * (1 - study.project.analysis.confidence) / len(TESTED)
    causes = [
        *_saturated(study),
        *_valves(study, identified.valves),
        *changed_meanwhile(study, estimates, level, identified.moved),
    ]
    causes += _levels(study, identified.segments, estimates, level)
    # where the model's times may be in another unit, nothing need have changed
    return causes if time_unit_note(study, identified) else causes + _plant(study, estimates, found, elements)


def _saturated(study: Study) -> list[Reason]:
    shares, places = [], []
    for screened in study.screened:
        if screened.refusal is not None or not screened.saturated.size:
            continue
        used = screened.usable_y.any(axis=1)
        for name, share in zip(study.project.input_names, screened.saturated[used].mean(axis=0), strict=True):
            if share > levels.WORTH_SAYING_AT_LIMIT:
                shares.append(f"{100 * share:.2g}")
                places.append(f"{screened.record.name}, {name}")
    if not places:
        return []
    message = (
        f"the actuator was saturated: OP stood at a limit, or beyond it, in {_and(shares)} % of the samples. "
        "The estimate takes OP as it was recorded, or within its limits where PV answers so, but meanwhile there was "
        "no control: the loop was not what its tuning makes of it"
    )
    return [Reason(Code.CAUSE_VALVE_SATURATED, message, "; ".join(places))]


def _and(values: Sequence[str]) -> str:
    return values[0] if len(values) == 1 else f"{', '.join(values[:-1])} and {values[-1]}"


def _valves(study: Study, valves: Mapping[int, FoundValve]) -> list[Reason]:
    causes = []
    for j, found in valves.items():
        if found.end is not None:
            causes.append(_ended(study, j, found))
            continue
        band = f"{found.band:.3g} {study.project.inputs[j].unit}".rstrip()
        does = (
            f"has a backlash: the records fit better with a stem that follows OP only when it has gone back by {band}"
            if found.valve.backlash
            else f"sticks: the records fit better with a stem that stays until OP is {band} away and then jumps to it"
        )
        message = f"the valve {does} (p = {found.p_value:.1g}). The plant's numbers are those behind the valve"
        causes.append(Reason(Code.CAUSE_VALVE_STICKING, message, study.project.input_names[j]))
    return causes


def _ended(study: Study, j: int, found: FoundValve) -> Reason:
    """An end of a valve that OP goes beyond."""
    asked = study.project.inputs[j]
    way = "down" if np.isfinite(found.valve.low) else "up"
    chance = f"= {found.p_value:.1g}" if found.p_value > 0 else "below 1e-300"
    op = np.concatenate([segment.u[:, j] for segment in study.segments])
    share = float(np.mean((op < found.valve.low) | (op > found.valve.high)))
    end = f"{found.end:.3g} {asked.unit}".rstrip()
    message = (
        f"the records fit better where OP acts {way} to {end} only, and not beyond, where it was in "
        f"{100 * share:.2g} % of the samples (p {chance}): the valve was at its end, or something else had taken it "
        "over. The plant's numbers are those of OP up to there. Meanwhile there was no control: look at the valve, and "
        "let OP go no further"
    )
    return Reason(Code.CAUSE_VALVE_END, message, asked.name)


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
        f"PV sits {_and(sizes)} from where the same OP held it in the first experiment: a sensor bias, or a "
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
    found: Mapping[Place, Found],
    judged: Sequence[Element],
) -> list[Reason]:
    """Instruments and the plant itself: what all explanations with the fewest faults have in common is named.

    Where they differ it is said that they cannot be told apart.
    """
    asked = {_names(study, place): place for place in study.specs}
    changed = {
        asked[e.output, e.input]: e
        for e in judged
        # of what the record showed unasked the note says all
        if e.verdict == ElementVerdict.CHANGED and not only_simpler(e) and (e.output, e.input) in asked
    }
    lacking = {place for place, e in changed.items() if e.tf_model == "0"}
    dynamics = {place for place, e in changed.items() if place not in lacking and _dynamics_changed(found[place], e)}
    compared = _explanations(study, estimates, found, set(changed) - lacking - dynamics, dynamics)
    causes, own, left = [], lacking | dynamics, list[Reason]()
    for alternatives in compared:
        likeliest = max(alternatives, key=lambda one: one.p_value)
        common = frozenset.intersection(*(one.causes for one in alternatives))
        causes += [_factor_cause(factor, likeliest, study) for factor in likeliest.factors if factor.cause in common]
        own |= {place for place in changed if ("element", *place) in common}
        left += [_open_cause(study, part, changed) for part in _parts_open(alternatives, common, changed)]
    beside = {(e.output, e.input) for e in judged if e.verdict == ElementVerdict.UNCHANGED}
    unchanged = {place for place in study.specs if _names(study, place) in beside}
    for place in changed:
        if place in lacking:
            said = "the plant has an element here that the model lacks"
        elif place in own:
            said = _why_plant(study, place, own - lacking - dynamics, dynamics, unchanged)
        else:
            continue
        causes.append(Reason(Code.CAUSE_PLANT, said, _arrow(study, place)))
    return causes + left


def _names(study: Study, place: Place) -> tuple[str, str]:
    return study.project.output_names[place[0]], study.columns[place[1]]


def _arrow(study: Study, place: Place) -> str:
    output, column = _names(study, place)
    return f"{column} -> {output}"


def _why_plant(
    study: Study, place: Place, gains: Collection[Place], dynamics: Collection[Place], unchanged: Collection[Place]
) -> str:
    """That the plant has changed, and what speaks against the sensor and the valve of an element."""

    def crossing(others: Collection[Place]) -> bool:
        return any(one != place and (one[0] == place[0] or one[1] == place[1]) for one in others)

    if place in dynamics:
        return _answers_otherwise(place, unchanged, _is_measured(study, place[1]))
    said = "the plant itself has changed"
    if crossing(gains):
        return f"{said}: several elements of a row or column have, and not by one factor as with a sensor or a valve"
    if crossing(unchanged):
        return f"{said}: no other element of its row and column that these data can judge moves with it"
    return f"{said}: a sensor's span or a valve's gain would move gains alone" if crossing(dynamics) else said


def _answers_otherwise(place: Place, unchanged: Collection[Place], measured: bool) -> str:
    """Of changed dynamics: that these are the plant's, or its sensor's or actuator's.

    A sensor acts on all elements of a row, an actuator (or the sensor of a `measured` disturbance) on all of a column.
    """
    in_row = any(one != place and one[0] == place[0] for one in unchanged)
    in_column = any(one != place and one[1] == place[1] for one in unchanged)
    if in_row and in_column:
        return (
            "the plant itself has changed: a sensor's span or a valve's gain would move the gain alone, and a sensor "
            "or an actuator that answers otherwise would move the other elements of its row or column too"
        )
    beside = "the sensor of the disturbance" if measured else "the actuator (its positioner)"
    suspects = ["the plant itself"]
    suspects += [] if in_row else ["the sensor of PV (its damping, or fouling)"]
    suspects += [] if in_column else [beside]
    listed = f"{', '.join(suspects[:-1])} or {suspects[-1]}"
    return f"not the gain alone has changed, as a sensor's span or a valve's gain would do it: it is {listed}"


def _dynamics_changed(found: Found, element: Element) -> bool:
    """Has anything but a gain of this element changed?"""
    is_gain = found.spec.structure.is_gain
    return any(p.changed and not gain for p, gain in zip(element.parameters, is_gain, strict=True))


def _factor_cause(factor: CommonFactor, of: Explanation, study: Study) -> Reason:
    size = f"{factor.factor:.3g} ± {norm.isf((1 - study.project.analysis.confidence) / 2) * factor.std_error:.2g}"
    crossed = any(other.kind != factor.kind for other in of.factors)
    beside = ", beside what other instruments do to some of them" if crossed else ""
    told = f"have changed by the same factor {size}{beside} (p = {of.p_value:.2g} that they are equal)"
    if factor.kind == "row":
        message = f"all gains to this output {told}: its sensor's span is the likely cause, not the plant"
        return Reason(Code.CAUSE_SENSOR_SPAN, message, study.project.output_names[factor.index])
    if _is_measured(study, factor.index):
        message = f"all gains from this disturbance {told}: its sensor's span is the likely cause, not the plant"
        return Reason(Code.CAUSE_SENSOR_SPAN, message, study.columns[factor.index])
    message = f"all gains from this input {told}: its valve or actuator is the likely cause, not the plant"
    return Reason(Code.CAUSE_ACTUATOR_GAIN, message, study.columns[factor.index])


def _is_measured(study: Study, column: int) -> bool:
    """Is it a measured disturbance?"""
    return column >= len(study.project.inputs)


def _parts_open(
    alternatives: Sequence[Explanation], common: frozenset[Cause], changed: Collection[Place]
) -> list[list[frozenset[Cause]]]:
    """The alternatives of what the explanations do not have in common, by parts that share no changed element."""
    left = frozenset[Cause]().union(*(one.causes for one in alternatives)) - common
    parts: list[frozenset[Cause]] = []
    for place in sorted(changed):
        touching = frozenset(cause for cause in left if _touches(cause, place))
        met = [part for part in parts if part & touching]
        parts = [part for part in parts if not part & touching]
        if touching:
            parts.append(touching.union(*met))
    return [list(dict.fromkeys(one.causes & part for one in alternatives)) for part in parts]


def _touches(cause: Cause, place: Place) -> bool:
    """Would this fault change that element?"""
    return cause[1:] == place if cause[0] == "element" else cause[1] == place[cause[0] == "column"]


def _open_cause(study: Study, alternatives: Sequence[frozenset[Cause]], changed: Mapping[Place, Element]) -> Reason:
    """What explains some changed elements as well as each other."""
    causes = sorted(frozenset[Cause]().union(*alternatives), key=_in_order)
    places = [place for place in sorted(changed) if any(_touches(cause, place) for cause in causes)]
    one = changed[places[0]] if len(places) == 1 else None
    # of many combinations the faults that they are made of say as much
    listed = alternatives if len(alternatives) <= len(causes) else [frozenset([cause]) for cause in causes]
    listed = sorted(listed, key=lambda faults: sorted(map(_in_order, faults)))
    told = [_faults(study, faults, one is not None) for faults in listed]
    instruments = [cause for cause in causes if cause[0] != "element"]
    if instruments == causes:
        told.append("a plant whose gains have all moved alike")
    which = f"that can be {', '.join(told[:-1])} or {told[-1]}, and these data cannot say which"
    if one is None:
        message = f"{len(places)} elements have changed: {which}. Check the instruments first"
    else:
        message = f"{_what_changed(one)}: {which}. Check the instrument first"
    both = one is not None and len(instruments) == 2 and not _is_measured(study, places[0][1])
    where = _arrow(study, places[0]) if both else "; ".join(_instrument(study, cause) for cause in instruments)
    return Reason(Code.CAUSE_UNKNOWN, message, where)


def _in_order(cause: Cause) -> tuple[int, Cause]:
    """To sort by: sensors, valves, the plant."""
    return ("row", "column", "element").index(cause[0]), cause


def _what_changed(element: Element) -> str:
    if not any(p.changed for p in element.parameters):
        return "the element has changed as a whole, and these data do not tell what of it"
    if all(p.plant is not None for p in element.parameters):
        return "only the gain has changed"
    return "the gain has changed, and these data do not tell the dynamics"


def _faults(study: Study, causes: Collection[Cause], of_one: bool) -> str:
    """Faults that go together in words; those of one element need no names."""
    rows = [study.project.output_names[cause[1]] for cause in sorted(causes) if cause[0] == "row"]
    columns = [cause[1] for cause in sorted(causes) if cause[0] == "column"]
    sensors = rows + [study.columns[j] for j in columns if _is_measured(study, j)]
    valves = [study.columns[j] for j in columns if not _is_measured(study, j)]
    elements = [_arrow(study, (one[1], one[2])) for one in sorted(causes) if len(one) == 3]
    if of_one:
        sensor = "the sensor's span" if rows else "the span of the disturbance's sensor"
        return sensor if sensors else "the valve" if valves else "the plant"
    parts = [
        f"{word if len(names) == 1 else several} {_and(names)}"
        for names, word, several in (
            (sensors, "the sensor's span of", "the sensors' spans of"),
            (valves, "the valve of", "the valves of"),
            (elements, "the plant itself in", "the plant itself in"),
        )
        if names
    ]
    return _and(parts)


def _instrument(study: Study, cause: Cause) -> str:
    if cause[0] == "row":
        return f"transmitter of {study.project.output_names[cause[1]]}"
    return f"{'transmitter' if _is_measured(study, cause[1]) else 'valve'} of {study.columns[cause[1]]}"


def _explanations(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    found: Mapping[Place, Found],
    changed: Collection[Place],
    dynamics: Collection[Place],
) -> list[list[Explanation]]:
    """What may explain the gains, block by block; those of elements with several delayed ones count as not known."""
    n_y, n_u = study.model.shape
    ratio, covariance = np.full((n_y, n_u), np.nan), np.zeros((n_y * n_u, n_y * n_u))
    present = np.array([[not study.model[i, j].is_zero for j in range(n_u)] for i in range(n_y)])
    for i, estimate in estimates.items():
        places, index, scale, of_model = [], [], [], []
        for spec, part in _parts(estimate):
            known = found.get((i, spec.column))
            if known is None or spec.structure.delayed > 1 or 0 in known.reasons:
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
    level = 1 - study.project.analysis.confidence
    every = [[(i, j) for j in range(n_u)] for i in range(n_y)]
    there, moved = (np.array([[one in those for one in row] for row in every]) for those in (changed, dynamics))
    parts = blocks(present & np.isfinite(ratio), there, moved)
    return [explanations(ratio, covariance, present, part, moved, level / len(parts)) for part in parts]
