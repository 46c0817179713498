"""The commands that analyse: ``run`` and ``demo``."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from trueplant.claims import claim, known_to
from trueplant.errors import UsageError
from trueplant.output import BESIDE, RESULT, claim_results, prepare_output, repair, write_files
from trueplant.printable import printable
from trueplant.project.project import Project
from trueplant.result.status import Status

if TYPE_CHECKING:
    from trueplant.result import Result

REFUSED, MISMATCH = 3, 1
COMPILING = " (compiling, first time only)"
Say = Callable[[str], None]


def run(path: Path, out: Path | None, json: bool, fail_on_mismatch: bool, force: bool) -> int:
    """Analyse, write, and say what came out."""
    project = Project.load(path)
    folder = prepare_output(out or Path(f"{path.stem}-result"))
    claim_results(folder, project, force)
    result = _analyse(project, folder, json)
    if result.status == Status.REFUSED:
        return REFUSED
    return MISMATCH if fail_on_mismatch and result.mismatch else 0


def demo(name: str, out: Path | None, json: bool, force: bool) -> int:
    """Simulate a built-in case, then run the same analysis on it as on any record."""
    text = demo_text(name)
    folder = prepare_output(out or Path(f"demo-{name}"))
    from trueplant.project.simulation import as_file, simulate_record

    project = Project.from_toml(text, folder)
    record = project.data.files[0]
    with saying() as say:
        say("simulating the record")
        given = {record: as_file(simulate_record(project), record), "project.toml": text.encode("utf-8")}
    # one that was interrupted has left these, and no result that knows them
    known = known_to(folder / RESULT).union(hashlib.sha256(content).hexdigest() for content in given.values())
    repair(folder)
    claim([folder / name for name in (*given, *BESIDE, RESULT)], force=force, known=known)
    write_files(folder, given)
    result = _analyse(Project.load(folder / "project.toml"), folder, json)
    return REFUSED if result.status == Status.REFUSED else 0


def demo_text(name: str) -> str:
    """The project file of a built-in case. Raises UsageError for an unknown name."""
    cases = {p.name.removesuffix(".toml"): p for p in resources.files("trueplant.cli").joinpath("demos").iterdir()}
    if name not in cases:
        raise UsageError(f"there is no demo {name!r}: choose one of {', '.join([*sorted(cases), 'site'])}")
    return cases[name].read_text(encoding="utf-8")


def _analyse(project: Project, folder: Path, json: bool) -> Result:
    with saying() as say:
        from trueplant.notebook.saved import analyse_into

        result, written = analyse_into(project, folder, say)
    if json:
        sys.stdout.write(written[RESULT].read_text(encoding="utf-8"))
    else:
        from trueplant.cli.show import show

        show(result, list(written.values()))
    return result


@contextmanager
def saying() -> Iterator[Say]:
    """A function that shows what is being done; it draws on a terminal and is quiet elsewhere."""
    if not sys.stderr.isatty():
        yield lambda what: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}{task.fields[also]}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("loading the program", total=None, also="")
        from trueplant.compiled import compiling

        with compiling(lambda begun: bar.update(task, also=COMPILING if begun else "")):
            yield lambda what: bar.update(task, description=printable(what))
