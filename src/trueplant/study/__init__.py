"""The project file, the analysis from data to result, and the result itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trueplant.study.project import Project
from trueplant.study.result import Result

if TYPE_CHECKING:
    from os import PathLike

__all__ = ["Project", "Result", "run"]


def run(project: Project | str | PathLike[str]) -> Result:
    """Analyse a project: the path of a project file, or a `Project` built in code.

    Raises a `UsageError` for a project or data that cannot be used and a `SourceError` for data that
    cannot be fetched. Data that cannot answer are no error: the result then has the status "refused".
    """
    from trueplant.study.pipeline import analyse

    return analyse(project if isinstance(project, Project) else Project.load(project))
