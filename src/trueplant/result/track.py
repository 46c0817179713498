"""What tracking returns: frozen data and its JSON form, track.json (schema 1)."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

from trueplant.calendar import Calendar
from trueplant.result.changes import Change, TrackedElement, TrackedExperiment, Window
from trueplant.result.codec import document
from trueplant.result.provenance import Provenance
from trueplant.result.reason import Reason
from trueplant.result.status import Status
from trueplant.result.track_words import headline


@dataclass(frozen=True, eq=False)
class Track:
    """The outcome of tracking. `to_dict` is track.json (schema 1)."""

    status: Status
    """Refused if no window could be fitted."""
    reasons: tuple[Reason, ...]
    notes: tuple[Reason, ...]
    provenance: Provenance
    time_unit: str
    experiments: tuple[TrackedExperiment, ...]
    """In the order of the project."""
    elements: tuple[TrackedElement, ...] = ()
    changes: tuple[Change, ...] = ()
    windows: tuple[Window, ...] = ()
    start: str | None = None
    """Time stamp of time 0 of the common axis, where all records have time stamps."""
    time_zone: str | None = None
    """In which its time stamps are shown: a name, or an offset from UTC."""

    @property
    def calendar(self) -> Calendar:
        """The times of the common axis in words."""
        return Calendar.of(self.time_unit, self.start, self.time_zone)

    @property
    def headline(self) -> str:
        """What changed and since when, in a sentence or two."""
        return headline(self)

    def to_dict(self) -> dict[str, Any]:
        """track.json as plain Python; numbers that are not finite become None."""
        return document(self)

    def __repr__(self) -> str:
        return f"Track({self.status}: {self.headline})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(e.input)} → {escape(e.output)}</td><td>{escape(e.history)}</td><td>{e.windows}</td></tr>"
            for e in self.elements
        )
        head = "<tr><th>element</th><th>history</th><th>windows</th></tr>"
        table = f"<table>{head}{rows}</table>" if rows else ""
        return f"<p><b>{escape(self.headline)}</b></p>{table}"
