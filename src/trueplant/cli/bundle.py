"""The command ``bundle``: an anonymised project and its records, to be given to somebody who is to help."""

from __future__ import annotations

import csv
import io
import zipfile
from pathlib import Path

from trueplant.claims import claim
from trueplant.cli.analyse import saying
from trueplant.cli.layout import say_lines
from trueplant.errors import OutputError
from trueplant.output import write_files
from trueplant.project.bundle import EPOCH, Bundle
from trueplant.project.project import Project

SAID = (
    "inside: numbers of PV, SP, OP, slaves and disturbances, modes as AUTO and MAN, qualities as Good and Bad; models, "
    "controllers (with the vendor, where it is named), limits, spans, excluded stretches and settings",
    "not inside: names, tags, units and their meaning, comments, dates, time zone, other columns, [simulate]. The "
    "values are the plant's own: whoever knows it may recognise ranges and settings",
)


def bundle(path: Path, out: Path | None, force: bool) -> int:
    """Write the ZIP file and, beside it, the names that must not go with it; say what is inside."""
    project = Project.load(path)
    place = out or Path("bundle.zip")
    if place.suffix.lower() != ".zip":
        raise OutputError(f"{place}: a bundle is a ZIP file, so the name must end in .zip")
    names = place.with_name(f"{place.stem}-names.csv")
    claim([place, names], project.files, force)
    from trueplant.connect import ensure
    from trueplant.project.bundle import bundle

    with saying() as say:
        ensure(project, say)
        say("reading the records")
        found = bundle(project)
    write_files(place.parent, {names.name: _names(found), place.name: _zipped(found)})
    say_lines(f"{place}: {', '.join(found.files)}", *SAID)
    say_lines(f"{names}: the original names and dates; keep it, and do not give it away with the bundle")
    return 0


def _zipped(found: Bundle) -> bytes:
    """The same files give the same bytes: no date, no name of a user goes in."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in found.files.items():
            archive.writestr(zipfile.ZipInfo(name), text.encode("utf-8"), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _names(found: Bundle) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(("what", "in the bundle", "original"))
    writer.writerows(found.names.rows())
    if found.first is not None:
        writer.writerow(("time", EPOCH.isoformat(), found.first.isoformat()))
    return buffer.getvalue()
