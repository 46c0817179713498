"""Analyses beside the app: the same result as the command's, cancelled at once, and their death said."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from app.browser import Server
from trueplant.app.folder import Folder, Outside, ProjectFile
from trueplant.app.jobs import STAGES, Job, Jobs
from trueplant.cli import main
from trueplant.errors import ProjectError, UsageError
from trueplant.output import read_results

WAIT = 120.0


@pytest.fixture
def jobs() -> Iterator[Jobs]:
    made = Jobs(warm=False)
    yield made
    made.close()


@pytest.fixture
def project(demo_folder: Path) -> ProjectFile:
    return Folder(demo_folder).project("project.toml")


def wait_for(reached: Callable[[], bool], seconds: float = WAIT) -> None:
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.005)


def analysing(job: Job) -> bool:
    assert not job.finished, job.error
    return job.stage.startswith("estimating")


def everything(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow
def test_the_result_is_that_of_the_command(
    project: ProjectFile, jobs: Jobs, demo_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[dict[str, Any]] = []

    async def follow() -> None:
        async for event in jobs.start(project).events():
            told.append(event)

    asyncio.run(follow())
    assert told[-1]["state"] == "done" and not told[-1]["error"]
    names = [one["name"] for one in told[-1]["stages"]]
    assert names[0] == "loading the program" and names[-1] == "writing the files" and len(set(names)) > 8
    assert told[-1]["headline"] == read_results(project.out).headline
    states = [event["state"] for event in told]
    assert states == sorted(states, key=["waiting", "running", "done"].index)

    own = Path(shutil.copytree(demo_files, tmp_path / "command"))
    monkeypatch.chdir(own)
    assert main(["run", "project.toml"]) == 0
    made, same = everything(project.out), everything(own / "project-result")
    assert set(made) == {*same, STAGES}
    for name, content in same.items():
        if name != "report.html":
            assert made[name] == content, name
    assert json.loads(made["result.json"])["files"].keys() == json.loads(same["result.json"])["files"].keys()

    again = jobs.start(project)
    wait_for(lambda: again.left is not None and again.state == "running")
    assert 0 < (again.left or 0) < 10 * told[-1]["seconds"]
    jobs.cancel(again.id)
    assert everything(project.out) == made, "an earlier result stays whole"


def test_a_cancelled_one_is_dead_at_once(project: ProjectFile, jobs: Jobs) -> None:
    job = jobs.start(project)
    wait_for(lambda: analysing(job))
    assert job._process is not None
    process = psutil.Process(job._process.pid)
    began = time.monotonic()
    jobs.cancel(job.id)
    assert time.monotonic() - began < 1.0
    assert not process.is_running() and job.state == "cancelled"
    assert not project.out.exists()
    jobs.cancel(job.id)
    assert job.state == "cancelled"


def test_one_that_was_killed_is_said(project: ProjectFile, jobs: Jobs) -> None:
    job = jobs.start(project)
    wait_for(lambda: analysing(job))
    assert job._process is not None
    os.kill(job._process.pid, signal.SIGKILL)
    wait_for(lambda: job.finished, 10)
    assert job.state == "failed" and "signal 9" in job.error and "memory" in job.error
    assert jobs.of(project) is job


def test_one_at_a_time_of_a_project(project: ProjectFile, jobs: Jobs) -> None:
    job = jobs.start(project)
    with pytest.raises(UsageError, match="running already"):
        jobs.start(project)
    jobs.cancel(job.id)
    second = jobs.start(project)
    assert jobs.of(project) is second and jobs.get(job.id) is job
    assert jobs.get("nothing") is None


def test_files_of_others_are_not_replaced(project: ProjectFile, jobs: Jobs) -> None:
    project.out.mkdir()
    (project.out / "result.json").write_text("mine")
    job = jobs.start(project)
    wait_for(lambda: job.finished)
    assert job.state == "failed" and "no earlier run wrote" in job.error
    assert (project.out / "result.json").read_text() == "mine"


def test_what_cannot_be_analysed_is_said(project: ProjectFile, jobs: Jobs) -> None:
    record = project.path.parent / "record.csv"
    record.write_text("\n".join(record.read_text().split("\n")[:3]) + "\n")
    job = jobs.start(project)
    wait_for(lambda: job.finished)
    assert job.state in ("failed", "refused") and (job.error or job.headline)


def test_a_bad_project_begins_nothing(project: ProjectFile, jobs: Jobs) -> None:
    project.change(lambda text: "time_unit = 3\n", check=False)
    with pytest.raises(ProjectError):
        jobs.start(project)
    project.change(lambda text: '[data]\nfiles = ["../x.csv"]\n', check=False)
    with pytest.raises(Outside):
        jobs.start(project)
    assert jobs.of(project) is None


def test_one_is_kept_warm(project: ProjectFile) -> None:
    jobs = Jobs()
    try:
        jobs.warm()
        first = jobs._warm
        assert first is not None
        jobs.warm()
        assert jobs._warm is first
        job = jobs.start(project)
        assert job._process is first
        jobs.cancel(job.id)
        assert jobs._warm is not None and jobs._warm is not first and jobs._warm.alive
        second = psutil.Process(jobs._warm.pid)
    finally:
        jobs.close()
    assert not second.is_running()
    with pytest.raises(UsageError):
        jobs.start(project)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_no_process_is_left(demo_folder: Path, number: int) -> None:
    server = Server.start(demo_folder, demo_folder)
    wait_for(lambda: bool(server.children()), 30)
    status = server.end(number)
    assert status == {signal.SIGTERM: 0, signal.SIGINT: 130, signal.SIGKILL: -9}[signal.Signals(number)]
    if number == signal.SIGINT:
        assert not any("Traceback" in line for line in server.lines)


@pytest.mark.slow
def test_an_orphan_ends_in_the_middle_of_its_work(project: ProjectFile) -> None:
    script = f"""
import sys, time
from pathlib import Path
from trueplant.app.folder import Folder
from trueplant.app.jobs import Jobs
jobs = Jobs(warm=False)
job = jobs.start(Folder(Path({str(project.path.parent)!r})).project("project.toml"))
while not job.stage.startswith("estimating"):
    time.sleep(0.01)
print(job._process.pid, flush=True)
time.sleep(600)
"""
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.communicate()
    assert not psutil.wait_procs([worker], timeout=10)[1]
    assert not project.out.exists()


@pytest.mark.slow
def test_a_taken_port_is_one_message(server: Server, demo_folder: Path) -> None:
    port = server.address.rsplit(":", 1)[1]
    second = subprocess.run(
        [sys.executable, "-m", "trueplant", "app", str(demo_folder), "--no-browser", "--port", port],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert second.returncode == 2 and second.stdout == ""
    assert second.stderr.count("\n") == 1 and "--port" in second.stderr
