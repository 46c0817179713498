"""A running app and a real browser for the tests: where Chromium is, and what must not happen on any page."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import pytest

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def chromium_path() -> str:
    """Of the browser. Fails where TRUEPLANT_CHROMIUM names one that is not there; skips where there is none at all."""
    named = os.environ.get("TRUEPLANT_CHROMIUM")
    if named:
        if not Path(named).is_file():
            pytest.fail(f"TRUEPLANT_CHROMIUM={named} is not there: install it, or correct the path", pytrace=False)
        return named
    found = next((path for name in CHROMIUM if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("there is no Chromium here: install it, or name one in TRUEPLANT_CHROMIUM")
    return found


@dataclass
class Server:
    """``trueplant app`` in a process of its own."""

    folder: Path
    process: subprocess.Popen[str]
    link: str = ""
    lines: list[str] = field(default_factory=list)
    _reader: threading.Thread | None = None

    @classmethod
    def start(cls, place: Path, folder: Path, *options: str) -> Server:
        """Of a folder or a project file; returns when it has printed its link."""
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        process = subprocess.Popen(
            [sys.executable, "-m", "trueplant", "app", str(place), "--no-browser", "--port", "0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        server = cls(folder, process)
        said = threading.Event()

        def read() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                server.lines.append(line.rstrip("\n"))
                if found := re.search(r"http\S+token=\S+", line):
                    server.link = found[0]
                    said.set()
            said.set()

        server._reader = threading.Thread(target=read, daemon=True)
        server._reader.start()
        if not said.wait(120) or not server.link:
            server.end()
            pytest.fail(f"the app did not start: {server.lines}")
        return server

    def ask_for_another_link(self, page: Any, button: Any) -> None:
        """By the button of a page that says how to get in, until the terminal has shown it."""
        before = self.link
        button.click()
        page.get_by_text("stands on the terminal now").wait_for()
        end = time.monotonic() + 60
        while self.link == before:
            assert time.monotonic() < end, f"the terminal shows no other link: {self.lines}"
            time.sleep(0.02)

    @property
    def address(self) -> str:
        return self.link.split("/?")[0]

    def url(self, path: str, project: str = "project.toml") -> str:
        """Of a page of the project."""
        return f"{self.address}{path}{'&' if '?' in path else '?'}project={project}"

    def children(self) -> list[psutil.Process]:
        return psutil.Process(self.process.pid).children(recursive=True)

    def end(self, number: int = signal.SIGTERM) -> int:
        """Its exit status; fails where a process of it is left."""
        children = self.children() if self.process.poll() is None else []
        if self.process.poll() is None:
            self.process.send_signal(number)
        status = self.process.wait(60)
        if self._reader is not None:
            self._reader.join(10)
        assert self.process.stdout is not None
        self.process.stdout.close()
        _, left = psutil.wait_procs(children, timeout=30)
        assert not left, f"processes are left: {left}"
        return status


class Problems(list[str]):
    """What went wrong on the pages that were seen: console errors, exceptions, violations of the policy."""

    def __init__(self) -> None:
        super().__init__()
        self._expected: list[str] = []

    def expect(self, pattern: str) -> None:
        """This test provokes it."""
        self._expected.append(pattern)

    def watch(self, page: Any) -> None:
        page.on("console", lambda said: self._note(said.type, f"{said.text} ({said.location.get('url', '')})"))
        page.on("pageerror", lambda error: self._note("error", f"exception: {error}"))
        page.on("requestfailed", lambda request: self._failed(request))

    def unexpected(self) -> list[str]:
        return [one for one in self if not any(re.search(pattern, one) for pattern in self._expected)]

    def _note(self, kind: str, text: str) -> None:
        if kind in ("error", "warning") or "Content Security Policy" in text:
            self.append(f"{kind}: {text}")

    def _failed(self, request: Any) -> None:
        if request.failure != "net::ERR_ABORTED":  # a page that was left while something was still coming
            self.append(f"request: {request.url} {request.failure}")


def enter(page: Any, server: Server) -> None:
    """Through the link into the app, until the first page has all its scripts."""
    page.set_default_timeout(60_000)  # milliseconds, for a busy machine
    page.goto(server.link)
    page.wait_for_url(lambda url: "token=" not in url)
    page.wait_for_selector("header.frame")


def follow(page: Any, link: str, screen: str, timeout: float | None = None) -> None:
    """By a link of the page to another screen, until that one has all its scripts; `timeout` (ms) for the link."""
    page.get_by_role("link", name=link, exact=True).click(timeout=timeout)
    page.wait_for_url(f"**/{screen}?project=*")


def change(page: Any, unit: str) -> None:
    """As the screens change a project: through app.js, with the version that the page shows."""
    page.evaluate(
        """async (unit) => {
            const { api, shownVersion } = await import("/static/app.js");
            const keys = { unit };
            const asked = { table: "output", name: "top_temperature", keys, version: shownVersion() };
            await api("/api/tags/set", asked).catch(() => {});
        }""",
        unit,
    )
