"""Settings that somebody wants judged: the [[candidate]] entries of a project as one more proposal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from trueplant.loop import LinearLoop
from trueplant.project.controllers import controller_of
from trueplant.study.study import Study
from trueplant.tune import LoopTask, Proposal

BY_HAND = "by hand"
"""What settings that somebody tries are called among methods."""


def candidates_of(study: Study, today: LinearLoop, tasks: Sequence[LoopTask]) -> tuple[Proposal, ...]:
    """One proposal for all loops, in which those without a candidate keep today's law; empty without any candidate."""
    project, k = study.project, study.loop_experiment
    if not project.candidates or k is None:
        return ()
    law = controller_of(project, project.candidates, project.experiments[k].limits)
    assert law is not None  # there are candidates
    law = law.linearised(study.screened[k].record.mean_pv)
    controller = replace(today.controller, entries={**today.controller.entries, **law.entries})
    notes = tuple("" if (task.input, task.output) in law.entries else "as today" for task in tasks)
    return (Proposal(BY_HAND, controller, (True,) * len(tasks), notes, (None,) * len(tasks)),)
