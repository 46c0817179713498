"""The screen Start: a data file, a project, a demo or a historian, and the first look at it."""

from __future__ import annotations

import os
import secrets
import zoneinfo
from collections import OrderedDict
from collections.abc import Hashable, Mapping
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Any, get_args

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app import levels
from trueplant.app.folder import SUFFIXES, Folder, ProjectFile
from trueplant.app.pages import body, folder_of, ok, page
from trueplant.app.screens.historian import FIELDS, KINDS, source_text
from trueplant.app.screens.preview import ENCODINGS, WORDS, command, preview, project_text
from trueplant.errors import OutputError, ProjectError
from trueplant.output import write_files
from trueplant.project import Project
from trueplant.project.hints import Hints
from trueplant.project.simulation import as_file, simulate_record
from trueplant.project.tables import TimeFormat

DEMOS = {
    "splitter": "a steam splitter: two loops, one gain has changed",
    "wood-berry": "a distillation column: two loops that act on each other",
    "mill": "a cement mill: two loops with a slow return",
}
UNITS = ("ms", "s", "min", "h", "d")
PREVIEWS: OrderedDict[Hashable, dict[str, Any]] = OrderedDict()
"""What was seen last; reading a large file again for each question would take seconds."""
MOST_PREVIEWS = 32


async def _page(request: Request) -> Response:
    folder = folder_of(request)
    projects, data = await run_in_threadpool(lambda: (folder.projects(), folder.data_files()))
    return page(
        request,
        "start.html.j2",
        screen="start",
        projects=projects,
        data_files=data,
        chosen=request.query_params.get("data", ""),
        suffixes=",".join(SUFFIXES),
        demos=DEMOS,
        separators=WORDS.values(),
        encodings=ENCODINGS,
        time_formats=get_args(TimeFormat),
        units=UNITS,
        zones=sorted(zoneinfo.available_timezones()),
        kinds=KINDS,
        fields=FIELDS,
    )


# -- files -----------------------------------------------------------------------------------------------------------


async def _upload(request: Request) -> Response:
    """The body as a file of the folder, written beside its place as it comes and moved there when it is whole."""
    folder = folder_of(request)
    place = _place(folder, request.query_params.get("name", ""), SUFFIXES)
    overwrite = request.query_params.get("overwrite") == "1"
    if place.exists() and not overwrite:
        return ok({"exists": folder.name(place)})
    if int(request.headers.get("content-length") or 0) > levels.UPLOAD:
        raise HTTPException(413, _too_large())
    beside = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")
    try:
        with open(beside, "xb") as file:
            size = 0
            async for piece in request.stream():
                size += len(piece)
                if size > levels.UPLOAD:
                    raise HTTPException(413, _too_large())
                await run_in_threadpool(file.write, piece)
        if size == 0:
            raise HTTPException(400, f"{place.name} is empty: export the data again.")
        if not await run_in_threadpool(_move, beside, place, overwrite):
            return ok({"exists": folder.name(place)})
    except OSError as error:
        raise OutputError(f"{place.name} cannot be written ({error.strerror or error})") from None
    finally:
        beside.unlink(missing_ok=True)
    return ok({"data": folder.name(place), "bytes": size})


def _too_large() -> str:
    return (
        f"The file is larger than {levels.UPLOAD / 2**30:.0f} GB: put it into the folder by hand, where it is read as "
        "well, or export fewer samples."
    )


def _move(beside: Path, place: Path, overwrite: bool) -> bool:
    """Whether it is there now; a file that came meanwhile stays unless it may be overwritten."""
    if overwrite:
        beside.replace(place)
        return True
    try:
        os.link(beside, place)
    except FileExistsError:
        return False
    except OSError:  # a file system without links
        if place.exists():
            return False
        beside.replace(place)
    return True


def _place(folder: Folder, name: str, suffixes: tuple[str, ...]) -> Path:
    """Where a file of this name goes: into the folder itself. Raises HTTPException and Outside."""
    plain = PurePosixPath(name.replace("\\", "/")).name
    if not plain or plain.startswith(".") or any(ord(character) < 32 for character in plain):
        raise HTTPException(400, "This is no name for a file: give it another one.")
    if Path(plain).suffix.lower() not in suffixes:
        raise HTTPException(400, f"{plain} is not of a kind that is read: {', '.join(suffixes)}.")
    return folder.path(plain)


