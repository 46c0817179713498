"""Is a declared controller the law that wrote OP? If not: what did, and from when on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Kind, Sum, law_parts
from trueplant.record import Segment
from trueplant.record.sensor import update_every
from trueplant.result import ControllerCheck, Interval, LawRatio
from trueplant.study import levels
from trueplant.study.data.by_hand import without_hand
from trueplant.study.data.excitation import mostly_filled_in
from trueplant.study.data.law_judged import NAMES, Judged, Ratio, judged, parted
from trueplant.study.data.law_windows import Stretch
from trueplant.study.data.op_law import written_from_samples
from trueplant.study.study import Study


def check_controllers(study: Study) -> tuple[ControllerCheck, ...]:
    """One entry for each closed experiment and input with a declared controller, as in result.json."""
    entries = []
    for k, plan in enumerate(study.project.experiments):
        controller = study.records.declared[k] if plan.closed else None
        if controller is None:
            continue
        for i in sorted({i for i, _ in controller.entries}):
            entry = _entry(study, k, plan.name, controller, i)
            entries.append(_excused(entry, plan.beyond(study.project.input_names[i])))
    return tuple(entries)


def _excused(entry: ControllerCheck, beyond: str) -> ControllerCheck:
    """A law that has more than is replayed is not wrong for that what is replayed does not reproduce OP."""
    if entry.confirmed is not False or not beyond:
        return entry
    text = f"the controller has {beyond}, which is not replayed and may be why its PID alone does not reproduce OP"
    return replace(entry, confirmed=None, message=text, since=None, since_calendar=None)


def _entry(study: Study, k: int, name: str, controller: Controller, i: int) -> ControllerCheck:
    signal = study.project.inputs[i]
    unchecked = ControllerCheck(name, signal.name, signal.unit, None, None, "the controller cannot be checked: ")
    try:
        written = _Written.of(study, k, controller, i)
        unchecked = replace(unchecked, by_hand=written.by_hand)
        found = judged(written.stretches, controller, i, written.scale)
    except LoopError as problem:
        return replace(unchecked, message=unchecked.message + str(problem))
    if found is None:
        free = "in automatic" if written.by_hand else "free"
        why = study.screened[k].refusal or f"there are too few samples in which OP was {free} and PV good and moving"
        return replace(unchecked, message=unchecked.message + why)
    ratios = _ratios(study, found.ratios)
    said = replace(unchecked, rms=found.missed, relative=found.missed / written.scale, ratios=ratios)
    if found.confirmed:
        exact = found.missed <= max(levels.ROUNDING * written.scale, found.rounding)
        to = "rounding" if exact else f"{found.missed:.3g} {signal.unit}".rstrip() + " rms"
        text = f"the declared controller reproduces OP to {to} ({_words(ratios)}{_summed(found)})"
        return replace(said, confirmed=True, message=text)
    if thinned := _thinned(study, k, controller, i):
        text = f"it acted on what a historian left out of {', '.join(thinned)}"
        return replace(said, message=f"{unchecked.message}{text}. From the samples that there are: {_words(ratios)}")
    if written.between(study, k, controller, i):
        text = "OP is written more often than it was recorded, or acts on what was not recorded"
        said = replace(said, message=f"{unchecked.message}{text}. From the samples that there are: {_words(ratios)}")
        if not _far_off(ratios, controller, i):
            return said
        text = f"the controller is not what was declared: by the samples that there are {_words(ratios)}"
        return replace(said, confirmed=False, message=f"{text}, more than OP's moves between them could make of it")
    if not found.known and not found.off and found.left <= found.allowed:
        text = "OP and PV move too little, or were rounded too coarsely, to tell its gain or its integral time"
        return replace(said, message=f"{unchecked.message}{text}: {_words(ratios)}")
    return _denied(study, k, said, found, written, controller, i)


def _thinned(study: Study, k: int, controller: Controller, i: int) -> list[str]:
    """OP and the PVs that the law reads of which a historian left little: it had all of them."""
    own = {study.project.input_names[i], *(study.project.output_names[j] for row, j in controller.entries if row == i)}
    return [name for name in mostly_filled_in(study, k) if name in own]


def _denied(
    study: Study, k: int, said: ControllerCheck, found: Judged, written: _Written, controller: Controller, i: int
) -> ControllerCheck:
    """What wrote OP instead: one law throughout, else the declared one in a part of the record and another in the rest.

    Only the latter is a controller that has changed.
    """
    text = "the controller is not what was declared, which does not reproduce OP: "
    for words, other in _others(controller, i):
        instead = judged(written.stretches, other, i, written.scale)
        if instead is not None and instead.confirmed:
            return replace(said, confirmed=False, message=f"{text}it does {words}, with the gains and times declared")
    if late := _late(written, controller, i):
        return replace(said, confirmed=None, message=late)
    then = parted(found) if found.left > found.allowed else None
    if then is not None:
        calendar = study.screened[k].record.calendar
        at = calendar.text(then.at)
        when = f"until {at}", f"from {at} on"
        own, rest = when if then.declared_first else when[::-1]
        law = _words(_ratios(study, then.ratios))
        message = f"the controller has changed: {own} the declared one reproduces OP, {rest} it is {law}"
        message += (
            ". To use both parts, name the file in two [[experiment]] entries, one with to = and one with from = that "
            "moment, and say in one of them what differs: controllers = [...]"
        )
        since = then.at if then.declared_first else None
        return replace(said, confirmed=False, message=message, since=since, since_calendar=calendar.stamp(since))
    if found.off:
        text += f"{_words(said.ratios)}, throughout"
        return replace(said, confirmed=False, message=text)
    text += (
        f"{_words(said.ratios)}, but that leaves {found.left:.3g} {said.unit}".rstrip()
        + f" rms of OP in windows of {found.longest} samples, {100 * found.left / written.scale:.0f} % of its "
        "own movement: it acts on something else as well, or has another filter, set-point weight, scan or mode"
    )
    return replace(said, confirmed=False, message=text)


def _others(controller: Controller, i: int) -> Iterator[tuple[str, Controller]]:
    """Laws with the same gains and times that are easily taken for the declared one."""

    def with_(change: Callable[[PID], PID]) -> Controller:
        own = {place: change(e) for place, e in pids.items()}
        return replace(controller, entries={**controller.entries, **own})

    pids = {place: e for place, e in controller.entries.items() if place[0] == i and isinstance(e, PID)}
    if any(e.parallel[2] for e in pids.values()):
        yield "with the derivative on PV", with_(lambda e: replace(e, derivative_on="pv"))
        yield "with the derivative on the error", with_(lambda e: replace(e, derivative_on="error"))
    if pids:
        yield "with the proportional part on PV", with_(lambda e: replace(e, setpoint_weight=0.0))
        yield "with the proportional part on the error", with_(lambda e: replace(e, setpoint_weight=1.0))
    if any(e.setpoint_filter for e in pids.values()):
        yield "without its set-point filter", with_(lambda e: replace(e, setpoint_filter=None))


def _ratios(study: Study, ratios: Sequence[Ratio]) -> tuple[LawRatio, ...]:
    names = study.project.output_names
    return tuple(LawRatio(names[r.output], r.name, r.value, r.std) for r in ratios)


def _words(ratios: Sequence[LawRatio]) -> str:
    """The gains and times found, in declared ones; what the record does not tell as that."""
    several = len({r.output for r in ratios}) > 1
    told, untold = [], []
    for r in ratios:
        of = f" from {r.output}" if several else ""
        if _no_integral(r):
            untold.append(f"no integral action{of} to be seen")
        elif r.std_error > max(abs(r.value), 1.0):
            untold.append(f"its {r.name}{of} cannot be told")
        else:
            digits = 3 if r.std_error < 0.005 else 2
            spread = "" if r.std_error < 0.0005 else f" ± {r.std_error:.{digits}f}"
            told.append(f"{r.name}{of} {r.value:.{digits}f}{spread}")
    return ", ".join([*([f"{', '.join(told)} times what is declared"] if told else []), *untold])


def _no_integral(r: LawRatio) -> bool:
    """Is the inverse of an integral time 0 but for its error, and surely not the declared one?"""
    if not np.isfinite(r.value):
        return True
    inverse, std = 1 / r.value, r.std_error / r.value**2
    return r.name == NAMES[Kind.INTEGRAL] and abs(inverse) < std and levels.LAW_SURE * std < 1 - inverse


def _far_off(ratios: Sequence[LawRatio], controller: Controller, i: int) -> bool:
    """Is a gain further off than it could come out where a law is recorded less often than it acts?

    What a derivative makes of PV between the samples may pass for gain; an integral moves little there.
    """
    laws = [e for (row, _), e in controller.entries.items() if row == i]
    if any(not isinstance(e, PID) or e.parallel[2] for e in laws):
        return False
    return any(
        r.name == "gain"
        and np.isfinite(r.value)
        and not 1 / levels.BETWEEN_OFF < r.value < levels.BETWEEN_OFF
        and abs(r.value - 1) > levels.LAW_SURE * r.std_error
        for r in ratios
    )


def _summed(found: Judged) -> str:
    return "" if found.integral is None else f", the integral a {found.integral} sum"


@dataclass(frozen=True, eq=False)
class _Written:
    """The samples that tell how an OP was written."""

    stretches: tuple[Stretch, ...]
    scale: float
    """Root mean square of OP's own movement."""
    by_hand: tuple[Interval, ...]
    """From when to when it was in manual, which is not in the stretches."""

    @classmethod
    def of(cls, study: Study, k: int, controller: Controller, i: int) -> _Written:
        stretches = tuple(_stretch(study, k, controller, i, s) for s in _enough(study.screened[k].segments))
        u = np.concatenate([np.zeros(0), *(s.u for s in stretches)])
        stretches, by_hand = without_hand(stretches, controller, i)
        return cls(stretches, (float(np.std(u)) if u.size else 0.0) or 1.0, by_hand)

    def between(self, study: Study, k: int, controller: Controller, i: int) -> bool:
        """May OP have been written between the samples?"""
        scans = [e.sample_time for (row, _), e in controller.entries.items() if row == i]
        h = study.screened[k].segments[0].h
        if any(scan is not None and scan < (1 - levels.WHOLE_SCAN) * h for scan in scans):
            return True
        return None in scans and not written_from_samples(study.records, k, i)


