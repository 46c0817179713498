"""The two pictures of the app in the README, from a real Chromium on the splitter's demo: make pictures."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from app.browser import ARGUMENTS, Server, chromium_path, enter
from trueplant.cli import main as command

HERE = Path(__file__).parent
LONG = 240_000
"""Milliseconds that an analysis may take."""


def main() -> None:
    with tempfile.TemporaryDirectory() as made, sync_playwright() as playwright:
        folder = Path(made)
        shutil.copy(HERE.parent / "src" / "trueplant" / "cli" / "demos" / "splitter.toml", folder / "project.toml")
        for line in (
            ["simulate", "--out", str(folder / "record.csv")],
            ["run", "--out", str(folder / "project-result")],
        ):
            if command([line[0], str(folder / "project.toml"), *line[1:]]):
                sys.exit(f"trueplant {line[0]} failed")
        server = Server.start(folder / "project.toml", folder)
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=list(ARGUMENTS))
        try:
            page = browser.new_page(viewport={"width": 1280, "height": 860})
            page.set_default_timeout(LONG)
            enter(page, server)
            page.goto(server.url("/verdict"))
            page.locator("#matrix button").first.click()
            page.locator("#figure-1 .plot-container").wait_for()
            taken(page, "app-verdict.png")
            page.goto(server.url("/whatif"))
            page.locator("#desk:not([hidden])").wait_for()
            page.locator("#desk input[type=range]").first.focus()
            for _ in range(20):
                page.keyboard.press("ArrowRight")
            page.locator("#verdict .headline").wait_for()
            page.wait_for_load_state("networkidle")
            taken(page, "app-whatif.png")
        finally:
            browser.close()
            server.end()


def taken(page: Any, name: str) -> None:
    page.evaluate("scrollTo(0, 0)")
    page.screenshot(path=HERE / "_static" / name)


if __name__ == "__main__":
    main()
