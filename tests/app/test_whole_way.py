"""From data to settings in a real browser, and the command line says the same of what was left in the folder."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import polars as pl
import pytest
from playwright.sync_api import expect

from app.browser import Problems, Server, enter, follow
from app.results import unbroken
from trueplant.cli import main

LONG = 240_000
"""Milliseconds for an analysis on a busy machine."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "plant"
    made.mkdir()
    return made


@pytest.fixture
def visit(chromium: Any, folder: Path, problems: Problems) -> Iterator[tuple[Any, Server]]:
    """A page in the app on `folder`, whatever was put there before."""
    running = Server.start(folder, folder)
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    problems.watch(page)
    enter(page, running)
    yield page, running
    context.close()
    running.end()
    assert not problems.unexpected()


def reach(page: Any, wanted: Any, most: int = 150) -> None:
    """Go there with the key Tab alone."""
    wanted.wait_for()
    for _ in range(most):
        if wanted.evaluate("(one) => one === document.activeElement"):
            return
        page.keyboard.press("Tab")
    pytest.fail(f"{wanted} cannot be reached with the keyboard")


@pytest.mark.slow
def test_the_demo_from_its_record_to_other_settings(
    visit: tuple[Any, Server], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chromium: Any
) -> None:
    page, server = visit
    page.get_by_role("button", name="splitter").click()
    page.wait_for_url("**/tags?project=*", timeout=LONG)
    file = folder / unquote(page.url.split("project=")[1])
    out = file.parent / f"{file.stem}-result"
    assert file.is_file()

    follow(page, "Trends", "trends")
    page.locator("#tools").wait_for()
    page.fill("#from", "0")
    page.fill("#to", "4")
    page.get_by_role("button", name="Leave it out").click()
    expect(page.locator("#excluded")).not_to_contain_text("Nothing")
    assert "exclude" in file.read_text()

    follow(page, "Run", "run")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#stages li.now")).to_contain_text("estimating", timeout=LONG)
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#outcome")).to_contain_text("Cancelled", timeout=30_000)
    assert not out.exists()
    page.get_by_role("button", name="Run again").click()
    follow(page, "See the verdict", "verdict", LONG)
    expect(page.get_by_role("heading", level=1)).to_contain_text("25 %")

    other = Path(shutil.copytree(file.parent, tmp_path / "other"))
    shutil.rmtree(other / out.name)
    monkeypatch.chdir(other)
    assert main(["run", file.name]) == 0
    for result in ("result.json", "plant.toml", "curves.json"):
        assert (other / out.name / result).read_bytes() == (out / result).read_bytes()

    follow(page, "What if", "whatif")
    page.locator("#desk").wait_for(timeout=LONG)
    slider = page.locator("#desk input[type=range]").first
    slider.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#save")).to_be_enabled()
    expect(page.locator("#verdict")).not_to_contain_text("Move a slider", timeout=LONG)
    page.locator("#save").click()
    expect(page.get_by_role("status").filter(has_text="andidate")).to_be_visible()
    assert "[[candidate]]" in file.read_text()
    expect(page.locator("#undo")).to_be_enabled()

    assert server.end() == 0
    again = Server.start(file, folder)
    context = chromium.new_context()
    page = context.new_page()
    enter(page, again)
    follow(page, "Verdict", "verdict")
    expect(page.get_by_role("heading", level=1)).to_contain_text("25 %")
    context.close()
    again.end()
    assert main(["run", str(file), "--out", str(tmp_path / "judged")]) == 0
    loop = json.loads((tmp_path / "judged" / "result.json").read_text())["controllers"][0]
    by_hand = next(one for one in loop["proposals"] if one["method"] == "by hand")
    assert by_hand["settings"]["Kc"] != loop["current"]["settings"]["Kc"]


