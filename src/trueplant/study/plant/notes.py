"""What the reader of a result should know although an answer was possible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trueplant.identify import OutputEstimate, unanswered
from trueplant.identify.between_experiments import kinds_of
from trueplant.identify.levels import SHARED_FACTOR, UNDERMODELLED
from trueplant.lti import Structure
from trueplant.lti.structure import structure_of
from trueplant.result import Code, ControllerCheck, Reason
from trueplant.study import levels
from trueplant.study.data.by_hand import hand_notes
from trueplant.study.data.excitation import (
    compression_notes,
    manual_notes,
    repeated_time_notes,
    setpoint_rank_note,
)
from trueplant.study.data.scan import faster_scan
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


def controller_notes(consistency: Sequence[ControllerCheck]) -> list[Reason]:
    return [
        Reason(Code.CONTROLLER, entry.message, f"{entry.experiment}, {entry.input}")
        for entry in consistency
        if entry.confirmed is not True
    ]


def notes_of(study: Study, found: Identified, consistency: Sequence[ControllerCheck]) -> list[Reason]:
    """What the reader should know although an answer was possible."""
    notes = [*setpoint_rank_note(study), *manual_notes(study), *repeated_time_notes(study), *compression_notes(study)]
    notes += [
        *time_unit_note(study, found),
        *hand_notes(study, consistency),
        *controller_notes(consistency),
        *_scan_note(study),
    ]
    notes += _hold_notes(study, found)
    answered = {i for i, estimate in found.estimates.items() if len(unanswered(estimate)) < estimate.theta.size}
    for i, estimate in found.estimates.items():
        name = study.project.output_names[i]
        notes += refuted_note(estimate, name)
        notes += _shared_disturbance_note(study, estimate, name)
        notes += _noise_notes(estimate, name) if i in answered else []
        notes += _undermodelled_notes(study, found, i, i in answered)
    if answered and len({segment.experiment for segment in study.segments}) == 1:
        notes.append(
            Reason(
                Code.ONE_EXPERIMENT,
                "the intervals rest on one experiment: how far another run of the same plant would differ is not in "
                "them; give several experiments together to have that added",
            )
        )
    return notes


def time_unit_note(study: Study, found: Identified) -> list[Reason]:
    """Said where all elements answer 60 or 3,600 times as fast or slowly as in the model."""
    ratios = []
    for i, estimate in found.estimates.items():
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            system = study.model[i, spec.column]
            if not system.is_zero and (there := _answer(*structure_of(system))) > 0:
                ratios.append(_answer(spec.structure, estimate.theta[part]) / there)
    if not ratios or min(ratios) <= 0:
        return []
    typical = float(np.median(ratios))
    factor = 60 if abs(np.log(typical)) < np.log(60 * 3600) / 2 else 3600
    unit = factor if typical > 1 else 1 / factor
    if max(max(ratio / unit, unit / ratio) for ratio in ratios) > levels.TIME_UNIT:
        return []
    return [
        Reason(
            Code.TIME_UNIT,
            f"every element answers about {factor} times as {'slowly' if typical > 1 else 'fast'} as the model says: "
            f"is time_unit ({study.project.time_unit}) the unit of the model's times?",
        )
    ]


def _answer(structure: Structure, theta: ArrayLike) -> float:
    """Lags and mean dead time together."""
    p = np.asarray(theta, dtype=float)
    return structure.lag(p) + float(np.mean(structure.dead_times(p)))


def refuted_note(estimate: OutputEstimate, name: str) -> list[Reason]:
    return [] if estimate.refuted is None else [Reason(Code.REFUTED, estimate.refuted.text, name)]


def _scan_note(study: Study) -> list[Reason]:
    if not study.between:
        return []
    why = (
        "the declared controller writes OP more often than it was recorded"
        if faster_scan(study.records)
        else "OP does not follow from the recorded samples by any linear law: the controller writes it more often "
        "than it was recorded, acts on what was not recorded, or is not linear"
    )
    text = (
        f"{why}. What OP did between two samples is not in the data, and every dead time is uncertain by half "
        "a sample, which its interval includes. Export the record at the controller's scan, or declare its sample_time "
        "if this is it"
    )
    return [Reason(Code.SCAN, text)]


def _hold_notes(study: Study, found: Identified) -> list[Reason]:
    """Only where the record can tell: else nothing is said, and the intervals of its dead times have both."""
    said = {
        "zoh": "stays at each value until its next sample: straight lines between its samples fit worse beyond chance",
        "linear": "runs on between its samples: values that stay until the next one fit worse beyond chance",
    }
    return [
        Reason(Code.HOLD, f'it {said[one.hold]} (hold = "{one.hold}" in its [[disturbance]] says so)', study.columns[j])
        for j, one in found.holds.items()
        if one.decided
    ]


def _shared_disturbance_note(study: Study, estimate: OutputEstimate, name: str) -> list[Reason]:
    if not estimate.predicted_by:
        return []
    told = ", ".join(study.project.output_names[j] for j in estimate.predicted_by)
    cost = (
        "all outputs were estimated together with a noise model that allows for it"
        if estimate.jointly
        else f"estimates for {name} may be off by that, and their standard errors were multiplied by "
        f"{SHARED_FACTOR:g}. A measured disturbance (or an experiment in open loop) would cure it"
    )
    text = f"a disturbance reaches {told} before it reaches {name}, and the controllers act on it in between: {cost}"
    return [Reason(Code.SHARED_DISTURBANCE, text, name)]


def _noise_notes(estimate: OutputEstimate, name: str) -> list[Reason]:
    notes = []
    if estimate.uneven:
        notes.append(
            Reason(
                Code.UNEVEN_NOISE,
                "what is left of PV is not noise of one size and colour (bursts, noise that comes with moves, a "
                "disturbance that starts or ends): the standard errors allow for that",
                name,
            )
        )
    runs = estimate.runs
    if runs is not None and not runs.agree:
        kinds = zip(("gains differ", "lags", "dead times"), runs.spread, ("", "", " of dead time and lag"), strict=True)
        estimated = set(kinds_of(estimate.fit)[estimate.fit.free])
        differ = [_differing(kind, s, of) for k, (kind, s, of) in enumerate(kinds) if k in estimated]
        notes.append(
            Reason(
                Code.RUNS_DISAGREE,
                "the experiments disagree by more than their residuals justify: from one to the other "
                f"{', '.join(differ)}. The intervals speak of their mean, and count that",
                name,
            )
        )
    elif runs is not None and np.any(np.diag(runs.added) > 0.5 * np.diag(estimate.covariance)):
        notes.append(
            Reason(
                Code.ONE_EXPERIMENT,
                f"{len(runs.experiments)} experiments tell little of how far runs of one plant differ: that they "
                "may is most of the width of some intervals. More experiments make them narrower; parts of one run are "
                "better given as one experiment",
                name,
            )
        )
    return notes


def _differing(kind: str, spread: float, of: str) -> str:
    percent = f"{100 * spread:.0f}"
    return f"{kind} not measurably" if percent == "0" else f"{kind} by some {percent} %{of}"


def _undermodelled_notes(study: Study, found: Identified, i: int, answered: bool) -> list[Reason]:
    estimate, name = found.estimates[i], study.project.output_names[i]
    columns, kept = study.columns, set(estimate.kept)
    follows = {j for j, p in enumerate(estimate.cross_p) if p < UNDERMODELLED}
    richer = {j for j, p in enumerate(estimate.structure_p) if p < UNDERMODELLED} - kept
    absent = {j for j in follows if _absent(study, found, i, j)}
    left = follows - kept - richer - absent
    tried = {j for j in left if j in estimate.rejected}
    beyond = ", and its gain at rest and its time constants may differ from those given by more than their intervals"
    beyond = beyond if answered else ""
    counted = f". The intervals count how far what comes nearest to it differs {_between(estimate)}" if answered else ""
    counted = beyond if estimate.halves is None and estimate.runs is None else counted
    said = [
        (
            absent,
            "the prediction errors still follow the input: ask for the missing element from "
            f'{", ".join(columns[j] for j in sorted(absent))} (tf = "0" with a structure)',
        ),
        (
            tried,
            f"the prediction errors still follow the input: no structure that was tried describes the plant{counted}",
        ),
        (
            left - tried,
            f"the prediction errors still follow the input: the structure is simpler than the plant{counted}",
        ),
        (
            kept,
            "a richer structure (a further lag, a lead or an oscillation) predicts better beyond chance than the one "
            "that is declared. It was kept, as it was asked for, and its gain and its lags are as uncertain as the "
            "richer one leaves them. Ask for a richer one, or leave structure = ... out",
        ),
        (
            richer,
            "a richer structure (a further lag and lead, or an oscillation) predicts better beyond chance: the plant's "
            f"element is not of the structure declared{beyond}. Ask for a richer one (structure = ...)",
        ),
    ]
    return [
        Reason(Code.UNDERMODELLED, text, f"{', '.join(columns[j] for j in sorted(places))} -> {name}")
        for places, text in said
        if places
    ]


def _between(estimate: OutputEstimate) -> str:
    return "from one half of the record to the other" if estimate.runs is None else "between the experiments"


def grouped(notes: Sequence[Reason]) -> tuple[Reason, ...]:
    """Each sentence once, in the order of its first place, with all the places that it holds for."""
    places: dict[tuple[Code, str], list[str]] = {}
    for note in notes:
        places.setdefault((note.code, note.message), []).append(note.where)
    return tuple(Reason(*said, "; ".join(dict.fromkeys(filter(None, where)))) for said, where in places.items())


def _absent(study: Study, found: Identified, i: int, j: int) -> bool:
    return (i, j) not in found.specs and study.model[i, j].is_zero
