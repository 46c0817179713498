"""An analysis from its project to its files, as the command line and the app run it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from trueplant.output import write_results
from trueplant.project import Project
from trueplant.study.study import Progress, quiet

if TYPE_CHECKING:
    from trueplant.result import Result


def analyse_into(project: Project, folder: Path, say: Progress = quiet) -> tuple[Result, dict[str, Path]]:
    """The result, and the files that were written for it by name. `folder` was claimed before."""
    from trueplant.report import render
    from trueplant.study.pipeline import analyse

    result = analyse(project, say)
    say("drawing the report")
    page = render(result)
    say("writing the files")
    return result, write_results(result, project, folder, page)
