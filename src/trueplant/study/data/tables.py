"""What the result says of the data, and of where it comes from."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import BoolArray
from trueplant.record import Finding, Screened, excitation
from trueplant.result import (
    DataFinding,
    Excitation,
    Exclusion,
    ExperimentData,
    Provenance,
    Settings,
    SignalExcitation,
)
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
    findings = screened.findings
    return ExperimentData(
        name=record.name,
        loop="closed" if record.closed else "open",
        samples=int(record.t.size),
        sample_time=record.sample_time,
        start=record.start.isoformat() if record.start else None,
        span=(float(record.t[0]), float(record.t[-1])),
        used=tuple((float(s.t[0]), float(s.t[-1])) for s in screened.segments),
        usable_share=_shares(study.project.output_names, screened.usable_y),
        saturated_share=_shares(study.project.input_names, screened.saturated),
        excluded=tuple(Exclusion(a, b, f.signal, f.kind) for f in findings if f.excludes for a, b in f.spans),
        findings=tuple(map(_finding, findings)),
        refused=screened.refusal,
        excitation=_excitation(study, screened) if screened.segments else None,
    )


def _shares(names: tuple[str, ...], where: BoolArray) -> dict[str, float]:
    return {name: float(np.mean(column)) for name, column in zip(names, where.T, strict=True)}


def _finding(f: Finding) -> DataFinding:
    return DataFinding(f.kind, f.signal, f.message, f.samples, f.excludes, f.value, f.spans[: levels.MOST_SPANS])


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
