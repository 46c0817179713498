"""Tracks and bundles from a project to their files, as the command line and the app write them."""

from __future__ import annotations

import csv
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trueplant.claims import claim, claim_pair
from trueplant.errors import OutputError
from trueplant.output import as_json, write_files
from trueplant.project import Project
from trueplant.study.study import Progress, quiet

if TYPE_CHECKING:
    from trueplant.project.bundle import Bundle
    from trueplant.result import Track

TRACK, TRACK_PAGE = "track.json", "track.html"


def claim_track(project: Project, folder: Path, force: bool = False) -> None:
    """Raise OutputError where the files of a track would replace others."""
    claim_pair(folder, TRACK, TRACK_PAGE, project.files, force)


def track_into(
    project: Project, folder: Path, precision: float, say: Progress = quiet
) -> tuple[Track, dict[str, Path]]:
    """The track, and its files by name. `folder` was claimed before."""
    from trueplant.report.track import render
    from trueplant.tracking.track import track

    found = track(project, precision, progress=say)
    say("writing the page")
    return found, write_files(folder, {TRACK: as_json(found.to_dict()), TRACK_PAGE: render(found)})


@dataclass(frozen=True)
class Bundled:
    """What was written of a bundle."""

    place: Path
    names: Path
    """The original names and dates; not to be given away."""
    files: tuple[str, ...]
    """In the bundle."""


INSIDE = (
    "inside: numbers of PV, SP, OP, slaves and disturbances, modes as AUTO and MAN, qualities as Good and Bad; models, "
    "controllers (with the vendor, where it is named), limits, spans, excluded stretches and settings",
    "not inside: names, tags, units and their meaning, comments, dates, time zone, other columns, [simulate]. The "
    "values are the plant's own: whoever knows it may recognise ranges and settings",
)


def bundle_into(project: Project, place: Path, force: bool = False, say: Progress = quiet) -> Bundled:
    """The project and its records under neutral names as a ZIP file, and beside it what the names were."""
    if place.suffix.lower() != ".zip":
        raise OutputError(f"{place}: a bundle is a ZIP file, so the name must end in .zip")
    names = place.with_name(f"{place.stem}-names.csv")
    claim([place, names], project.files, force)
    from trueplant.connect import ensure
    from trueplant.project.bundle import bundle

    ensure(project, say)
    say("reading the records")
    found = bundle(project)
    write_files(place.parent, {names.name: _names(found), place.name: _zipped(found)})
    return Bundled(place, names, tuple(found.files))


def _zipped(found: Bundle) -> bytes:
    """The same files give the same bytes: no date, no name of a user goes in."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in found.files.items():
            archive.writestr(zipfile.ZipInfo(name), text.encode("utf-8"), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _names(found: Bundle) -> str:
    from trueplant.project.bundle import EPOCH

    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(("what", "in the bundle", "original"))
    writer.writerows(found.names.rows())
    if found.first is not None:
        writer.writerow(("time", EPOCH.isoformat(), found.first.isoformat()))
    return buffer.getvalue()
