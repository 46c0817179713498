"""From the demo to a new model in a real browser: run, cancelled, run, read, opened, taken along, accepted."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from app.browser import Server
from app.results import demo, result_json, unbroken
from trueplant.cli import main
from trueplant.output import read_results

pytestmark = pytest.mark.slow
LONG = 300_000
"""Milliseconds that an analysis may take on a busy machine."""


def numbers(document: dict[str, Any]) -> dict[str, Any]:
    """Of a result.json: all but where and by which version it was made."""
    return {key: value for key, value in document.items() if key not in ("provenance", "files")}


def test_from_the_demo_to_a_new_model(
    page: Any, server: Server, demo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.goto(server.url("/run"))
    page.wait_for_selector("#check .note")
    assert "record can be used" in page.inner_text("#check .note")
    page.click("#start")
    page.wait_for_selector("#stages .now:has-text('estimating')", timeout=LONG)
    assert page.inner_text("#start") == "Running …" and page.is_disabled("#start")
    page.click("#cancel")
    page.wait_for_selector("#outcome .cancelled")
    assert not (demo_folder / "project-result" / "result.json").exists()
    assert page.evaluate("document.activeElement.id") == "start"

    page.click("#start")
    page.wait_for_selector("#stages .now")
    page.goto(server.url("/verdict"))  # leave ...
    assert "There is no result of this project yet" in page.inner_text("main")
    page.goto(server.url("/run"))  # ... and come back
    page.wait_for_selector("#stages .now")
    page.wait_for_selector("#outcome .done", timeout=LONG)
    document = result_json(demo_folder)
    assert document["headline"].replace("->", "→") in page.inner_text("#outcome")

    page.click("#outcome a")
    page.wait_for_url("**/verdict?*")
    assert page.inner_text("#shift") == unbroken(document["shift"])
    assert page.inner_text("#headline") == unbroken(document["headline"])
    for element in document["elements"]:
        button = page.locator(f"#matrix button[data-output={element['output']}][data-input={element['input']}]")
        assert element["verdict"] in button.inner_text()
        button.click()
        page.wait_for_selector(f"#element-title:text-is('{title(element)}')")
        page.wait_for_selector("#figure-1 .plot-container")
        shown = page.inner_text("#element .parameters")
        for p in element["parameters"]:
            assert p["name"].replace("_", " ") in shown
    page.evaluate("document.getElementById('figure-3').scrollIntoView()")
    page.wait_for_selector("#figure-3 .plot-container")
    page.click("#element .back")
    assert page.is_hidden("#element")

    page.goto(server.url("/out"))
    with page.expect_download() as saving:
        page.click("tr:has-text('parameters.csv') a[download]")
    assert saving.value.suggested_filename == "project-parameters.csv"
    with page.context.expect_page() as opening:
        page.click("tr:has-text('report.html') a:has-text('Open')")
    report = opening.value
    report.wait_for_selector(".plot .plot-container")  # its own script runs under its own policy
    assert report.inner_text("h1") == unbroken(document["shift"])
    report.close()

    page.wait_for_selector("#accept:not([disabled])")
    before = (demo_folder / "project.toml").read_text()
    page.click("#accept")
    page.wait_for_selector("#accept-state:has-text('the model is now the plant')")
    accepted = (demo_folder / "project.toml").read_text()
    assert accepted != before and (demo_folder / "project.toml.bak").read_text() == before
    page.click("#undo")
    page.wait_for_selector("#accept-ways:not([hidden])")
    assert (demo_folder / "project.toml").read_text() == before

    monkeypatch.chdir(demo_folder)
    shutil.move("project-result", "from-the-app")
    assert main(["run", "project.toml"]) == 0
    assert numbers(result_json(demo_folder)) == numbers(document)


def title(element: dict[str, Any]) -> str:
    return f"{element['input']} → {element['output']}".replace("_", " ")


class TestOfTheMill:
    """Pages of a result that is there: four elements in two rows."""

    @pytest.fixture
    def demo_folder(self, tmp_path: Path) -> Path:
        return demo(tmp_path / "plant", "mill")

    def test_the_matrix_by_keyboard_alone(self, page: Any, server: Server, demo_folder: Path) -> None:
        result = read_results(demo_folder / "project-result")
        page.goto(server.url("/verdict"))

        def at() -> tuple[str, str]:
            found: list[str] = page.evaluate(
                "[document.activeElement.dataset.input, document.activeElement.dataset.output]"
            )
            return found[0], found[1]

        for _ in range(40):  # the matrix is one stop on the way through the page
            page.keyboard.press("Tab")
            if page.evaluate("Boolean(document.activeElement.closest('#matrix'))"):
                break
        assert at() == ("ore_feed", "particle_size")
        page.keyboard.press("ArrowRight")
        assert at() == ("dilution_water", "particle_size")
        page.keyboard.press("ArrowDown")
        assert at() == ("dilution_water", "circulating_load")
        page.keyboard.press("ArrowDown")  # there is no more below
        assert at() == ("dilution_water", "circulating_load")
        page.keyboard.press("Home")
        assert at() == ("ore_feed", "circulating_load")
        page.keyboard.press("End")
        page.keyboard.press("Enter")
        page.wait_for_selector("#element:not([hidden]) #figure-1 .plot-container")
        assert page.evaluate("document.activeElement.id") == "element-title"
        assert page.inner_text("#element-title") == "dilution water → circulating load"
        element = next(e for e in result.elements if (e.input, e.output) == ("dilution_water", "circulating_load"))
        assert f"{element.parameters[0].plant:.2f}"[:4] in page.inner_text("#element .parameters")
        assert page.get_attribute("#matrix button[aria-expanded=true]", "data-input") == "dilution_water"
        page.keyboard.press("Escape")
        assert at() == ("dilution_water", "circulating_load") and page.is_hidden("#element")
        page.keyboard.press("Tab")
        assert not page.evaluate("Boolean(document.activeElement.closest('#matrix'))")

    def test_an_opened_element_has_an_address(self, page: Any, server: Server) -> None:
        page.goto(server.url("/verdict"))
        page.click("#matrix button >> nth=2")
        page.wait_for_selector("#element-title")
        said = page.inner_text("#element-title")
        page.reload()
        page.wait_for_selector("#element-title")
        assert page.inner_text("#element-title") == said

    def test_figures_follow_light_and_dark(self, page: Any, server: Server) -> None:
        page.emulate_media(color_scheme="light")
        page.goto(server.url("/verdict"))
        page.click("#matrix button >> nth=0")
        page.wait_for_selector("#figure-1 .plot-container")
        ink = "getComputedStyle(document.querySelector('#figure-1 .xtick text')).fill"
        light = page.evaluate(ink)
        page.emulate_media(color_scheme="dark")
        for _ in range(100):
            if page.evaluate(ink) != light:
                break
            page.wait_for_timeout(50)
        channels = [int(one) for one in re.findall(r"\d+", page.evaluate(ink))[:3]]
        assert min(channels) > 150  # light ink on dark paper

    @pytest.mark.parametrize("scheme", ["light", "dark"])
    @pytest.mark.parametrize("width", [1280, 390])
    def test_nothing_is_wider_than_the_screen(self, page: Any, server: Server, scheme: str, width: int) -> None:
        page.set_viewport_size({"width": width, "height": 844})
        page.emulate_media(color_scheme=scheme)
        for path in ("/run", "/verdict", "/out", "/compare", "/track", "/audit"):
            page.goto(server.url(path))
            if path == "/verdict":
                page.click("#matrix button >> nth=0")
                page.wait_for_selector("#figure-1 .plot-container")
            if path == "/run":
                page.wait_for_selector("#check:not([aria-busy])")
            assert page.evaluate("document.documentElement.scrollWidth") <= width, path
            fields = "[...document.querySelectorAll('input:not([type=hidden]), select')]"
            assert page.evaluate(f"{fields}.filter((one) => !one.labels?.length).length") == 0, path

    def test_the_sheet_for_the_shift_is_one_page(self, page: Any, server: Server, demo_folder: Path) -> None:
        page.goto(server.url("/out/shift"))
        assert page.inner_text("h1") == unbroken(result_json(demo_folder)["shift"])
        assert page.pdf(format="A4", prefer_css_page_size=True).count(b"/Type /Page\n") == 1
