"""The app in a real Chromium: login to plots and zoom of a long record, slider to curves, cancel, memory of the server.

    python benchmarks/bench_app.py [--samples 10000000] [--moves 40]

The long record is that of bench_trends.py, the rest is done on the splitter's demo. Sliders are moved while nothing
else runs and while an analysis does; times are those that the page itself sees. The machine's load is printed beside.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from bench_trends import written

from app.browser import ARGUMENTS, Server, chromium_path, enter
from trueplant.cli import main as command

DEMO = Path(__file__).parent.parent / "src" / "trueplant" / "cli" / "demos" / "splitter.toml"
LONG = 600_000
"""Milliseconds that a step may take at most."""
MOVE = """async (moves) => {
    const slider = document.querySelector("#desk input[type=range]"), desk = document.getElementById("desk"), took = [];
    for (let k = 0; k < moves; k++) {
        const begun = performance.now(), before = desk.dataset.drawn;
        slider.value = Number(slider.value) + (k % 2 ? -3 : 3);
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        while (desk.dataset.drawn === before) await new Promise(requestAnimationFrame);
        took.push(performance.now() - begun);
        await new Promise((resolve) => setTimeout(resolve, 300));
    }
    return took;
}"""
ZOOM = """async (moves) => {
    const took = [];
    for (let k = 0; k < moves; k++) {
        const begun = performance.now(), before = document.body.dataset.shown;
        document.getElementById("in").click();
        while (document.body.dataset.shown === before) await new Promise(requestAnimationFrame);
        took.push(performance.now() - begun);
        await new Promise((resolve) => setTimeout(resolve, 100));
    }
    return took;
}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--moves", type=int, default=40)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as made, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=list(ARGUMENTS))
        print(f"load before: {', '.join(f'{x:.2f}' for x in os.getloadavg())} on {os.cpu_count()} cores")
        long_record(browser, Path(made) / "long", options.samples)
        settings(browser, Path(made) / "demo", options.moves)
        browser.close()


def long_record(browser: Any, folder: Path, samples: int) -> None:
    folder.mkdir()
    written(folder / "record.parquet", samples)
    done("init", str(folder / "record.parquet"), "--out", str(folder / "project.toml"))
    server = Server.start(folder, folder)
    page = browser.new_page()
    page.set_default_timeout(LONG)
    begun = time.perf_counter()
    enter(page, server)
    entered = time.perf_counter()
    page.goto(server.url("/trends"))
    page.wait_for_function("() => document.body.dataset.shown")
    drawn = time.perf_counter()
    print(
        f"{samples:,} samples: in after {entered - begun:.1f} s, all plots {drawn - entered:.1f} s later; "
        f"server {resident(server.process.pid):.2f} GB"
    )
    print("zoom:", spread(page.evaluate(ZOOM, 10)))
    page.close()
    server.end()


def settings(browser: Any, folder: Path, moves: int) -> None:
    folder.mkdir()
    shutil.copy(DEMO, folder / "project.toml")
    for name, out in (("simulate", "record.csv"), ("run", "project-result")):
        done(name, str(folder / "project.toml"), "--out", str(folder / out))
    server = Server.start(folder, folder)
    page, other = browser.new_page(), browser.new_page()
    for one in (page, other):
        one.set_default_timeout(LONG)
    enter(page, server)
    page.goto(server.url("/whatif"))
    page.wait_for_selector("#desk:not([hidden])")
    page.evaluate(MOVE, 5)
    print("slider to curves:", spread(page.evaluate(MOVE, moves)))
    other.context.add_cookies(page.context.cookies())
    other.goto(server.url("/run"))
    other.click("#start")
    other.wait_for_selector("#stages .now:has-text('estimating')")
    print("slider to curves while an analysis runs:", spread(page.evaluate(MOVE, 8)))
    if other.locator("#stages .now").count():
        began = time.perf_counter()
        other.click("#cancel")
        other.wait_for_selector("#outcome .cancelled")
        print(f"cancel, until the page says so: {time.perf_counter() - began:.2f} s")
    server.end()


def done(*line: str) -> None:
    if command(list(line)):
        sys.exit(f"trueplant {line[0]} failed")


def resident(process: int) -> float:
    """GB of it and of all that it started."""
    own = psutil.Process(process)
    return sum(one.memory_info().rss for one in (own, *own.children(recursive=True))) / 1e9


def spread(took: list[float]) -> str:
    return f"median {statistics.median(took):.0f} ms, largest {max(took):.0f} ms of {len(took)}"


if __name__ == "__main__":
    main()
