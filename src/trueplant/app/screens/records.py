"""Records as the screen Trends shows them: read once, kept as long as the file and its reading are the same."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from trueplant.app import levels
from trueplant.app.screens.decimate import Signal, breaks, edges_of
from trueplant.arrays import Array, BoolArray
from trueplant.calendar import Calendar
from trueplant.project import ExperimentPlan, Project
from trueplant.record import read_record
from trueplant.record.segments import clock_of
from trueplant.result import Exclusion

KEPT = 2
"""Records that are kept: ten million samples of two loops take 0.3 GB."""
ALL = "all"
"""What an exclusion names where it is of every signal."""

Struck = tuple[tuple[float, float, str], ...]
"""Stretches (from, to, signal) that are not shown."""


@dataclass(frozen=True, eq=False)
class Shown:
    """A record: times (N,) and its signals by ("pv", output), ("sp", output) and ("op", input)."""

    t: Array
    signals: Mapping[tuple[str, str], Signal]
    calendar: Calendar
    gap: float
    """Steps longer than this are gaps."""
    step: float
    """From one sample to the next, mostly."""
    struck: Struck = ()

    def without(self, struck: Struck) -> Shown:
        """The same with these stretches as gaps: of a PV alone, or of all signals."""
        if struck == self.struck:
            return self
        whole = self._mask(s for s in struck if s[2] == ALL)
        signals = {}
        for (kind, name), signal in self.signals.items():
            own = self._mask(s for s in struck if s[2] == name) if kind == "pv" else None
            signals[kind, name] = signal.without(whole if own is None else whole | own)
        return Shown(self.t, signals, self.calendar, self.gap, self.step, struck)

    def _mask(self, stretches: Iterable[tuple[float, float, str]]) -> BoolArray:
        out = np.zeros(self.t.size, dtype=bool)
        spans = [(start, end) for start, end, _ in stretches]
        if spans:
            ends = np.array(spans)
            begins = np.searchsorted(self.t, ends[:, 0])
            for a, b in zip(begins, np.searchsorted(self.t, ends[:, 1], side="right"), strict=True):
                out[a:b] = True
        return out

    def view(self, start: float, end: float, points: int) -> dict[str, Array]:
        """Two rows a stretch, its lowest and its highest sample, or one where the stretch is one sample.

        "t" (n,), and by "pv output", "sp output" and "op input" the signals; NaN is a gap.
        """
        edges = edges_of(self.t, start, end, points)
        first = edges[:-1]
        single = bool(first.size == 0 or np.all(np.diff(edges) == 1))
        broken = np.flatnonzero(breaks(self.t, edges, self.gap))
        t = self.t[first] if single else np.repeat(self.t[first], 2)
        if not single:
            last = self.t[edges[1:] - 1]
            t[1::2] = (t[::2] + last) / 2
        at = broken if single else 2 * broken
        out = {"t": np.insert(t, at, self.t[first[broken]] - self.gap / 2)}
        for (kind, name), signal in self.signals.items():
            if single:
                x = signal.shown(int(edges[0]), int(edges[-1])).astype(float) if edges.size else np.zeros(0)
            else:
                low, high = signal.extremes(edges)
                x = np.empty(2 * low.size)
                # up and down in turn, so that the lines between stretches are short
                x[::2], x[1::2] = low, high
                x[2::4], x[3::4] = high[1::2], low[1::2]
            out[f"{kind} {name}"] = np.insert(x, at, np.nan)
        return out

    def first_last(self, start: float, end: float) -> tuple[float, float] | None:
        """The first and the last sample of a stretch; None where it holds none."""
        a, b = int(np.searchsorted(self.t, start)), int(np.searchsorted(self.t, end, side="right"))
        return (float(self.t[a]), float(self.t[b - 1])) if a < b else None


def read_shown(project: Project, plan: ExperimentPlan, say: Callable[[str], None] = lambda what: None) -> Shown:
    """Read one record. Raises what the readers raise."""
    record = read_record(plan.path, project.layout(), name=plan.name, closed=plan.closed, say=say)
    signals = {}
    for i, name in enumerate(record.outputs):
        signals["pv", name] = Signal.of(record.y[:, i])
        if project.outputs[i].sp is not None:
            signals["sp", name] = Signal.of(record.r[:, i])
    for j, name in enumerate(record.inputs):
        signals["op", name] = Signal.of(record.u[:, j])
    clock = clock_of(record.t[: levels.CLOCK])
    return Shown(record.t, signals, record.calendar, clock.gap, clock.h)


def struck_of(excluded: Iterable[Exclusion]) -> Struck:
    """What `check` left out, as far as it is to be a gap."""
    return tuple((one.start, one.end, one.signal) for one in excluded)


class Records:
    """The records that were shown last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[Hashable, Shown] = OrderedDict()

    def get(self, project: Project, plan: ExperimentPlan) -> Shown:
        """A record as it is read; kept while its file and its reading stay as they are."""
        key = signature(project, plan)
        with self._lock:  # two questions at once would read it twice
            if key not in self._kept:
                while len(self._kept) >= KEPT:
                    self._kept.popitem(last=False)
                self._kept[key] = read_shown(project, plan)
            self._kept.move_to_end(key)
            return self._kept[key]

    def struck(self, project: Project, plan: ExperimentPlan, struck: Struck) -> Shown:
        """The same with these stretches as gaps."""
        shown = self.get(project, plan).without(struck)
        with self._lock:
            self._kept[signature(project, plan)] = shown
        return shown


def signature(project: Project, plan: ExperimentPlan) -> Hashable:
    """What a record as it is read depends on. Of one that is not there reading says what to do."""
    try:
        status = plan.path.stat()
    except OSError:
        return plan.path, project.layout(), plan.name, plan.closed
    return plan.path, status.st_mtime_ns, status.st_size, project.layout(), plan.name, plan.closed
