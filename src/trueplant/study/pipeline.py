"""One analysis as one straight line: records, screening, estimates, verdicts, what it means, the result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trueplant.lti import TransferMatrix
from trueplant.project import Project
from trueplant.result import Code, ControllerCheck, Reason, Result
from trueplant.study.assemble import Checked, Found, assemble, refused
from trueplant.study.data.cascade import check_cascades
from trueplant.study.data.controller_check import check_controllers
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.nonparametric import coherence_of
from trueplant.study.data.prepare import prepare
from trueplant.study.experiment.plans import UNKNOWN_CONTROLLER, more_data
from trueplant.study.loops.derived import with_derived
from trueplant.study.loops.retuning import Retuning, retuning_of
from trueplant.study.loops.robustness import LoopToday, robustness_of
from trueplant.study.loops.settled import against_settled_loop, settled_for
from trueplant.study.loops.targets import not_as_declared
from trueplant.study.methods.compare import compare_methods
from trueplant.study.methods.detectors import published_detections
from trueplant.study.plant.elements import judge
from trueplant.study.plant.gate import through_the_gate
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import Progress, Study, quiet
from trueplant.threads import one_thread

NO_ELEMENT = "no output has both an element to estimate and usable data"
NOTHING_SHOWN = (
    "nothing in these data shows beyond chance that a PV answers to an OP: see whether PV, SP and OP are the columns "
    "that they are called, and whether several samples lie within the time that the loop takes to answer"
)


@one_thread()
def analyse(project: Project, say: Progress = quiet, frames: Sequence[Any] | None = None) -> Result:
    """The main job: from a project to its result. Refusals are results; unusable input raises.

    `frames` stand in for the files of the experiments.
    """
    say("reading the data")
    study = prepare(project, say, frames)
    reasons, controllers = doubts(study), check_controllers(study)
    if not study.segments or blocked(reasons):
        return refused(study, _checked(study, controllers, reasons))
    identified = through_the_gate(study, identify(study, say))
    identified = against_settled_loop(study, identified, controllers)
    if not identified.estimates:
        reasons += (Reason(Code.NOTHING_TO_ESTIMATE, NOTHING_SHOWN if identified.absence_p else NO_ELEMENT),)
        return refused(study, _checked(study, controllers, reasons))
    plant = updated_plant(study.model, identified.estimates)
    judged = with_derived(study, plant.nominal, judge(study, identified, plant.nominal))
    study = study.with_first_model(plant.nominal)
    say("comparing methods")
    compared = compare_methods(study, identified, plant.nominal)
    say("margins and robustness of today's loops")
    loop = robustness_of(study, plant, settled_for(study, controllers), controllers) if judged.answered else LoopToday()
    retuned = Retuning()
    if judged.answered:
        say("settings for the controllers")
        retuned = retuning_of(study, identified, plant, compared.response, controllers, judged.elements, say)
    say("planning moves that would tell more")
    declared = study.loop_experiment is None or not not_as_declared(study, controllers)
    plans = more_data(study, identified.estimates, plant.nominal) if declared else (UNKNOWN_CONTROLLER,)
    say("putting the result together")
    return assemble(
        study,
        _checked(study, controllers, reasons, plant.nominal),
        Found(identified, plant, judged, compared, loop, retuned, plans),
    )


def _checked(
    study: Study,
    controllers: tuple[ControllerCheck, ...],
    reasons: tuple[Reason, ...],
    plant: TransferMatrix | None = None,
) -> Checked:
    """What the data show beside the estimate; `plant` (n_y, n_u + n_d) is the model where there is no other."""
    return Checked(
        controllers,
        check_cascades(study, study.model if plant is None else plant),
        None if plant is None else coherence_of(study),
        published_detections(study),
        reasons,
    )
