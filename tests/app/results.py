"""Projects with their results beside them, as the app has them; each is analysed once for all tests."""

from __future__ import annotations

import atexit
import json
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from support import saved
from trueplant.cli import main
from trueplant.cli.analyse import demo_text

CHANGED, SAME = saved.project(gain=2.6), saved.project()
TUNED = f"{CHANGED}\n[tuning]\n".replace('op = "op"', 'op = "op"\nspan = [0, 50]').replace(
    'sp = "sp"', 'sp = "sp"\nunit = "degC"\nspan = [0, 20]'
)
"""With new settings, and with the spans that other systems reckon in."""
STILL = CHANGED.replace("[simulate]", '[simulate]\nsetpoints = [{time = 5, output = "y", value = 0}]', 1)
STILL = re.sub(r"\nsetpoints = \[\{time = 5, output = \"y\", value = 1\}.*", "", STILL)
"""Its set-point never moves, so its data cannot answer."""


@cache
def _made(text: str, status: int) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="trueplant-app-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    project = folder / "project.toml"
    project.write_text(text, encoding="utf-8")
    assert main(["simulate", str(project), "--out", str(folder / "record.csv")]) == 0
    assert main(["run", str(project), "--out", str(folder / "project-result")]) == status
    return folder


def with_result(folder: Path, text: str = CHANGED, status: int = 0) -> Path:
    """`folder` with project.toml, record.csv and project-result/, which the app takes for its own run's."""
    return Path(shutil.copytree(_made(text, status), folder, dirs_exist_ok=True))


def demo(folder: Path, name: str) -> Path:
    """Likewise with a built-in case."""
    return with_result(folder, demo_text(name))


def result_json(folder: Path) -> dict[str, Any]:
    """What other programs read."""
    document: dict[str, Any] = json.loads((folder / "project-result" / "result.json").read_text(encoding="utf-8"))
    return document


def unbroken(text: str) -> str:
    """As headings show it: an arrow, and no line that ends between a number and its per cent."""
    return text.replace("->", "→").replace(" %", "\u00a0%")


def words(html: str) -> str:
    """The text of a page, its tags and marks aside, with single spaces."""
    import html as entities

    without = re.sub(r"<(script|style)\b.*?</\1>", " ", html, flags=re.DOTALL)
    return " ".join(entities.unescape(re.sub(r"<[^>]*>", " ", without)).split())


UNSAFE = re.compile(r"\sstyle\s*=|\son[a-z]+\s*=|javascript:", re.IGNORECASE)
"""What the policy of the pages forbids in HTML."""
