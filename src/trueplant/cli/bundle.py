"""The command ``bundle``: an anonymised project and its records, to be given to somebody who is to help."""

from __future__ import annotations

from pathlib import Path

from trueplant.cli.analyse import saying
from trueplant.cli.layout import say_lines
from trueplant.notebook.errands import INSIDE, bundle_into
from trueplant.project.project import Project


def bundle(path: Path, out: Path | None, force: bool) -> int:
    """Write the ZIP file and, beside it, the names that must not go with it; say what is inside."""
    project = Project.load(path)
    with saying() as say:
        found = bundle_into(project, out or Path("bundle.zip"), force, say)
    say_lines(f"{found.place}: {', '.join(found.files)}", *INSIDE)
    say_lines(f"{found.names}: the original names and dates; keep it, and do not give it away with the bundle")
    return 0
