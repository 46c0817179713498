"""A short record of the splitter, whose analysis proposes settings and leaves a test to be planned."""

from __future__ import annotations

import re
from pathlib import Path

from app.results import with_result
from trueplant.cli.analyse import demo_text


def short_text() -> str:
    """The first 99 minutes, with settings asked for, under other noise: under the demo's they are just so proposed."""
    text = demo_text("splitter").replace("duration = 300", "duration = 99").replace("seed = 1", "seed = 2")
    late = re.compile(r"\n    \{ time = (100|145|190|235|265),.*")
    return f'{late.sub("", text)}\n[tuning]\nmethods = ["certain-share", "simc"]\n'


def short(folder: Path) -> Path:
    """`folder` with project.toml, record.csv and project-result/."""
    return with_result(folder, short_text())
