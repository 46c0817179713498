"""From a project to the snapshot of its historian: whole, or not at all."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from trueplant.connect import levels
from trueplant.connect.settings import Settings, host_of
from trueplant.connect.snapshot import Snapshot
from trueplant.connect.source import Lost, Quality, Source, TagInfo, Window
from trueplant.connect.sources import open_source
from trueplant.errors import DataError, ProjectError, SourceError, TrueplantError
from trueplant.project import Project
from trueplant.project.source_table import PATHS
from trueplant.version import __version__

if TYPE_CHECKING:
    import polars as pl

Say = Callable[[str], None]
T = TypeVar("T")
_NOT_ASKED = (
    *("page", "timeout", "snapshot", "user", "password_env", "password_file", "token_env", "token_file", "auth", "ca"),
    *("security", "policy", "certificate", "private_key", "server_certificate"),
)
"""Keys of [data.source] that do not change what is read."""


@dataclass(frozen=True)
class Fetched:
    """A snapshot, and what its JSON file says."""

    path: Path
    about: dict[str, Any]
    new: bool
    """Was it fetched now?"""


def ensure(project: Project, say: Say = lambda what: None) -> None:
    """Fetch the snapshot of a project that names a historian, unless it is there. Raises what `fetch` raises."""
    if project.data.source is not None:
        fetch(project, say=say)


def fetch(project: Project, refresh: bool = False, say: Say = lambda what: None) -> Fetched:
    """Read the events of a project's window into its snapshot; one that is there already is kept unless `refresh`.

    Raises ProjectError for a project without [data.source] and for secrets that are not there, UsageError for a
    package that is not installed, SourceError where the source does not answer, DataError for what it answers, and
    OutputError where the snapshot cannot be written.
    """
    table = project.data.source
    if table is None:
        raise ProjectError(f"{project.source}: names no historian: add [data.source], or run it as it is")
    snapshot = Snapshot(project.folder / project.snapshot)
    wanted = Wanted.of(project)
    if not refresh and snapshot.holds(wanted.query):
        return Fetched(snapshot.events, snapshot.told() or {}, new=False)
    snapshot.check_free()
    settings = Settings(table, project.folder, table.time_zone or project.data.time_zone)
    with Patient(settings) as patient:
        infos = patient.describe(list(wanted.tags.values()))
        events = _read(patient, wanted, say, project.layout().most)
        server = patient.server
    say("writing the snapshot")
    when = datetime.now(UTC).isoformat(timespec="seconds")
    about: dict[str, Any] = {"version": __version__, "fetched": when, "server": server}
    about |= {"query": wanted.query, "events": events.height, "tags": _told(events, wanted, infos)}
    return Fetched(snapshot.events, snapshot.write(events, about), new=True)


@dataclass(frozen=True)
class Wanted:
    """What is asked of a source."""

    tags: dict[str, str]
    """Names in the project to those of the source."""
    held: tuple[str, ...]
    """Those (in the project) that keep their value until the next event."""
    window: Window
    query: dict[str, Any]
    """All of it as plain text, without secrets; the same query has the same answer."""

    @classmethod
    def of(cls, project: Project) -> Wanted:
        table, layout = project.data.source, project.layout()
        assert table is not None
        window = Window(*project.window)
        tags = {name: table.tag.replace("{}", name) for name in dict.fromkeys([*layout.continuous, *layout.held])}
        said = {key: value for key, value in table.model_dump(exclude_none=True).items() if key not in _NOT_ASKED}
        # from the folder of the snapshot, so that plant.toml, which lies elsewhere, asks the same
        there = (project.folder / project.snapshot).parent
        said |= {key: os.path.relpath(project.folder / said[key], there) for key in PATHS if key in said}
        query = {"source": said, "tags": tags, "from": window.start.isoformat(), "to": window.end.isoformat()}
        if project.data.time_zone is not None:
            query["time_zone"] = project.data.time_zone
        return cls(tags, tuple(name for name in layout.held if name not in layout.continuous), window, query)


class Patient:
    """A source that is opened again where the connection was lost, a few times and ever more slowly."""

    def __init__(self, settings: Settings) -> None:
        table = settings.table
        self._settings, self._reached = settings, False
        self.server = host_of(table.url) if table.url else table.path or table.kind
        self._source: Source | None = None

    def __enter__(self) -> Patient:
        return self

    def __exit__(self, *_: object) -> None:
        self._drop()

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        return self._try(lambda source: source.describe(tags))

    def read(self, tags: Sequence[str], window: Window) -> list[pl.DataFrame]:
        """All pages of a window."""
        return self._try(lambda source: list(source.read(tags, window)))

    def _try(self, ask: Callable[[Source], T]) -> T:
        reason = Lost("")
        for attempt in range(levels.ATTEMPTS):
            if attempt:
                time.sleep(min(max(levels.PAUSE * 2 ** (attempt - 1), reason.pause), levels.LONGEST_PAUSE))
            try:
                with _answering(self._settings):
                    if self._source is None:
                        self._source = open_source(self._settings)
                        self.server = self._source.server
                    answer = ask(self._source)
                    self._reached = True
                    return answer
            except Lost as lost:
                reason = lost
                self._drop()
                if not self._reached:  # never reached: asking again would only lock the account
                    break
        raise SourceError(
            f"{self.server} does not answer ({self._settings.clean(reason)}); nothing was "
            "written: check the address, the network and the server, and try again"
        )

    def _drop(self) -> None:
        source, self._source = self._source, None
        if source is not None:
            try:
                source.close()
            except Exception:  # it is being left anyway, and what matters has been said
                return


@contextmanager
def _answering(settings: Settings) -> Iterator[None]:
    """Whatever a foreign library raises becomes one message without secrets."""
    try:
        yield
    except (TrueplantError, Lost, KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except (TimeoutError, ConnectionError) as error:
        raise Lost(settings.clean(str(error) or type(error).__name__)) from None
    except BaseException as error:  # a panic of a library that is not written in Python is no Exception
        reason = settings.clean(f"{type(error).__name__}: {error}")
        raise SourceError(
            f"the source (kind = {settings.table.kind!r}) cannot be read ({reason}); nothing was written: check "
            "the keys of [data.source]"
        ) from None


def _read(patient: Patient, wanted: Wanted, say: Say, most: int) -> pl.DataFrame:
    """All events in order of tag and time, each once. Raises DataError for a tag without any, and for too many."""
    import polars as pl

    names = {address: name for name, address in wanted.tags.items()}
    say("reading what set-points and OP were before")
    pages = _before(patient, [wanted.tags[name] for name in wanted.held], wanted.window.start)
    total = (wanted.window.end - wanted.window.start).total_seconds()
    rows = 0
    for part in wanted.window.slices(levels.SLICE):
        done = (part.start - wanted.window.start).total_seconds() / total
        say(f"reading {patient.server}, {100 * done:.0f} %, {rows:,} events")
        own = [_inside(page, part, names) for page in patient.read(list(names), part)]
        rows += sum(page.height for page in own)
        pages += own
        if rows > most:
            raise DataError(
                f"more than {most:,} events are in this window: take a shorter one, or set data.max_samples if that is "
                "meant"
            )
    empty: dict[str, Any] = {
        "tag": pl.String,
        "time": pl.Datetime("us", "UTC"),
        "value": pl.Float64,
        "quality": pl.String,
    }
    pages = pages or [pl.DataFrame(schema=empty)]
    whole = pl.concat(pages).unique(["tag", "time"], keep="last", maintain_order=True)
    whole = whole.with_columns(pl.col("tag").replace_strict(names, return_dtype=pl.String)).sort("tag", "time")
    _check_all_there(whole, wanted)
    return whole


def _before(patient: Patient, tags: Sequence[str], moment: datetime) -> list[pl.DataFrame]:
    """The last event of each tag before a moment, as far as there is one."""
    import polars as pl

    found: list[pl.DataFrame] = []
    for seconds in levels.LEADS:
        missing = [tag for tag in tags if not any(tag in page["tag"] for page in found)]
        if missing:
            lead = Window(moment - timedelta(seconds=seconds), moment)
            pages = [_inside(page, lead, missing) for page in patient.read(missing, lead)]
            last = [page.sort("time", maintain_order=True).unique("tag", keep="last") for page in pages]
            found += [pl.concat(last).sort("time", maintain_order=True).unique("tag", keep="last")] if last else []
    return found


def _inside(page: pl.DataFrame, window: Window, tags: Any) -> pl.DataFrame:
    import polars as pl

    own = pl.col("tag").is_in(list(tags)) & pl.col("time").is_between(window.start, window.end, closed="left")
    return page.filter(own)


def _check_all_there(events: pl.DataFrame, wanted: Wanted) -> None:
    empty = [name for name in wanted.tags if name not in set(events["tag"].unique())]
    if empty:
        address = wanted.tags[empty[0]]
        more = f" (and {len(empty) - 1} more tags)" if len(empty) > 1 else ""
        raise DataError(
            f"the source has no event of tag {address!r}{more} from {wanted.window.start:%Y-%m-%d %H:%M} to "
            f"{wanted.window.end:%Y-%m-%d %H:%M} UTC: correct the tag, data.source.tag, or from and to; a set-point "
            "that nobody moves may be left out"
        )


def _told(events: pl.DataFrame, wanted: Wanted, infos: Sequence[TagInfo]) -> list[dict[str, Any]]:
    """What the JSON file says of each tag."""
    import polars as pl

    counts = {
        row["tag"]: row
        for row in events.group_by("tag")
        .agg(
            pl.len().alias("events"),
            *((pl.col("quality") == str(word)).sum().alias(str(word)) for word in Quality),
            pl.col("time").min().alias("first"),
            pl.col("time").max().alias("last"),
        )
        .to_dicts()
    }
    told = []
    for (name, address), info in zip(wanted.tags.items(), infos, strict=True):
        known: dict[str, Any] = {"unit": info.unit, "span": info.span, "step": info.step}
        known |= {"states": {str(code): word for code, word in info.states.items()} or None}
        said = {key: value for key, value in known.items() if value is not None}
        span = {end: counts[name][end].isoformat() for end in ("first", "last")}
        told.append(counts[name] | span | {"tag": name, "address": address} | said)
    return told
