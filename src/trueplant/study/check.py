"""What the data show before an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trueplant.project import Project
from trueplant.result import Check, Code, Reason, Status
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.prepare import prepare
from trueplant.study.data.tables import data_tables, provenance
from trueplant.study.study import Progress, Study, quiet
from trueplant.threads import one_thread


@one_thread()
def check(project: Project, say: Progress = quiet, frames: Sequence[Any] | None = None) -> Check:
    """Read and screen the records of a project; refused where nothing can be answered from them.

    `frames` stand in for the files of the experiments. Raises what `prepare` raises.
    """
    return checked(prepare(project, say, frames))


def checked(study: Study) -> Check:
    """What the records show; refused where nothing can be answered from all of them together."""
    reasons = doubts(study)
    refused = not study.segments or blocked(reasons)
    if refused and not reasons:
        reasons = (Reason(Code.NO_DATA, "no usable data are left after screening"),)
    return Check(Status.REFUSED if refused else Status.OK, reasons, study.notes, provenance(study), data_tables(study))
