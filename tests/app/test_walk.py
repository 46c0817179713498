"""All pages in a real browser: light, dark and on a phone, before an analysis and after it."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import TimeoutError as TooLate

from app.browser import Problems, Server, enter
from trueplant.app.pages import SCREENS
from trueplant.app.screens import ROUTES

PAGES = [route.path for route in ROUTES if route.path.count("/") == 1 and "GET" in (route.methods or ())]
LOOKS: dict[str, dict[str, Any]] = {
    "light": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "light"},
    "dark": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "dark"},
    "phone": {"viewport": {"width": 390, "height": 844}, "color_scheme": "light"},
}
PICTURES = Path(__file__).parents[2] / "build" / "app-pictures"
"""Of every page, to be looked at."""
UNNAMED = """() => [...document.querySelectorAll("input, select, textarea, button, a[href]")].filter((one) =>
    one.type !== "hidden" && one.checkVisibility() && !one.labels?.length && !one.textContent.trim()
    && !one.getAttribute("aria-label") && !one.getAttribute("aria-labelledby") && !one.title
).map((one) => one.outerHTML.slice(0, 200))"""
TOO_WIDE = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"


def test_every_step_has_its_page() -> None:
    assert {f"/{screen}" for screen in SCREENS} <= set(PAGES)


@pytest.mark.slow
@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize("stage", ["new", "analysed"])
def test_no_page_has_a_problem(
    chromium: Any, demo_files: Path, analysed_files: Path, tmp_path: Path, stage: str, look: str
) -> None:
    folder = Path(shutil.copytree(demo_files if stage == "new" else analysed_files, tmp_path / "plant"))
    server = Server.start(folder, folder)
    context = chromium.new_context(**LOOKS[look])
    page, problems, found = context.new_page(), Problems(), []
    problems.watch(page)
    enter(page, server)
    for path in PAGES:
        problems.clear()
        answer = page.goto(server.url(path))
        with contextlib.suppress(TooLate):  # a page that follows something is never idle
            page.wait_for_load_state("networkidle", timeout=20_000)
        page.screenshot(path=PICTURES / f"{path.strip('/')}-{stage}-{look}.png", full_page=True)
        if answer is None or answer.status != 200:
            found.append(f"{path}: {answer and answer.status}")
        if page.locator("h1").count() != 1:
            found.append(f"{path}: {page.locator('h1').count()} headings")
        found += [f"{path}: {problem}" for problem in problems.unexpected()]
        found += [f"{path}: without a name: {one}" for one in page.evaluate(UNNAMED)]
        if (wide := page.evaluate(TOO_WIDE)) > 1:
            found.append(f"{path}: {wide} pixels too wide")
    context.close()
    server.end()
    assert not found
