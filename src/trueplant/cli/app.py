"""The command ``trueplant``: its arguments here, its work in the modules that each command imports when it runs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from trueplant.app.levels import PORT
from trueplant.errors import UsageError
from trueplant.version import __version__

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


class Form(StrEnum):
    """What a model is written as."""

    TF = "tf"
    STEP = "step"
    FIR = "fir"


class Kind(StrEnum):
    """What coefficients are of."""

    STEP = "step"
    FIR = "fir"


def _path(text: str) -> Path:
    """Of a file or folder to write; an empty one would be the folder one stands in."""
    if not text.strip():
        raise UsageError("--out is empty: name a place for the results, or leave it out")
    return Path(text)


ProjectFile = Annotated[Path, typer.Argument(metavar="PROJECT.toml", help="The project file.")]
SiteFile = Annotated[Path, typer.Argument(metavar="SITE.toml", help="The site file: which loops it has.")]
Workers = Annotated[int | None, typer.Option("--workers", min=0, help="Processes; 0: in this one.")]
Address = Annotated[str | None, typer.Option("--dask", metavar="ADDRESS", help="Of a cluster: tls://host:8786.")]
Only = Annotated[str | None, typer.Option("--only", metavar="GLOB", help="Only loops whose names fit, such as 'FC*'.")]
Pages = Annotated[bool, typer.Option("--pages", help="Draw the report of every loop, too.")]
Saved = Annotated[Path, typer.Argument(metavar="OUT", help="The folder of a saved result.")]
First = Annotated[Path, typer.Argument(metavar="OUT1", help="The folder of a saved result.")]
Second = Annotated[Path, typer.Argument(metavar="OUT2", help="That of another, of the same plant.")]
CompareJson = Annotated[bool, typer.Option("--json", help="Print compare.json, and nothing else.")]
Shift = Annotated[bool, typer.Option("--shift", help="One page of A4 for the shift, shift.html, instead.")]
OfProject = Annotated[
    Path | None, typer.Option("--project", metavar="FILE", help="Its project file, if it is not where it was.")
]
ForceAccept = Annotated[bool, typer.Option("--force", help="Though the project or its data have changed since.")]
OutFolder = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results.", parser=_path)]
OutFile = Annotated[Path | None, typer.Option("--out", metavar="FILE", help="File to write.", parser=_path)]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that no earlier run wrote.")]
Json = Annotated[bool, typer.Option("--json", help="Print result.json, and nothing else.")]
PaperJson = Annotated[bool, typer.Option("--json", help="Print paper.json, and nothing else.")]
Seeds = Annotated[int, typer.Option("--seeds", min=2, help="Simulated records of the splitter for each kind of noise.")]
CheckJson = Annotated[bool, typer.Option("--json", help="Print check.json, and nothing else.")]
Find = Annotated[bool, typer.Option("--find", help="Rank the stretches of a long history with usable moves.")]
Write = Annotated[bool, typer.Option("--write", help="With --find: exclude all else in the project file.")]
TrackJson = Annotated[bool, typer.Option("--json", help="Print track.json, and nothing else.")]
Precision = Annotated[
    float, typer.Option("--precision", metavar="PERCENT", help="Standard error that windows are made long enough for.")
]
Refresh = Annotated[bool, typer.Option("--refresh", help="Read the historian again, though a snapshot is there.")]
FailOnMismatch = Annotated[bool, typer.Option("--fail-on-mismatch", help="Exit with 1 if the plant has changed.")]


def _refresh(project: Path, wanted: bool) -> None:
    if wanted:
        from trueplant.cli.fetch import read_again

        read_again(project)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"trueplant {__version__}")
        raise typer.Exit


@app.callback()
def trueplant(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show it.")] = False,
) -> None:
    """Find what changed in a plant from its closed-loop data, and how surely."""


@app.command(short_help="Find what changed in the plant; write the results.")
def run(
    project: ProjectFile,
    out: OutFolder = None,
    json: Json = False,
    fail_on_mismatch: FailOnMismatch = False,
    force: Force = False,
    refresh: Refresh = False,
) -> int:
    """Analyse a project: writes result.json, report.html and plant.toml."""
    _refresh(project, refresh)
    from trueplant.cli.analyse import run

    return run(project, out, json, fail_on_mismatch, force)


@app.command(short_help="Draw the report of a saved result again.")
def report(saved: Saved, out: OutFile = None, shift: Shift = False, force: Force = False) -> int:
    """Draw report.html again from result.json and curves.json, without the data."""
    from trueplant.cli.report import report

    return report(saved, out, shift, force)


@app.command(short_help="Make the plant found the project's model.")
def accept(saved: Saved, project: OfProject = None, force: ForceAccept = False) -> int:
    """Write the plant of a saved result into its project file; comments stay, and old values become comments."""
    from trueplant.cli.accept import accept

    return accept(saved, project, force)


@app.command(short_help="Two saved results beside each other.")
def compare(first: First, second: Second, json: CompareJson = False) -> int:
    """Say what differs between two saved results, and whether that is beyond chance."""
    from trueplant.cli.compare import compare

    return compare(first, second, json)


@app.command(short_help="Parameters over time: since when has the plant changed.")
def track(
    project: ProjectFile,
    out: OutFolder = None,
    json: TrackJson = False,
    precision: Precision = 10.0,
    force: Force = False,
    refresh: Refresh = False,
) -> int:
    """Follow the plant through a long record: writes track.json and track.html."""
    _refresh(project, refresh)
    from trueplant.cli.track import track

    return track(project, out, json, precision, force)


@app.command(short_help="Audit every loop of a site: what changed, worst first.")
def audit(
    site: SiteFile,
    out: OutFolder = None,
    workers: Workers = None,
    dask: Address = None,
    only: Only = None,
    pages: Pages = False,
    fail_on_mismatch: FailOnMismatch = False,
) -> int:
    """Audit every loop of a site: writes audit.parquet and index.html; what is there already is not computed again."""
    if workers is not None and dask is not None:
        raise UsageError("--workers and --dask say different things: keep one of them")
    from trueplant.cli.audit import Asked, audit

    return audit(site, out, Asked(workers, dask, only, pages, fail_on_mismatch))


@app.command(short_help="A snapshot of the historian that a project names.")
def fetch(project: ProjectFile, refresh: Refresh = False) -> int:
    """Read the historian of a project ([data.source]) into a snapshot, unless that is there."""
    from trueplant.cli.fetch import fetch

    return fetch(project, refresh)


@app.command(short_help="Screen the data only: what can be used, and why not.")
def check(
    project: ProjectFile, find: Find = False, write: Write = False, json: CheckJson = False, refresh: Refresh = False
) -> int:
    """Read and screen the data only: what is usable, what is not and why."""
    if write and not find:
        raise UsageError("--write goes with --find: it excludes all but the stretches that were found")
    _refresh(project, refresh)
    if find:
        from trueplant.cli.find import find_usable

        return find_usable(project, write, json)
    from trueplant.cli.data import check

    return check(project, json)


@app.command(short_help="Write a first project file for a data file.")
def init(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A CSV, Parquet or XLSX file.")],
    out: OutFile = None,
    force: Force = False,
    separator: Annotated[str | None, typer.Option(help="Between the columns, if it is not found.")] = None,
    encoding: Annotated[str | None, typer.Option(help="Of the text, if it is not found.")] = None,
    time: Annotated[str | None, typer.Option(help="The column of the time, if it is not found.")] = None,
    long: Annotated[bool | None, typer.Option("--long/--wide", help="Tags below each other, or columns.")] = None,
    also: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A key of [data], as time_zone=Europe/Oslo; any number of."),
    ] = None,
) -> int:
    """Write a commented project file from the columns of a data file.

    Mostly DATA is all that it takes; the options say what a file does not show of itself.
    """
    from trueplant.cli.data import init

    shape = None if long is None else "long" if long else "wide"
    given = {"separator": separator, "encoding": encoding, "time": time, "shape": shape}
    return init(data, out, force, given, also or ())


@app.command(short_help="Write a simulated record of the declared loop.")
def simulate(project: ProjectFile, out: OutFile = None, force: Force = False) -> int:
    """Simulate the declared loop (table [simulate]) and write the record as CSV or Parquet."""
    from trueplant.cli.data import simulate

    return simulate(project, out, force)


@app.command(short_help="A model in another form: tf, step or fir.")
def convert(
    model: Annotated[Path, typer.Argument(metavar="IN", help="Project, coefficients (CSV, Parquet), or JSON.")],
    to: Annotated[Form, typer.Option("--to", help="Formulas, step coefficients or impulse responses.")],
    out: OutFile = None,
    force: Force = False,
    sample_time: Annotated[float | None, typer.Option(min=1e-9, help="Between coefficients, read or written.")] = None,
    kind: Annotated[Kind, typer.Option(help="What coefficients that are read are.")] = Kind.STEP,
    ramp: Annotated[list[str] | None, typer.Option(metavar="COLUMN", help="It integrates. May be repeated.")] = None,
    structure: Annotated[str | None, typer.Option(help="Of formulas for coefficients, such as fopdt.")] = None,
) -> int:
    """Write a model as formulas, step coefficients or impulse responses, and say what that costs."""
    from trueplant.cli.convert import convert
    from trueplant.project.conversion import Coefficients

    return convert(model, to.value, out, force, Coefficients(kind.value, sample_time, ramp or ()), structure)


@app.command(short_help="An anonymised project and record, to give away.")
def bundle(project: ProjectFile, out: OutFile = None, force: Force = False) -> int:
    """Write the project and its records under neutral names into a ZIP file, and the names into a file beside it."""
    from trueplant.cli.bundle import bundle

    return bundle(project, out, force)


@app.command(short_help="Run a built-in case end to end, no file needed.")
def demo(
    name: Annotated[str, typer.Argument(metavar="[NAME]", help="splitter, mill, wood-berry or site.")] = "splitter",
    out: OutFolder = None,
    json: Json = False,
    force: Force = False,
    workers: Annotated[int, typer.Option("--workers", min=0, help="Of the site's audit.")] = 2,
    small: Annotated[bool, typer.Option("--small", help="The site with 24 loops over 10 days.")] = False,
) -> int:
    """Run a built-in simulated case end to end, no file needed; `site` is sixty loops and their audit."""
    if name == "site":
        if json:
            raise UsageError("--json is of one result: a site has audit.parquet")
        from trueplant.cli.audit import demo_site

        return demo_site(out, workers, small)
    from trueplant.cli.analyse import demo

    return demo(name, out, json, force)


@app.command(short_help="Compute the paper: each value beside its print.")
def paper(out: OutFolder = None, json: PaperJson = False, seeds: Seeds = 20, force: Force = False) -> int:
    """Compute every equation, table and figure of the paper that can be: writes paper.json and paper.html."""
    from trueplant.cli.paper import paper

    return paper(out, json, seeds, force)


@app.command("app", short_help="The same in the browser, on this machine.")
def app_command(
    place: Annotated[Path, typer.Argument(metavar="[PROJECT.toml | FOLDER]", help="What to open.")] = Path(),
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="To listen on; 0: any that is free.")] = PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address only.")] = False,
    address: Annotated[str, typer.Option("--address", metavar="URL", help="Behind a reverse proxy: its own.")] = "",
    proxy_key: Annotated[
        Path | None, typer.Option("--proxy-key", metavar="FILE", help="A secret that the proxy sends along.")
    ] = None,
) -> int:
    """Run the local web application on a folder of projects and data; nothing leaves this machine."""
    from trueplant.cli.app_command import app

    return app(place, port, not no_browser, address, proxy_key)
