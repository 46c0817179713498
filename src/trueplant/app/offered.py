"""What can be taken along of a saved result: its files in several forms, and the commands that make them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from trueplant.app.command_lines import command, run_line, track_line
from trueplant.app.downloads import as_csv
from trueplant.app.errands import OUT
from trueplant.app.folder import ProjectFile
from trueplant.app.saved import Saved
from trueplant.notebook.analysis import Analysis
from trueplant.output import CURVES, PLANT, REPORT, RESULT, SHIFT


@dataclass(frozen=True)
class Offered:
    """One file that can be had."""

    name: str
    words: str
    view: str = ""
    """Screen on which it can be looked at, too."""


PARAMETERS, SETTINGS = "parameters.csv", "settings.csv"
OFFERED = (
    Offered(REPORT, "Everything, for the engineer; one file that opens anywhere, offline.", "out/report"),
    Offered(SHIFT, "One page for the control room, to be printed or kept as PDF.", "out/shift"),
    Offered(PLANT, "The project with the plant that was found as its model."),
    Offered(PARAMETERS, "Parameters of model and plant with their intervals, for a sheet."),
    Offered(SETTINGS, "The new settings, for a sheet."),
    Offered(RESULT, "All numbers, for other programs."),
    Offered(CURVES, "What is drawn, for other programs."),
)


def offered(found: Saved) -> list[Offered]:
    """Those that there are of this result."""
    return [one for one in OFFERED if _has(found, one.name)]


def content(found: Saved, name: str) -> str | bytes | None:
    """One of them; None where this result has no such file."""
    return _MAKERS[name](found) if name in _MAKERS and _has(found, name) else None


def _has(found: Saved, name: str) -> bool:
    if name in (PLANT, CURVES):
        return (found.folder / name).is_file()
    return name != SETTINGS or bool(found.result.controllers)


def _written(name: str) -> Callable[[Saved], bytes]:
    return lambda found: (found.folder / name).read_bytes()


def _report(found: Saved) -> str | bytes:
    """As the run drew it, else drawn now."""
    if (found.folder / REPORT).is_file():
        return (found.folder / REPORT).read_bytes()
    from trueplant.report import render

    return render(found.result)


def _shift(found: Saved) -> str:
    from trueplant.report.shift import render_shift

    return render_shift(found.result)


def _parameters(found: Saved) -> str:
    frame = Analysis(found.result).parameters
    return as_csv(frame.columns, frame.iter_rows())


def _settings(found: Saved) -> str:
    frame = Analysis(found.result).settings
    return as_csv(frame.columns, frame.iter_rows())


_MAKERS: Mapping[str, Callable[[Saved], str | bytes]] = {
    REPORT: _report,
    SHIFT: _shift,
    PARAMETERS: _parameters,
    SETTINGS: _settings,
    **{name: _written(name) for name in (PLANT, RESULT, CURVES)},
}


def bundle_name(project: ProjectFile) -> str:
    """Beside the project."""
    return f"{project.path.stem}{OUT['bundle']}"


def command_lines(found: Saved) -> list[tuple[str, str]]:
    """What each part of the page is on the command line."""
    name, project = found.name, found.project
    lines = [
        ("the report again", command("report", name)),
        ("the page for the shift", command("report", name, "--shift")),
    ]
    if project is not None:
        above, slash, _ = project.name.rpartition("/")
        lines += [
            ("the analysis", run_line(project)),
            ("the plant as the model", command("accept", name, "--project", project.name)),
            ("a bundle", command("bundle", project.name, "--out", f"{above}{slash}{bundle_name(project)}")),
            ("over time", track_line(project)),
        ]
    return [*lines, ("two results", f"{command('compare', name)} OTHER")]
