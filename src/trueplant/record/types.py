"""What was measured: frozen records, what screening found in them, and the segments that can be used."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.calendar import Calendar


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment as it was read. NaN marks what is missing; nothing is altered or filled in.

    Time first: t (N,), r (N, n_y), y (N, n_y), u (N, n_u), d (N, n_d); t increases strictly and is in
    `time_unit`. r is all NaN where no set-point was recorded. `automatic` (N, n_u) is True where the
    loop was in automatic (all True without a mode column). The slave signals (N, n_u) are NaN if absent.
    """

    name: str
    t: Array
    r: Array
    u: Array
    y: Array
    d: Array
    automatic: BoolArray
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    time_unit: str
    hold: tuple[str, ...]
    """One of "zoh", "linear" for each input: how it runs between samples."""
    d_hold: tuple[str | None, ...] = ()
    """The same for each measured disturbance; None where it was not declared."""
    closed: bool = True
    slave_sp: Array | None = None
    slave_pv: Array | None = None
    start: datetime | None = None
    """The moment at t = 0: in UTC, or without a zone as the clock showed it; None for numeric time."""
    zone: str | None = None
    """In which moments are shown: a name, or an offset from UTC."""
    source: str = ""
    sha256: str = ""
    notes: tuple[Finding, ...] = ()
    """What the reader already had to say (text among numbers, duplicates dropped, time zone assumed ...)."""

    @property
    def sample_time(self) -> float:
        """Median step of t."""
        return float(np.median(np.diff(self.t)))

    @property
    def calendar(self) -> Calendar:
        """Its times in words."""
        return Calendar(self.time_unit, self.start, self.zone)

    @property
    def mean_pv(self) -> Array:
        """(n_y,) over the samples that there are; 0 where there are none."""
        known = np.isfinite(self.y)
        return np.asarray(np.where(known, self.y, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


class Kind(StrEnum):
    """What a finding is about."""

    # of reading
    SHEET = "sheet"
    """A workbook has several sheets, and none was named."""
    DECIMAL = "decimal"
    """The comma could be the decimal mark or between thousands."""
    DATE_ORDER = "date-order"
    """Day and month could be swapped."""
    TIME = "time"
    """Numbers of time were read as moments."""
    ZONE = "zone"
    """Stamps bear several offsets, and no zone was named."""
    ALIGNED = "aligned"
    """The tags of a long export bear stamps of their own."""
    BAD_QUALITY = "bad-quality"
    """The historian does not trust the value."""
    TEXT = "text"
    """A word stands where a number should."""
    CODE = "code"
    """A number stands there that is no measurement: infinite, or a code of the system that wrote it."""
    MODE = "mode"
    """Which modes there are, and which of them count as automatic."""
    CONSTANT = "constant"
    """A column holds one value throughout."""
    BACKWARDS = "backwards"
    """Rows were not in the order of time."""
    DUPLICATE = "duplicate"
    """A row bears the time of the one before."""
    OVERLAP = "overlap"
    """Another record holds these samples too."""
    # of the clock
    GAP = "gap"
    """Rows are missing."""
    IRREGULAR = "irregular"
    """The steps of time are not even."""
    # of one signal
    MISSING = "missing"
    """There is no value."""
    EXCLUDED = "excluded"
    """The user leaves this stretch out."""
    SATURATED = "saturated"
    """OP was at a limit."""
    MANUAL = "manual"
    """OP was written by a person."""
    OUT_OF_RANGE = "out-of-range"
    """PV was at or beyond the range of its sensor."""
    FROZEN = "frozen"
    """PV stood still although OP moved."""
    SPIKE = "spike"
    """PV left its neighbours for a moment."""
    OUTLIER = "outlier"
    """PV lies far from all its other values."""
    HELD = "held"
    """PV is updated less often than it is recorded."""
    QUANTISED = "quantised"
    """PV moves in steps."""
    COMPRESSED = "compressed"
    """A historian drew straight lines between the values that it stored."""


@dataclass(frozen=True)
class Finding:
    """One thing that screening noticed, in words a shift engineer understands."""

    kind: Kind
    signal: str
    message: str
    spans: tuple[tuple[float, float], ...] = ()
    """(from, to) in the record's time."""
    samples: int = 0
    excludes: bool = False
    """True if samples were left out because of it."""
    value: float | None = None
    """The measured size where there is one: quantum, hold interval, share of samples, ..."""


class Load(NamedTuple):
    """Something nobody recorded that acts like an input, at a constant level from one time on."""

    column: int
    """Of the input that it acts like."""
    time: float
    """In the record's clock."""

    def course(self, t: Array) -> Array:
        """Itself, of size 1, at equidistant times t (n,)."""
        nearly = 1e-6 * (t[1] - t[0]) if t.size > 1 else 0.0
        return np.asarray(t >= self.time - nearly, dtype=float)


@dataclass(frozen=True, eq=False)
class Stamps:
    """Samples at odd instants, from which a segment was put on its grid."""

    t: Array
    """(M,)"""
    u: Array
    """(M, n_u)"""
    d: Array
    """(M, n_d)"""
    known: BoolArray
    """(M, n_y) where PV can be used."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A stretch of one record on a uniform grid, ready for estimation.

    u and d are finite throughout; y is NaN where a sample must not be used; r is NaN where unknown.
    `free` (N, n_u) is True where OP was neither at a limit nor in manual.
    """

    experiment: int
    h: float
    t: Array
    r: Array
    u: Array
    y: Array
    d: Array
    free: BoolArray
    hold: tuple[str, ...]
    closed: bool = True
    jumps: tuple[tuple[int, ...], ...] = ()
    """For each output the samples from which on a disturbance holds it at another level; empty where none is known."""
    d_hold: tuple[str, ...] = ()
    """How each measured disturbance runs between samples, as `hold`; empty: all in straight lines."""
    loads: tuple[Load, ...] = ()
    """Steps that nobody recorded, as far as they were found."""
    sent: Array | None = None
    """(N, n_u) OP as it was sent, where `u` is where valves went that did not follow it."""
    stamps: Stamps | None = None
    """What was recorded at other instants than those of the grid, as long as it counts that it was not on the grid."""
    d_timing: tuple[float, ...] = ()
    """Standard error of the instants of each measured disturbance, where it is not known how it runs between odd
    instants; empty: none."""
    settled: Array | None = None
    """(N, n_y) set-points without what the record does not resolve, where `r` has some of that."""
    spikes: Array | None = None
    """(N, n_y) what was taken off y where PV left its course for a moment, 0 at all other samples."""

    @property
    def setpoints(self) -> Array:
        """(N, n_y) as they count for moves: what differs here has moved."""
        return self.r if self.settled is None else self.settled

    @property
    def taken_off(self) -> Array:
        """(N, n_y) `spikes`, where there are none 0."""
        return np.zeros(self.y.shape) if self.spikes is None else self.spikes

    @property
    def holds(self) -> tuple[str, ...]:
        """Of the inputs, followed by the measured disturbances. A controller writes OP after it read PV."""
        written = ("written" if of_op == "zoh" and self.closed else of_op for of_op in self.hold)
        return (*written, *(self.d_hold or ("linear",) * self.d.shape[1]))

    def part(self, first: int, end: int | None = None) -> Segment:
        """From one sample to before another."""
        signals = {name: getattr(self, name)[first:end] for name in ("t", "r", "u", "y", "d", "free")}
        signals |= {
            name: x[first:end] for name in ("sent", "settled", "spikes") if (x := getattr(self, name)) is not None
        }
        last = len(self) if end is None else end
        jumps = tuple(tuple(k - first for k in own if first < k < last) for own in self.jumps)
        return replace(self, jumps=jumps, **signals)

    def free_spans(self) -> list[tuple[int, int]]:
        """First sample and end of each stretch in which no OP is at a limit or in manual."""
        free = np.concatenate([[False], self.free.all(axis=1), [False]])
        return [(int(a), int(b)) for a, b in np.flatnonzero(np.diff(free)).reshape(-1, 2)]

    def free_parts(self) -> tuple[Segment, ...]:
        """The stretches in which no OP is at a limit or in manual: there the loop is linear from set-point to OP."""
        return tuple(self.part(a, b) for a, b in self.free_spans())

    def __len__(self) -> int:
        return int(self.t.size)


class Unusable(StrEnum):
    """Why nothing of a record can be used."""

    EXCLUDED = "excluded"
    """All of it was left out by the user."""
    STILL = "op-still"
    """No OP moves."""
    FROZEN = "frozen"
    """No PV moves."""
    COMPRESSED_PV = "pv-compressed"
    """A historian left little more than straight lines of PV ..."""
    COMPRESSED_OP = "op-compressed"
    """... or of the OP of a controller: what moved the plant is not in the record."""
    TOO_FEW = "too-few"
    """Hardly a PV sample can be used."""
    CUT_UP = "cut-up"
    """No stretch between gaps is long enough."""


@dataclass(frozen=True)
class Refusal:
    """Why nothing of a record can be used, and in a sentence what to do."""

    why: Unusable
    message: str


@dataclass(frozen=True, eq=False)
class Screened:
    """A record, what was found in it, and what of it can be used."""

    record: Record
    findings: tuple[Finding, ...]
    segments: tuple[Segment, ...]
    usable_y: BoolArray
    """(N, n_y) on the record's own samples."""
    saturated: BoolArray
    """(N, n_u) on the record's own samples."""
    refused: Refusal | None = None
    """Why nothing of it can be used, if so."""
    update_interval: Array = field(default_factory=lambda: np.zeros(0))
    """(n_y,) time between real updates of each PV (its sample time unless PV is held longer)."""

    @property
    def refusal(self) -> str | None:
        """The sentence of `refused`."""
        return self.refused.message if self.refused else None
