"""From what the stages of an analysis found to the result; nothing is computed here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from trueplant.lti import UncertainPlant, to_formula
from trueplant.mismatch import Coherence
from trueplant.result import (
    CascadeCheck,
    Code,
    ControllerCheck,
    Detection,
    Element,
    ElementVerdict,
    Importance,
    MethodElement,
    MethodParameter,
    Methods,
    MoreData,
    Reason,
    Result,
    Status,
    Uncertainty,
)
from trueplant.study.curves import curves_of, trends_alone
from trueplant.study.data.by_hand import hand_notes
from trueplant.study.data.cascade import cascade_notes
from trueplant.study.data.declared import band_notes, beside_the_band
from trueplant.study.data.nonparametric import coherence_curves, coherence_table
from trueplant.study.data.tables import data_tables, provenance
from trueplant.study.loops.retuning import Retuning
from trueplant.study.loops.robustness import LoopToday
from trueplant.study.methods.compare import Compared
from trueplant.study.plant.elements import Judged
from trueplant.study.plant.fit import fit_rows
from trueplant.study.plant.identified import Identified
from trueplant.study.plant.notes import controller_notes, grouped, notes_of, refuted_note
from trueplant.study.study import Study


@dataclass(frozen=True, eq=False)
class Checked:
    """What the data show before and beside an estimate."""

    controllers: tuple[ControllerCheck, ...]
    """Does each declared controller reproduce OP?"""
    cascades: tuple[CascadeCheck, ...]
    coherence: Coherence | None
    detectors: tuple[Detection, ...]
    reasons: tuple[Reason, ...]
    """Why nothing, or not everything, can be answered."""


@dataclass(frozen=True, eq=False)
class Found:
    """What the stages found, in the order in which they ran."""

    identified: Identified
    plant: UncertainPlant
    judged: Judged
    compared: Compared
    loop: LoopToday
    retuned: Retuning
    plans: tuple[MoreData, ...]


def assemble(study: Study, checked: Checked, found: Found) -> Result:
    """The result of an analysis that answered at least in part; refused if no parameter is answered."""
    answered, plant = found.judged.answered, found.plant.nominal
    curves = curves_of(study, found.identified, found.plant, found.compared.response)
    elements = beside_the_band(study, found.judged.elements, curves)
    if checked.coherence is not None:
        curves = replace(curves, coherence=coherence_curves(study, checked.coherence))
    reasons = grouped([*checked.reasons, *(() if answered else _unanswered(study, found.identified, elements))])
    return Result(
        status=Status.OK if answered else Status.REFUSED,
        reasons=reasons,
        provenance=provenance(study),
        data=data_tables(study),
        elements=elements,
        fit=fit_rows(study, found.identified, plant),
        methods=_methods(study, checked, found),
        robustness=found.loop.table,
        controllers=found.retuned.table,
        more_data=found.plans,
        notes=tuple(note for note in _notes(study, checked, found, elements) if note not in reasons),
        curves=replace(curves, mu=found.loop.mu, retuning=found.retuned.curves),
        uncertainty=Uncertainty.of(found.plant, study.project.output_names, study.columns) if answered else None,
        plant=found.plant,
    )


def refused(study: Study, checked: Checked) -> Result:
    """The result where nothing can be answered."""
    reasons = checked.reasons or (Reason(Code.NO_DATA, "no usable data are left after screening"),)
    elements = tuple(
        Element(
            output=study.project.output_names[i],
            input=study.columns[j],
            structure=str(spec.structure),
            tf_model=None if (i, j) in study.wanted else to_formula(study.model[i, j]),
            tf_plant=None,
            tf_mismatch=None,
            parameters=(),
            verdict=ElementVerdict.NOT_IDENTIFIABLE,
            reason=reasons[0].message,
            p_adjusted=None,
            importance=Importance(None, "open loop"),
            grade="D",
        )
        for (i, j), spec in sorted(study.specs.items())
    )
    told = [*hand_notes(study, checked.controllers), *controller_notes(checked.controllers)]
    notes = [*study.notes, *told, *cascade_notes(checked.cascades)]
    return Result(
        status=Status.REFUSED,
        reasons=reasons,
        provenance=provenance(study),
        data=data_tables(study),
        elements=elements,
        methods=_beside(checked),
        notes=grouped(notes),
        curves=trends_alone(study),
    )


def _unanswered(study: Study, identified: Identified, elements: Sequence[Element]) -> list[Reason]:
    refuted = [
        note for i, one in identified.estimates.items() for note in refuted_note(one, study.project.output_names[i])
    ]
    said = {note.message for note in refuted}
    reasons = [Reason(Code.NOT_IDENTIFIABLE, "no parameter of any element can be told from these data")]
    return [*refuted, *reasons] + [
        Reason(Code.NOT_IDENTIFIABLE, p.reason, f"{p.name} of {e.input} -> {e.output}")
        for e in elements
        for p in e.parameters
        if p.reason and p.reason not in said
    ]


def _beside(checked: Checked) -> Methods:
    """What the data show without an estimate."""
    return Methods(cascade=checked.cascades, controller_consistency=checked.controllers, detectors=checked.detectors)


def _methods(study: Study, checked: Checked, found: Found) -> Methods:
    direct = tuple(
        MethodElement(
            e.output, e.input, tuple(MethodParameter(p.name, p.plant, p.std_error, p.ci) for p in e.parameters)
        )
        for e in found.judged.elements
    )
    others = found.compared
    return replace(
        _beside(checked),
        answers={"direct": direct, **others.elements},
        agreement=others.agreement,
        disagreements=others.disagreements,
        not_applied=others.not_applied if any(others.not_applied.values()) else {},
        remarks={name: tuple(said) for name, said in others.remarks.items()},
        black_box=others.black_box,
        assumed=others.assumed,
        disturbance=others.disturbance,
        band=others.band if found.judged.answered else (),
        coherence=None if checked.coherence is None else coherence_table(study, checked.coherence),
    )


def _notes(study: Study, checked: Checked, found: Found, elements: Sequence[Element]) -> tuple[Reason, ...]:
    """What matters most to the loops first."""
    notes = [*found.loop.notes, *found.retuned.notes, *study.notes, *found.identified.notes]
    notes += notes_of(study, found.identified, checked.controllers)
    notes += found.compared.notes
    notes += cascade_notes(checked.cascades)
    notes += found.compared.outside_band if found.judged.answered else ()
    notes += _causes(found)
    notes += found.judged.restructured
    notes += band_notes(study, elements)
    notes += found.judged.powerless
    notes += [Reason(Code.METHODS, sentence) for sentence in found.compared.disagreements]
    notes += [
        Reason(Code.MORE_DATA, f"to settle what is open: {plan.sentence}" if plan.moves else plan.sentence)
        for plan in found.plans[:1]
    ]
    return grouped(notes)


def _causes(found: Found) -> list[Reason]:
    """But for those of a change that a declared disturbance explains as well."""
    told = {note.where for note in found.compared.notes if note.code == Code.MISMATCH_OR_DISTURBANCE}
    return [cause for cause in found.judged.causes if cause.code != Code.CAUSE_PLANT or cause.where not in told]
