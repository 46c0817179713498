"""What the result says of the data, and of where it comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.arrays import BoolArray
from trueplant.record import Finding, Record, Screened, excitation
from trueplant.record.moves import pv_noise, setpoint_moves
from trueplant.result import (
    Calendar,
    DataFinding,
    Excitation,
    Exclusion,
    ExperimentData,
    Provenance,
    SetpointMoves,
    Settings,
    SignalExcitation,
)
from trueplant.result.data_words import moves_sentence
from trueplant.study import levels
from trueplant.study.study import Study
from trueplant.version import __version__


def provenance(study: Study, precision_percent: float | None = None) -> Provenance:
    """Where the result comes from, enough to make it again; `precision_percent` is that of tracking."""
    project, settings = study.project, study.project.analysis
    records = [screened.record for screened in study.screened]
    return Provenance(
        version=__version__,
        project=project.source,
        project_sha256=project.sha256,
        data_sha256={record.name: record.sha256 for record in records},
        time_spans={record.name: (float(record.t[0]), float(record.t[-1])) for record in records},
        time_unit=project.time_unit,
        seed=settings.seed,
        settings=Settings(settings.method, settings.confidence, settings.tolerance_percent, precision_percent),
        model_sha256={one.file: one.sha256 for one in project.models.values() if one.file},
    )


def data_tables(study: Study) -> tuple[ExperimentData, ...]:
    """One table an experiment: what was read, what is used, what was found."""
    return tuple(_table(study, screened) for screened in study.screened)


def _table(study: Study, screened: Screened) -> ExperimentData:
    record = screened.record
    findings, calendar = screened.findings, record.calendar
    whole = float(record.t[0]), float(record.t[-1])
    used = tuple((float(s.t[0]), float(s.t[-1])) for s in screened.segments)
    return ExperimentData(
        name=record.name,
        loop="closed" if record.closed else "open",
        samples=int(record.t.size),
        sample_time=record.sample_time,
        start=record.start.isoformat() if record.start else None,
        span=whole,
        used=used,
        usable_share=_shares(study.project.output_names, screened.usable_y),
        saturated_share=_shares(study.project.input_names, screened.saturated),
        excluded=tuple(
            Exclusion(*span, f.signal, f.kind, calendar.stamps(span))
            for f in findings
            if f.excludes
            for span in f.spans
        ),
        findings=tuple(_finding(f, calendar) for f in findings),
        refused=screened.refusal,
        time_zone=record.zone,
        span_calendar=calendar.stamps(whole),
        used_calendar=_stamps(used, calendar),
        excitation=_excitation(study, screened) if screened.segments else None,
        setpoints=_setpoints(study, record),
    )


def _setpoints(study: Study, record: Record) -> tuple[SetpointMoves, ...]:
    """How each recorded set-point moves, whatever screening made of the record."""
    rows = []
    for i, (entry, moves) in enumerate(zip(study.project.outputs, setpoint_moves(record), strict=True)):
        if moves is None:
            continue
        sizes = np.abs(moves.sizes)
        smallest, median, largest = np.quantile(sizes, [0.0, 0.5, 1.0]).tolist() if sizes.size else (None,) * 3
        found = SetpointMoves(
            entry.name,
            entry.unit,
            moves=int(sizes.size),
            smallest=smallest,
            median=median,
            largest=largest,
            interval=float(np.median(np.diff(moves.times))) if sizes.size > 1 else None,
            noise=pv_noise(record.y[:, i]),
            always=moves.always,
            message="",
        )
        rows.append(replace(found, message=moves_sentence(found, entry.sp or entry.name, study.project.time_unit)))
    return tuple(rows)


def _shares(names: tuple[str, ...], where: BoolArray) -> dict[str, float]:
    return {name: float(np.mean(column)) for name, column in zip(names, where.T, strict=True)}


def _finding(f: Finding, calendar: Calendar) -> DataFinding:
    spans = f.spans[: levels.MOST_SPANS]
    return DataFinding(f.kind, f.signal, f.message, f.samples, f.excludes, f.value, spans, _stamps(spans, calendar))


def _stamps(spans: Sequence[tuple[float, float]], calendar: Calendar) -> tuple[tuple[str, str], ...]:
    return tuple(stamps for span in spans if (stamps := calendar.stamps(span)) is not None)


def _excitation(study: Study, screened: Screened) -> Excitation:
    """How the set-points move (OP in open loop), a row a signal, and what is not enough."""
    setpoints = screened.record.closed and bool(np.isfinite(screened.segments[0].r).any())
    names = study.project.output_names if setpoints else study.project.input_names
    found = excitation(screened.segments, "r" if setpoints else "u", names)
    rows = zip(found.names, found.changes, found.std, found.bands, strict=True)
    return Excitation(
        of="set-points" if setpoints else "inputs",
        rank=found.rank,
        signals=tuple(SignalExcitation(name, int(changes), float(std), band) for name, changes, std, band in rows),
        worst_condition=float(np.max(found.condition)) if found.condition.size else None,
        sentences=tuple(found.sentences),
    )
