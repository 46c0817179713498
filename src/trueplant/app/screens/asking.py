"""What a request of the screen Trends is about: the project, its record, and what the app keeps of both."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.exceptions import HTTPException
from starlette.requests import Request

from trueplant.app.folder import ProjectFile
from trueplant.app.pages import project_of
from trueplant.app.screens.aside import Aside
from trueplant.app.screens.records import ALL, Records, Shown, Struck, signature
from trueplant.app.screens.struck import exclusions
from trueplant.connect import ensure
from trueplant.errors import ProjectError
from trueplant.project import ExperimentPlan, Project


@dataclass
class Seen:
    """What the screen keeps while the app runs."""

    records: Records = field(default_factory=Records)
    aside: Aside = field(default_factory=Aside)
    struck: dict[tuple[Path, str], Struck] = field(default_factory=dict)
    """By project and record: what `check` struck last, without what the user excludes."""


_FIRST = threading.Lock()


def seen_by(request: Request) -> Seen:
    """What the app keeps for all its pages; two that ask for it at once get the same."""
    state = request.app.state
    with _FIRST:
        if not hasattr(state, "trends"):
            state.trends = Seen()
    seen: Seen = state.trends
    return seen


@dataclass(frozen=True, eq=False)
class Asked:
    """The project and the record that a request is about."""

    file: ProjectFile
    project: Project
    plan: ExperimentPlan

    @property
    def version(self) -> Any:
        """Of the project and all its records, on which answers depend."""
        return self.file.version, *(signature(self.project, plan) for plan in self.project.experiments)


def asked_by(request: Request, k: Any = None, fetched: bool = True) -> Asked:
    """The record `k`, or that of the query; `fetched`: a snapshot of a historian that is there is taken as it is."""
    file = project_of(request)
    project = file.load()
    plans = project.experiments
    if not plans:
        raise ProjectError(f"{file.name}: names no data: set data.files, or choose a file on the page Start")
    if project.data.source is not None and not (fetched and plans[0].path.is_file()):
        ensure(project)
    number = str(request.query_params.get("record", "0") if k is None else k)
    if not number.isdigit() or int(number) >= len(plans):
        raise HTTPException(400, "There is no such record in this project.")
    return Asked(file, project, plans[int(number)])


def shown_to(seen: Seen, asked: Asked) -> Shown:
    """The record without what is struck, as far as that is known yet."""
    shown = seen.records.get(asked.project, asked.plan)
    own = [(one["from"], one["to"], ALL) for one in exclusions(asked.project, asked.plan, shown.calendar)]
    struck = (*seen.struck.get((asked.file.path, asked.plan.name), ()), *own)
    return seen.records.struck(asked.project, asked.plan, struck)
