"""The loops of a site, each as an ordinary project file that can be opened by itself."""

from __future__ import annotations

import csv
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase
from io import StringIO
from pathlib import Path

from trueplant.errors import ProjectError, UsageError
from trueplant.files import contents
from trueplant.fleet import levels
from trueplant.fleet.site import Audit, Loops, Site, seconds_of
from trueplant.output import write_files
from trueplant.project import Project
from trueplant.project.document import edited, sections, with_moved_paths

PROJECTS = "projects"
"""Folder of the project files that are made for an audit."""
_PLACE = re.compile(r"\{\{\s*([^{}\s][^{}]*?)\s*\}\}")
_UNSAFE = re.compile(r"[\"'\\\x00-\x1f\x7f]")
_NO_NAME = re.compile(r"[^\w.-]+")

Window = tuple[datetime, datetime]


@dataclass(frozen=True)
class Job:
    """One loop (a project may have several outputs): its name, and the file of its project."""

    name: str
    project: Path
    origin: str
    """Where it was declared."""
    problem: str = ""
    """Why there is no project to open."""


def window_of(audit: Audit, now: datetime | None = None) -> Window | None:
    """The stretch of time that is audited, in UTC; None where each project says its own.

    A window before now ends with the last whole day of UTC (a shorter one with the last whole hour), so that an audit
    that is started again the same day is the same audit.
    """
    if audit.start is not None and audit.end is not None:
        return audit.start.astimezone(UTC), audit.end.astimezone(UTC)
    if audit.window is None:
        return None
    length = timedelta(seconds=seconds_of(audit.window))
    end = (now or datetime.now(UTC)).astimezone(UTC).replace(minute=0, second=0, microsecond=0)
    if length >= timedelta(seconds=levels.WHOLE_DAYS):
        end = end.replace(hour=0)
    return end - length, end


def jobs_of(site: Site, out: Path, now: datetime | None = None, only: str | None = None) -> list[Job]:
    """Every loop of a site, in order; projects that an audit makes are written into `out`.

    A row of a table from which no project can be made is a job with a `problem`. Raises ProjectError where a pattern
    fits no file, a template asks for a column that its table lacks, or two loops have one name.
    """
    window = window_of(site.audit, now)
    wanted = []
    for loops in site.loops:
        found = _of_files(site, loops, out) if loops.projects is not None else _of_table(site, loops)
        wanted += [one for one in found if only is None or fnmatchcase(one.name, only)]
    if not wanted:
        raise UsageError(f"{site.source}: no loop has a name that fits {only!r}: correct --only")
    _check_names(site, [one.name for one in wanted])
    made: dict[str, str] = {}
    jobs = [_job(one, out / PROJECTS, window, made) for one in wanted]
    if made:
        write_files(out / PROJECTS, made)
    return jobs


@dataclass(frozen=True)
class _Declared:
    """A loop as it was declared: the text of its project, and the folder that its paths start from."""

    name: str
    origin: str
    folder: Path
    text: str
    file: Path | None = None
    """None where it was made from a template."""
    problem: str = ""


def _of_files(site: Site, loops: Loops, out: Path) -> Iterator[_Declared]:
    """The files that fit a pattern, without the site file and what an audit wrote: `**/*.toml` fits those too."""
    assert loops.projects is not None
    own, results = Path(site.source).resolve(), out.resolve()

    def of_the_site(path: Path) -> bool:
        whole = path.resolve()
        return path.is_file() and whole != own and not whole.is_relative_to(results)

    try:
        files = sorted(path for path in site.folder.glob(loops.projects) if of_the_site(path))
    except (ValueError, NotImplementedError) as error:
        text = f"{site.source}: loops.projects: {loops.projects!r} is no pattern of files below the site file ({error})"
        raise ProjectError(text) from None
    if not files:
        raise ProjectError(f"{site.source}: loops.projects: no file fits {loops.projects!r}: correct the pattern")
    for file in files:
        name = file.relative_to(site.folder).with_suffix("").as_posix()
        yield _Declared(name, str(file), file.parent, "", file)


