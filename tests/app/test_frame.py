"""The frame around all screens, in a real browser: getting in, undoing, two tabs, the policy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from playwright.sync_api import expect

from app.browser import Problems, Server, change, enter


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
    server.ask_for_another_link(page, page.locator("button"))
    enter(page, server)
    context.close()


def test_the_link_opens_the_project_that_was_named(demo_folder: Path, chromium: Any) -> None:
    running = Server.start(demo_folder / "project.toml", demo_folder)
    context = chromium.new_context()
    page = context.new_page()
    enter(page, running)
    page.wait_for_url("**project=project.toml**")
    assert page.locator("header.frame .of").inner_text() == "project.toml"
    context.close()
    running.end()


def test_a_change_is_undone_and_made_again_by_the_keyboard(page: Any, server: Server, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    before = file.read_text()
    page.goto(server.url("/tags"))
    undo, redo = page.locator("#undo"), page.locator("#redo")
    expect(undo).to_be_disabled()
    change(page, "K")
    after = file.read_text()
    assert after == before.replace('unit = "degC"', 'unit = "K"')
    expect(undo).to_be_enabled()
    page.keyboard.press("Control+z")
    expect(redo).to_be_enabled()
    expect(undo).to_be_disabled()
    assert file.read_text() == before
    page.keyboard.press("Control+Shift+Z")
    expect(undo).to_be_enabled()
    assert file.read_text() == after
    undo.click()
    expect(redo).to_be_enabled()
    assert file.read_text() == before


def test_of_two_tabs_the_older_overwrites_nothing(
    page: Any, server: Server, demo_folder: Path, problems: Problems
) -> None:
    problems.expect("409")
    other = page.context.new_page()
    problems.watch(other)
    for tab in (page, other):
        tab.goto(server.url("/tags"))
        tab.locator("#undo").wait_for()
    change(page, "K")
    change(other, "degF")
    expect(other.get_by_role("alert").filter(has_text="has changed since")).to_be_visible()
    assert 'unit = "K"' in (demo_folder / "project.toml").read_text()
    other.close()


def test_who_was_away_for_too_long_is_told_how_to_get_in(page: Any, server: Server, problems: Problems) -> None:
    problems.expect("401")
    page.goto(server.url("/tags"))
    page.context.clear_cookies()
    change(page, "K")
    page.get_by_text("not logged in").wait_for()
    server.ask_for_another_link(page, page.get_by_role("button", name="Show a new link"))
    enter(page, server)


def test_an_app_that_has_ended_is_said(page: Any, server: Server, problems: Problems) -> None:
    problems.expect("net::ERR")
    page.goto(server.url("/tags"))
    assert server.end() == 0
    change(page, "K")
    expect(page.get_by_role("alert").filter(has_text="does not answer")).to_be_visible()


def test_the_policy_holds_against_a_script_in_the_page(page: Any, server: Server, problems: Problems) -> None:
    problems.expect("Content Security Policy")
    problems.expect("404")
    page.goto(server.url("/tags"))
    run = page.evaluate(
        """() => {
            const script = document.createElement("script");
            script.textContent = "window.broken = 1";
            document.body.append(script);
            const image = document.createElement("img");
            image.setAttribute("onerror", "window.broken = 2");
            image.src = "/static/nothing.svg";
            document.body.append(image);
            return new Promise((done) => setTimeout(() => done(window.broken), 500));
        }"""
    )
    assert run is None
    assert sum("Content Security Policy" in one for one in problems) >= 2
