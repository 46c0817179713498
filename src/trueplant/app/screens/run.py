"""One button: the analysis, its stages as they pass, the time left, and what came of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Hashable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app import levels
from trueplant.app.checked import told_check
from trueplant.app.command_lines import command, run_line
from trueplant.app.folder import ProjectFile
from trueplant.app.jobs import Job, Jobs
from trueplant.app.pages import body, folder_of, ok, page, project_of, streamed
from trueplant.app.saved import read_saved
from trueplant.app.screens.aside import Question
from trueplant.app.screens.asking import seen_by
from trueplant.app.screens.records import signature
from trueplant.errors import OutputError, TrueplantError
from trueplant.output import claim_results
from trueplant.project import ExperimentPlan, Project


async def run(request: Request) -> Response:
    """The page, with the analysis that runs or ran last."""
    project = project_of(request)
    job = _jobs(request).of(project)
    blocked = await run_in_threadpool(_blocked, project)
    earlier = await run_in_threadpool(_earlier, project)
    told = {"job": None if job is None else _told(request, job), "blocked": blocked, "screens": _screens(request)}
    return page(
        request,
        "run.html.j2",
        screen="run",
        told=told,
        earlier=earlier,
        line=run_line(project),
        check_line=command("check", project.name),
    )


async def check(request: Request) -> Response:
    """What the data are good for, before anything is run; the process that looks at data for the trends says it."""
    project, plain = project_of(request), folder_of(request).plain
    try:
        asked = await run_in_threadpool(_ask, request, project)
    except TrueplantError as error:
        return ok({"error_said": plain(str(error))})
    while not asked.ended.is_set():
        await asyncio.sleep(levels.LOOKED_EVERY)
    if asked.answer is None:
        given_up = "The look at the data was given up for another one: load the page again."
        return ok({"error_said": plain(asked.error) or given_up})
    return ok(told_check(asked.answer))


async def start(request: Request) -> Response:
    """Begin an analysis. `force`: also where files that no run wrote would be replaced."""
    project = project_of(request)
    asked = await body(request)
    job = await run_in_threadpool(_jobs(request).start, project, asked.get("force") is True)
    return ok(_told(request, job))


async def cancel(request: Request) -> Response:
    """End the analysis; an earlier result stays."""
    job = _asked_job(request, str((await body(request)).get("id", "")))
    await run_in_threadpool(_jobs(request).cancel, job.id)
    return ok(_told(request, job))


async def events(request: Request) -> Response:
    """The stages as they pass, as server-sent events."""
    job = _asked_job(request, request.query_params.get("id", ""))

    async def told() -> AsyncIterator[dict[str, Any]]:
        async for _ in job.events():
            yield _told(request, job)

    return streamed(told())


def _jobs(request: Request) -> Jobs:
    jobs: Jobs = request.app.state.jobs
    return jobs


def _ask(request: Request, project: ProjectFile) -> Question:
    """The same question as that of the trends, whose answer then serves both."""
    declared = project.load()
    version = project.version, *(_signature(declared, plan) for plan in declared.experiments)
    return seen_by(request).aside.ask("check", project.path, version)


def _signature(project: Project, plan: ExperimentPlan) -> Hashable:
    """None for a record that is not there: what is to be done about it, the check says."""
    try:
        return signature(project, plan)
    except OSError:
        return None


def _asked_job(request: Request, id: str) -> Job:
    """Only one of the page's own project."""
    job = _jobs(request).get(id)
    if job is None or job.project != project_of(request).name:
        raise HTTPException(404, "This analysis is not known any more: load the page again.")
    return job


def _told(request: Request, job: Job) -> dict[str, Any]:
    """With messages that do not speak of this machine's folders."""
    return job.told() | {"error": folder_of(request).plain(job.error)}


def _screens(request: Request) -> list[str]:
    """Those that a link may lead to."""
    return sorted(request.app.state.screens)


def _blocked(project: ProjectFile) -> str:
    """Why the results cannot be written as things are; empty where they can."""
    try:
        claim_results(project.out, project.load())
    except OutputError as error:
        return project.folder.plain(str(error))
    except TrueplantError:
        return ""  # what is wrong with the project, the check says
    return ""


def _earlier(project: ProjectFile) -> str:
    """What the result that is there says; empty without one."""
    try:
        found = read_saved(project.out)
    except TrueplantError as error:
        return project.folder.plain(str(error))
    return "" if found is None else found.shift


ROUTES = [
    Route("/run", run),
    Route("/api/run/check", check),
    Route("/api/run/start", start, methods=["POST"]),
    Route("/api/run/cancel", cancel, methods=["POST"]),
    Route("/api/run/events", events),
]