def _of_table(site: Site, loops: Loops) -> Iterator[_Declared]:
    template, table = site.folder / str(loops.template), site.folder / str(loops.table)
    text, rows = _text_of(template), _rows(table)
    asked = dict.fromkeys(_PLACE.findall(text))
    columns = list(rows[0][1])
    for column in dict.fromkeys(["name", *asked]):
        if column not in columns:
            why = f"{template} asks for it" if column in asked else "each loop needs one"
            raise ProjectError(f"{table} has no column {column!r} ({why}); it has: {', '.join(columns)}")
    for line, row in rows:
        name, origin = row["name"], f"{table}, line {line}"
        if not name:
            raise ProjectError(f"{origin}: the loop has no name: fill the column 'name'")
        unsafe = next((column for column in asked if _UNSAFE.search(row[column])), None)
        problem = f"{origin}: {unsafe} holds a quote, a backslash or a control character: remove it" if unsafe else ""
        yield _Declared(name, origin, template.parent, _filled(text, row), problem=problem)


def _text_of(file: Path) -> str:
    try:
        return contents(file, ProjectError).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ProjectError(f"{file}: is not UTF-8 text: save it as UTF-8") from None


def _rows(table: Path) -> list[tuple[int, dict[str, str]]]:
    """Line number and cells of each row, without spaces around them."""
    text = _text_of(table)
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
    reader = csv.DictReader(StringIO(text), delimiter=separator, restval="", strict=True)
    try:
        rows = []
        for row in reader:
            if None in row:
                raise ProjectError(f"{table}, line {reader.line_num}: has more cells than the header: correct it")
            if any(cell.strip() for cell in row.values()):
                rows.append((reader.line_num, {str(key).strip(): cell.strip() for key, cell in row.items()}))
    except csv.Error as error:
        raise ProjectError(f"{table}, line {reader.line_num}: cannot be read as CSV ({error}): correct it") from None
    if not rows:
        raise ProjectError(f"{table} has no rows: a header and a line a loop are needed")
    return rows


def _filled(template: str, row: Mapping[str, str]) -> str:
    """The template with the cells in their places; a line that asks for an empty cell is left out."""
    lines = [
        _PLACE.sub(lambda found: row[found[1]], line)
        for line in template.split("\n")
        if all(row[name] for name in _PLACE.findall(line))
    ]
    return "\n".join(lines)


def _check_names(site: Site, names: Sequence[str]) -> None:
    files: dict[str, str] = {}
    for name, count in Counter(names).items():
        other = files.setdefault(_file_name(name).lower(), name)
        if count > 1:
            raise ProjectError(f"{site.source}: two loops are called {name!r}: give each a name of its own")
        if other != name:
            raise ProjectError(f"{site.source}: the loops {other!r} and {name!r} would share a file: rename one")


def _file_name(name: str) -> str:
    return f"{_NO_NAME.sub('_', name).lstrip('.') or 'loop'}.toml"


def _job(one: _Declared, folder: Path, window: Window | None, made: dict[str, str]) -> Job:
    """The job of a loop; the text of a project that has to be made goes into `made`, by file name."""
    place = folder / _file_name(one.name)
    if one.problem:
        return Job(one.name, place, one.origin, one.problem)
    try:
        text = one.text if one.file is None else _text_of(one.file)
        if one.file is not None and (window is None or not _has_source(text)):
            return Job(one.name, one.file, one.origin)
        text = _with_window(text, window, own=one.file is None)
        moved = Project.from_toml(text, one.folder).to_toml(folder.resolve())
        made[place.name] = with_moved_paths(moved, str, f"{place.stem}-snapshot.parquet")
    except (ProjectError, UsageError) as error:
        said = str(error).replace(str(one.folder / "project.toml"), one.origin)
        return Job(one.name, place, one.origin, said)
    return Job(one.name, place, one.origin)


def _has_source(text: str) -> bool:
    try:
        data = tomllib.loads(text).get("data", {})
    except tomllib.TOMLDecodeError:
        return False
    return isinstance(data, dict) and "source" in data


def _with_window(text: str, window: Window | None, own: bool) -> str:
    """The project text that reads the window from its historian; other projects keep what they say."""
    if window is None or not _has_source(text):
        return text
    start, end = window
    done = False

    def change(tables: object) -> None:
        nonlocal done
        data = tables.get("data") if isinstance(tables, Mapping) else None
        if not done and isinstance(data, dict) and set(data) - {"source", "exclude"}:
            data["from"], data["to"] = start, end
            done = True

    changed = edited(text, change)
    if done:
        return changed
    inside = f"from = {start.isoformat()}\nto = {end.isoformat()}\n"
    parts = list(sections(text))
    header = next((k for k, part in enumerate(parts) if part.lstrip().startswith("[data]")), None)
    if header is not None:
        head, rest = parts[header].split("[data]", 1)
        parts[header] = f"{head}[data]\n{inside}{rest.lstrip(chr(10))}"
        return "".join(parts)
    return f"{text.rstrip()}\n\n[data]\n{inside}"