# -- the first look ----------------------------------------------------------------------------------------------------


async def _look(request: Request) -> Response:
    given = await body(request)
    folder, hints = folder_of(request), Hints.of(given)
    name = str(given.get("data") or "")
    path = folder.path(name)

    def found() -> dict[str, Any]:
        status = path.stat() if path.is_file() else None
        key = (
            path,
            status and (status.st_mtime_ns, status.st_size),
            hints.time,
            hints.long,
            *sorted(hints.said.items()),
        )
        if key not in PREVIEWS:
            PREVIEWS[key] = preview(path, hints).to_dict()
            while len(PREVIEWS) > MOST_PREVIEWS:
                PREVIEWS.popitem(last=False)
        return PREVIEWS[key]

    seen = await run_in_threadpool(found)
    project = _free(folder, str(PurePosixPath(name).with_suffix(".toml")))
    return ok({**seen, "data": name, "project": project, "command": command(name, project, hints)})


def _free(folder: Folder, name: str) -> str:
    """A name like this one that no file has."""
    path, count = PurePosixPath(name), 2
    while folder.path(name).exists():
        name = str(path.with_name(f"{path.stem}-{count}.toml"))
        count += 1
    return name


async def _make(request: Request) -> Response:
    given = await body(request)
    folder, hints = folder_of(request), Hints.of(given)
    path = folder.path(str(given.get("data") or ""))
    place = _project_place(folder, str(given.get("project") or ""))
    if place.exists() and not given.get("overwrite"):
        return ok({"exists": folder.name(place)})
    text = await run_in_threadpool(project_text, path, place, hints)
    return await run_in_threadpool(_written, folder, place, text)


def _project_place(folder: Folder, name: str) -> Path:
    if not name.endswith(".toml"):
        raise HTTPException(400, "The name of a project ends in .toml.")
    return folder.path(name)


def _written(folder: Folder, place: Path, text: str) -> Response:
    """The new project, checked; where one is overwritten, that can be undone."""
    Project.from_toml(text, place.parent)
    if place.exists():
        ProjectFile.change(folder.project(folder.name(place)), lambda before: text)
    else:
        write_files(place.parent, {place.name: text})
    return ok({"made": folder.name(place)})


async def _demo(request: Request) -> Response:
    name = str((await body(request)).get("name") or "")
    if name not in DEMOS:
        raise HTTPException(400, f"There is no demo {name!r}.")
    folder = folder_of(request)

    def made() -> str:
        place = folder.path(f"demo-{name}/project.toml")
        if not place.exists():
            text = files("trueplant").joinpath("cli", "demos", f"{name}.toml").read_text(encoding="utf-8")
            project = Project.from_toml(text, place.parent)
            record = project.data.files[0]
            content = {record: as_file(simulate_record(project), record), place.name: text.encode("utf-8")}
            taken = next((one for one in content if (place.parent / one).exists()), None)
            if taken is not None:
                raise OutputError(f"demo-{name}/{taken} is there already, and is not of a demo: move it away")
            write_files(place.parent, content)
        return folder.name(place)

    return ok({"made": await run_in_threadpool(made)})


async def _historian(request: Request) -> Response:
    given: Mapping[str, Any] = await body(request)
    folder = folder_of(request)
    place = _project_place(folder, str(given.get("project") or ""))
    if place.exists() and not given.get("overwrite"):
        return ok({"exists": folder.name(place)})
    text = source_text(given)
    try:
        return await run_in_threadpool(_written, folder, place, text)
    except ProjectError as error:
        raise ProjectError(str(error).replace(str(place.parent / "project.toml"), place.name)) from None


ROUTES = [
    Route("/start", _page),
    Route("/api/start/upload", _upload, methods=["PUT"]),
    Route("/api/start/look", _look, methods=["POST"]),
    Route("/api/start/make", _make, methods=["POST"]),
    Route("/api/start/demo", _demo, methods=["POST"]),
    Route("/api/start/historian", _historian, methods=["POST"]),
]
