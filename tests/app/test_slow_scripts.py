"""What a user does before the scripts of a page have come is not lost, and never shows what is not so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Route, expect

from app.browser import Server, change
from app.tried import short


@pytest.fixture
def demo_folder(tmp_path: Path) -> Path:
    return short(tmp_path / "plant")


class Held:
    """A script that is kept back until it is let through."""

    def __init__(self, page: Any, name: str) -> None:
        self._page, self._waiting = page, list[Route]()
        page.route(f"**/static/{name}", lambda route: self._waiting.append(route), times=1)

    def let_through(self) -> None:
        while not self._waiting:
            self._page.wait_for_timeout(20)
        self._waiting[0].continue_()


def test_settings_are_in_the_form_that_was_chosen_before_the_script_came(page: Any, server: Server) -> None:
    held = Held(page, "out.js")
    page.goto(server.url("/out"), wait_until="commit")
    before = page.inner_text("#settings")
    page.select_option("#vendor", "Rockwell PIDE independent")
    assert page.inner_text("#settings") == before
    held.let_through()
    expect(page.locator("#settings")).not_to_have_text(before)


def test_the_analysis_cannot_be_asked_for_before_the_script_came(page: Any, server: Server) -> None:
    held = Held(page, "run.js")
    page.goto(server.url("/run"), wait_until="commit")
    expect(page.locator("#start")).to_be_disabled()
    held.let_through()
    expect(page.locator("#start")).to_be_enabled()


def test_nothing_can_be_undone_before_the_script_came(page: Any, server: Server, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    before = file.read_text()
    page.goto(server.url("/tags"))
    change(page, "K")
    expect(page.locator("#undo")).to_be_enabled()
    held = Held(page, "app.js")
    page.reload(wait_until="commit")
    expect(page.locator("#undo")).to_be_disabled()
    held.let_through()
    page.click("#undo")
    page.wait_for_selector("#redo:enabled")
    assert file.read_text() == before
