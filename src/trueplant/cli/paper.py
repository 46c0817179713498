"""The command ``paper``."""

from __future__ import annotations

import sys
from pathlib import Path

from trueplant.claims import claim_pair
from trueplant.cli.analyse import saying
from trueplant.cli.layout import say_lines
from trueplant.output import prepare_output, write_files

JSON, PAGE = "paper.json", "paper.html"


def paper(out: Path | None, json: bool, seeds: int, force: bool) -> int:
    """Compute all of the paper, write paper.json and paper.html, and say how much of it agrees."""
    folder = prepare_output(out or Path("paper"))
    claim_pair(folder, JSON, PAGE, force=force)
    from trueplant.paper import compute, render
    from trueplant.paper.page import summary

    with saying() as say:
        found = compute(seeds, say)
        say("writing the page")
        text = found.to_json()
        written = write_files(folder, {JSON: text, PAGE: render(found)})
    if json:
        sys.stdout.write(text)
    else:
        say_lines(summary(found), *written.values())
    return 0