def _enough(segments: Sequence[Segment]) -> Iterator[Segment]:
    """The segments; of very long records evenly spaced pieces, which tell the law just as well."""
    every = -(-sum(map(len, segments)) // levels.LAW_SAMPLES)
    size = levels.LAW_SAMPLES // levels.LAW_WINDOWS if every > 1 else max(map(len, segments), default=1)
    pieces = [(segment, slice(at, at + size)) for segment in segments for at in range(0, len(segment), size)]
    for segment, part in pieces[:: max(every, 1)]:
        yield segment.part(part.start, part.stop)


def _stretch(study: Study, k: int, controller: Controller, i: int, segment: Segment) -> Stretch:
    """A segment at the law's scans, and where it tells: OP free, not held over a gap, set-points and PVs good."""
    record, entries = study.screened[k].record, {j: e for (row, j), e in controller.entries.items() if row == i}
    needed = sorted(entries)
    latest = np.clip(np.searchsorted(record.t, segment.t + 0.25 * segment.h, side="right") - 1, 0, record.t.size - 1)
    good = segment.free[:, i] & np.isfinite(record.u[latest, i])
    good &= np.isfinite(segment.y[:, needed]).all(axis=1) & np.isfinite(segment.r[:, needed]).all(axis=1)
    r, y, u = held(segment.r), held(segment.y), segment.u[:, i]
    every, first = _scan(segment, [e.sample_time for e in entries.values()], u)
    at = slice(first, None, every)
    h = every * segment.h
    good, u, r, y = good[at], u[at], r[at], y[at]
    limits = study.project.experiments[k].limits[i]
    if limits is not None and good.any():
        # a law that stops its integral at a limit stops it a step before OP would get there
        parts = law_parts(controller, i, r, y, h, Sum.BACKWARD, Sum.BACKWARD, 1)
        step = sum((np.diff(p.values, prepend=0.0) for p in parts if p.kind is Kind.INTEGRAL), np.zeros(u.size))
        edge = levels.NEAR_LIMIT * (limits[1] - limits[0])
        for ahead in (u, u + 2 * step):
            good &= (ahead > limits[0] + edge) & (ahead < limits[1] - edge)
    return Stretch(segment.t[at], u, r, y, good, h, held(segment.setpoints)[at])


def _late(written: _Written, controller: Controller, i: int) -> str:
    """What is recorded a sample late, if the declared law explains OP with that alone; else nothing."""
    for signals, other, late, error in (("tu", "last", "OP", "short"), ("y", "next", "PV", "long")):
        stretches = [_a_sample_back(stretch, *signals) for stretch in written.stretches]
        instead = judged(stretches, controller, i, written.scale)
        if instead is not None and instead.confirmed:
            text = f"the declared controller reproduces OP from the {other} PV instead of the one beside it"
            said = f"where {late} was recorded a sample late, dead times come out {stretches[0].h:.6g} too {error}"
            return f"{text}: {said}"
    return ""


def _a_sample_back(stretch: Stretch, *late: str) -> Stretch:
    """With what is `late` beside what was recorded a sample before it."""
    moved = {name: getattr(stretch, name)[1:] if name in late else getattr(stretch, name)[:-1] for name in "tury"}
    settled = None if stretch.settled is None else stretch.settled[:-1]
    return replace(stretch, **moved, good=stretch.good[1:] & stretch.good[:-1], settled=settled)


def held(x: Array) -> Array:
    """x (N, n) with its last value where it is missing; zero where it is missing throughout."""
    known = np.isfinite(x)
    last = np.maximum.accumulate(np.where(known, np.arange(len(x))[:, None], np.argmax(known, axis=0)), axis=0)
    return np.asarray(np.nan_to_num(np.take_along_axis(x, last, axis=0)))


def _scan(segment: Segment, scans: Sequence[float | None], u: Array) -> tuple[int, int]:
    """Samples from one scan of the law to the next, and the first of them at which it scanned.

    Raises LoopError for scans that differ, or are no whole multiples of the sample time.
    """
    declared = {scan for scan in scans if scan is not None}
    if len(declared) > 1:
        raise LoopError("the laws that write this OP have scans that differ")
    samples = min(declared) / segment.h if declared else update_every(u)
    every = max(round(samples), 1)
    if declared and samples > 1 and abs(samples - every) > levels.WHOLE_SCAN * every:
        raise LoopError(f"its scan is no whole multiple of the sample time ({segment.h:g}): check sample_time")
    moved = np.flatnonzero(np.diff(u)) + 1
    return every, int(np.argmax(np.bincount(moved % every, minlength=every)))
