"""The frame around all screens, in a real browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.browser import Server


def test_the_link_opens_the_app_once(page: Any, server: Server, chromium: Any) -> None:
    assert page.locator("header.frame nav li").all_inner_texts() == [
        "Start", "Tags", "Trends", "Model", "Run", "Verdict", "What if", "Plan", "Out"
    ]  # fmt: skip
    context = chromium.new_context()
    other = context.new_page()
    answer = other.goto(server.link)
    assert answer is not None and answer.status == 401
    assert "trueplant app" in other.inner_text("main")
    context.close()


def test_who_is_out_gets_in_by_a_new_link_on_the_terminal(server: Server, chromium: Any) -> None:
    context = chromium.new_context()
    page = context.new_page()
    page.goto(server.address + "/")
    page.click("button")
    page.get_by_text("stands on the terminal now").wait_for()
    page.goto(server.link)
    page.wait_for_selector("header.frame")
    context.close()


def test_a_change_is_undone_by_the_keyboard(page: Any, server: Server, demo_folder: Path) -> None:
    project = demo_folder / "project.toml"
    assert project.is_file()