@pytest.mark.slow
def test_a_messy_export_without_a_model_by_the_keyboard_alone(
    folder: Path,
    demo_files: Path,
    chromium: Any,
    problems: Problems,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    columns = {"pv1": "TIC101.PV", "sp1": "TIC101.SP", "op1": "TIC101.OP"}
    record = pl.read_csv(demo_files / "record.csv").rename(columns).select("t", *columns.values())
    lines = ["Schreiber 7;;;;", ";".join(("Zeit", *columns.values(), "Außen"))]
    for k, row in enumerate(record.iter_rows()):
        seconds = 6 * k
        stamp = f"03.11.2025 {seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
        lines.append(";".join([stamp, *(str(value).replace(".", ",") for value in row[1:]), "7,5"]))
    (folder / "export märz.csv").write_bytes("\r\n".join(lines).encode("cp1252"))

    server = Server.start(folder, folder)
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    problems.watch(page)
    enter(page, server)
    reach(page, page.get_by_role("button", name="export märz.csv"))
    page.keyboard.press("Enter")
    expect(page.locator("#facts")).to_contain_text("comma", timeout=LONG)
    expect(page.locator("#rows")).to_contain_text("Außen")
    expect(page.locator("#loops")).to_contain_text("TIC101.PV with TIC101.OP")
    reach(page, page.get_by_role("button", name="Make the project").first)
    page.keyboard.press("Enter")
    page.wait_for_url("**/tags?project=*")
    for step in ("Trends", "Model", "Run"):
        reach(page, page.get_by_role("link", name=step, exact=True))
        page.keyboard.press("Enter")
        page.wait_for_url(f"**/{step.lower()}?project=*")
    reach(page, page.get_by_role("button", name="Run"))
    page.keyboard.press("Enter")
    verdict = page.get_by_role("link", name="See the verdict")
    verdict.wait_for(timeout=LONG)
    reach(page, verdict)
    page.keyboard.press("Enter")
    page.wait_for_url("**/verdict?project=*")
    expect(page.locator("main")).to_contain_text("found")
    (project,) = folder.glob("*.toml")
    result = json.loads((folder / f"{project.stem}-result" / "result.json").read_text())
    (element,) = result["elements"]
    gain = next(one for one in element["parameters"] if one["name"] == "gain")
    assert -0.75 < gain["plant"] < -0.45, "of -0.58, with the other loop's moves as a load that was not recorded"
    out = f"{project.stem}-result"
    other = Path(shutil.copytree(folder, tmp_path / "other"))
    shutil.rmtree(other / out)
    monkeypatch.chdir(other)
    assert main(["run", project.name]) == 0
    assert (other / out / "result.json").read_bytes() == (folder / out / "result.json").read_bytes()
    context.close()
    server.end()
    assert not problems.unexpected()


@pytest.mark.slow
def test_a_real_record_cut_by_hand_and_retuned_by_slider(
    visit: tuple[Any, Server], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, real_data: Path
) -> None:
    """Two heaters under PID, with a spike written into one PV and a stretch in manual into one OP."""
    record = pl.read_csv(real_data / "tclab_pid" / "pid_short_01.csv", infer_schema_length=None)
    t = pl.col("t")
    record = record.with_columns(
        pv1=pl.col("pv1").cast(float) + pl.when(t == 700).then(25.0).otherwise(0.0),
        op2=pl.when(t.is_between(1480, 1530)).then(20.0).otherwise(pl.col("op2").cast(float)),
    )
    record.write_csv(folder / "heaters.csv")
    example = Path(__file__).parents[2] / "examples" / "tclab_pid_short_01.toml"
    file = folder / "heaters.toml"
    text = example.read_text().replace("dataset:tclab_pid/pid_short_01.csv", "heaters.csv")
    text = text.replace('unit = "degC"', 'unit = "degC"\nspan = [0, 120]').replace(
        "limits =", "span = [0, 100]\nlimits ="
    )
    file.write_text(text + "\n[tuning]\n")

    page, server = visit
    page.goto(server.url("/trends", file.name))
    page.locator("#tools").wait_for()
    for first, last in (("699.5", "700.5"), ("1480", "1530")):
        page.fill("#from", first)
        page.fill("#to", last)
        page.get_by_role("button", name="Leave it out").click()
        expect(page.locator("#excluded")).to_contain_text(f"{first} to {last}")
    assert file.read_text().count("1480") == 1

    follow(page, "Run", "run")
    page.get_by_role("button", name="Run").click()
    follow(page, "See the verdict", "verdict", LONG)
    shift = page.get_by_role("heading", level=1).inner_text()
    out = folder / "heaters-result"
    result = json.loads((out / "result.json").read_text())
    assert unbroken(result["shift"]) == shift
    own = [one for one in result["elements"] if one["input"][-1] == one["output"][-1]]
    for element, fits in zip(own, ({"gain": 0.917, "tau1": 167.5}, {"gain": 0.55, "tau1": 182}), strict=True):
        for parameter in element["parameters"]:
            if parameter["name"] in fits:  # what output-error fits of both runs of the rig say
                low, high = parameter["ci"]
                assert low < fits[parameter["name"]] < high

    follow(page, "What if", "whatif")
    page.locator("#desk").wait_for(timeout=LONG)
    slider = page.get_by_label("heater 1 Kp", exact=True)
    slider.focus()
    for _ in range(10):
        page.keyboard.press("ArrowLeft")
    expect(page.locator("#verdict")).not_to_contain_text("Move a slider", timeout=LONG)
    tried = float(page.locator("#heater_1-Kp").input_value())
    page.locator("#save").click()
    expect(page.get_by_role("status").filter(has_text="andidate")).to_be_visible()

    follow(page, "Run", "run")
    page.get_by_role("button", name="Run").first.click()
    follow(page, "See the verdict", "verdict", LONG)
    follow(page, "Out", "out")
    page.select_option("#vendor", "Rockwell PIDE independent")
    mine = page.locator("#settings .loop").filter(has_text="Your own settings")
    expect(mine).to_contain_text(f"{tried * 120 / 100:.4g}")  # in per cent of span over per cent of span
    expect(mine).to_contain_text(f"{0.016388661803 * 120 / 100 * 60:.4g}")  # per minute

    other = Path(shutil.copytree(folder, tmp_path / "other"))
    shutil.rmtree(other / out.name)
    monkeypatch.chdir(other)
    assert main(["run", file.name]) == 0
    for name in ("result.json", "plant.toml", "curves.json"):
        assert (other / out.name / name).read_bytes() == (out / name).read_bytes()
    loop = json.loads((out / "result.json").read_text())["controllers"][0]
    assert next(one for one in loop["proposals"] if one["method"] == "by hand")["settings"]["Kp"] == tried
