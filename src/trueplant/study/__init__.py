"""The analysis as one line (`pipeline`), and its stages."""

from __future__ import annotations

from os import PathLike

from trueplant.project import Project
from trueplant.result import Result
from trueplant.study.study import Progress, quiet

__all__ = ["Project", "Result", "run"]


def run(project: Project | str | PathLike[str], progress: Progress = quiet) -> Result:
    """Analyse a project: the path of a project file, or a `Project` built in code.

    `progress` is told what is being done, in a few words, as each step begins. Raises a `UsageError` for a project or
    data that cannot be used and a `SourceError` for data that cannot be fetched. Data that cannot answer are no error:
    the result then has the status "refused".
    """
    from trueplant.study.pipeline import analyse

    return analyse(project if isinstance(project, Project) else Project.load(project), progress)
