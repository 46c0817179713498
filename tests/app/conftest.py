"""The app as its users have it: a folder with the demo, the server on it, a browser that is logged in."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.browser import ARGUMENTS, Problems, Server, chromium_path, enter
from trueplant.cli.analyse import demo_text
from trueplant.notebook.saved import analyse_into
from trueplant.project import Project
from trueplant.project.simulation import as_file, simulate_record


@pytest.fixture(scope="session")
def demo_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the splitter's project file and its record; not to be changed."""
    folder = tmp_path_factory.mktemp("demo")
    text = demo_text("splitter")
    project = Project.from_toml(text, folder)
    record = project.data.files[0]
    (folder / record).write_bytes(as_file(simulate_record(project), record))
    (folder / "project.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def demo_folder(demo_files: Path, tmp_path: Path) -> Path:
    """The same for one test, which may change it."""
    return Path(shutil.copytree(demo_files, tmp_path / "plant"))


@pytest.fixture
def server(demo_folder: Path) -> Iterator[Server]:
    """The app on `demo_folder`, on a free port."""
    running = Server.start(demo_folder, demo_folder)
    yield running
    running.end()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser; each test has its own profile in it.

    It ends with its module: as long as it is there no other test of this process can run an event loop.
    """
    path = chromium_path()
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=60_000)  # milliseconds, for a busy machine
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        yield browser
        browser.close()


@pytest.fixture
def problems() -> Problems:
    """What went wrong on the pages of a test; `problems.expect(pattern)` says what it provokes."""
    return Problems()


@pytest.fixture
def page(chromium: Any, server: Server, problems: Problems) -> Iterator[Any]:
    """A page that has entered the app on `server`. Console errors and violations of the policy fail the test."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    problems.watch(page)
    enter(page, server)
    yield page
    context.close()
    assert not problems.unexpected()


@pytest.fixture(scope="session")
def analysed_files(demo_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with the result of its analysis; not to be changed."""
    folder = Path(shutil.copytree(demo_files, tmp_path_factory.mktemp("analysed") / "plant"))
    project = Project.load(folder / "project.toml")
    analyse_into(project, folder / "project-result")
    return folder
