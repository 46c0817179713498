"""The screens Model, What if and Plan as somebody uses them, with pointer and keyboard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.browser import Problems, Server
from app.tried import short
from trueplant.project import Project

pytestmark = pytest.mark.slow
DRAWN = "() => Number(document.getElementById('desk').dataset.drawn || 0)"
JUDGED = "() => !document.getElementById('desk').classList.contains('old')"


@pytest.fixture
def demo_folder(tmp_path: Path) -> Path:
    """Of this file's server: a project with its result."""
    return short(tmp_path / "plant")


@pytest.fixture
def desk(page: Any, server: Server) -> Any:
    page.goto(server.url("/whatif"))
    page.wait_for_selector("#desk:not([hidden])", timeout=120_000)
    page.wait_for_function(JUDGED, timeout=120_000)
    return page


def curve(page: Any) -> list[float]:
    """PV after a set-point step with what is tried: the median."""
    found: list[float] = page.evaluate("() => Array.from(document.getElementById('curves').data[5].y)")
    return found


def test_a_slider_moves_the_curves_by_keyboard(desk: Any) -> None:
    slider, field = desk.get_by_label("reflux Kc", exact=True), desk.locator("#reflux-Kc")
    before, number, drawn = curve(desk), float(field.input_value()), desk.evaluate(DRAWN)
    slider.focus()
    for _ in range(25):
        desk.keyboard.press("ArrowRight")
    desk.wait_for_function(f"() => Number(document.getElementById('desk').dataset.drawn) > {drawn}")
    desk.wait_for_function(JUDGED, timeout=60_000)
    assert float(field.input_value()) == pytest.approx(number * 100 ** (25 / 200), rel=0.02)
    after = curve(desk)
    middle = len(after) // 8
    assert after[middle] > before[middle]  # a larger gain is there sooner
    assert slider.get_attribute("aria-valuetext") == f"{float(field.input_value()):.4g}"
    assert desk.evaluate(DRAWN) < drawn + 26 + 3  # positions were overtaken, or at least not asked for twice
    assert desk.locator("#numbers tbody tr").count() >= 9
    assert "tried" in desk.locator("#numbers thead").inner_text()


def test_a_preset_a_number_and_back_to_today(desk: Any) -> None:
    desk.get_by_role("button", name="Ours (recommended)").click()
    desk.wait_for_function(JUDGED, timeout=60_000)
    assert desk.locator("#verdict .headline").inner_text() == "Recommended"
    assert "OP moves" in desk.locator("#verdict").inner_text()
    desk.fill("#reflux-Kc", "30")
    desk.wait_for_selector("#numbers .over", timeout=60_000)
    desk.wait_for_function(JUDGED, timeout=60_000)
    assert desk.locator("#verdict .headline").inner_text() == "Not recommended"
    assert desk.locator("#numbers td.over").first.inner_text() != ""
    desk.get_by_role("button", name="Today", exact=True).click()
    desk.wait_for_function(JUDGED, timeout=60_000)
    assert desk.locator("#verdict .headline").inner_text() == "These are today's settings"
    assert desk.locator("#numbers .over").count() == 0
    assert desk.locator("#save").is_disabled()


def test_what_is_tried_is_saved_and_undone(desk: Any, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    before = file.read_text()
    desk.fill("#fuel_gas-Ti", "2.5")
    desk.wait_for_function("() => !document.getElementById('save').disabled", timeout=60_000)
    desk.click("#save")
    desk.wait_for_selector("#said p")
    assert [(one.input, one.Ti) for one in Project.load(file).candidates] == [("fuel_gas", 2.5)]
    assert "[[candidate]]" in desk.locator("#text").text_content()
    desk.click("#undo")
    desk.wait_for_selector("#redo:enabled", timeout=60_000)
    assert file.read_text() == before


def test_a_wrong_formula_says_why_and_keeps_the_file(page: Any, server: Server, demo_folder: Path) -> None:
    file = demo_folder / "project.toml"
    before = file.read_text()
    page.goto(server.url("/model"))
    page.get_by_role("button", name="top temperature from fuel gas").press("Enter")
    page.wait_for_selector("#typed svg")
    page.fill("input[name=tf]", "3.2 exp(-3 s)/(18 s + )")
    page.wait_for_selector("#typed .wrong")
    assert "column" in page.locator("#typed .wrong").inner_text()
    assert page.locator("input[name=tf]").get_attribute("aria-invalid") == "true"
    page.locator("input[name=tf]").press("Enter")
    page.wait_for_selector("#said p")
    assert file.read_text() == before
    page.fill("input[name=tf]", "3.5 exp(-3 s)/(18 s + 1)")
    page.wait_for_selector("#typed svg")
    page.locator("input[name=tf]").press("Enter")
    page.wait_for_function(
        "() => document.querySelector('[data-input=fuel_gas] .formula').textContent.startsWith('3.5')"
    )
    assert 'tf = "3.5 exp(-3 s)/(18 s + 1)"' in file.read_text()
    page.locator("input[name=tf]").press("Escape")
    assert page.locator("#editor").is_hidden()


def test_the_replay_is_shown_and_follows_a_change(page: Any, server: Server) -> None:
    page.goto(server.url("/model"))
    page.wait_for_selector("#replay .replayed.yes svg.trend", timeout=60_000)
    assert page.locator("#replay .replayed.yes").count() == 2
    law = page.locator("form.law[data-input=reflux]")
    law.locator("[data-key=Ti]").fill("4")
    law.get_by_role("button", name="Save").click()
    page.wait_for_selector("#replay .replayed.no svg.trend", timeout=60_000)
    assert "integral time 2.0" in page.locator("#replay .replayed.no").inner_text()


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 1280), ("light", 390), ("dark", 390)])
@pytest.mark.parametrize(
    ("screen", "ready"),
    [("/model", "#replay[data-state=done]"), ("/whatif", "#desk[data-judged]"), ("/plan", ".plan[data-drawn=yes]")],
)
def test_light_dark_and_phone(
    page: Any, server: Server, problems: Problems, screen: str, ready: str, scheme: Any, width: int
) -> None:
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 844})
    page.goto(server.url(screen))
    page.wait_for_selector(ready, timeout=120_000)
    over = page.evaluate("() => document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert over <= 0
    bare = page.evaluate(
        "() => [...document.querySelectorAll('main input, main select')].filter(e => e.offsetParent "
        "&& !e.labels?.length && !e.getAttribute('aria-label')).map(e => e.outerHTML)"
    )
    assert bare == []
    assert problems.unexpected() == []
