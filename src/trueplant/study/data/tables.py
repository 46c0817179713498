"""The tables of a result that describe the data and where it comes from."""

from __future__ import annotations

from typing import Any

import numpy as np

from trueplant.record import Screened, excitation
from trueplant.study.study import Study


def provenance(study: Study) -> dict[str, Any]:
    """Where the result comes from, enough to make it again."""
    from trueplant.version import __version__

    settings = study.project.analysis
    return {
        "version": __version__,
        "project": study.project.source,
        "project_sha256": study.project.sha256,
        "data_sha256": {s.record.name: s.record.sha256 for s in study.screened},
        "time_spans": {s.record.name: [float(s.record.t[0]), float(s.record.t[-1])] for s in study.screened},
        "time_unit": study.project.time_unit,
        "seed": settings.seed,
        "settings": {
            "method": settings.method,
            "confidence": settings.confidence,
            "tolerance_percent": settings.tolerance_percent,
        },
    }


def data_tables(study: Study) -> tuple[dict[str, Any], ...]:
    """One table an experiment: what was read, what is used, what was found."""
    return tuple(_table(study, k, s) for k, s in enumerate(study.screened))


def _table(study: Study, k: int, screened: Screened) -> dict[str, Any]:
    record = screened.record
    findings = [*record.notes, *screened.findings]
    table: dict[str, Any] = {
        "name": record.name,
        "loop": "closed" if record.closed else "open",
        "samples": int(record.t.size),
        "sample_time": record.sample_time,
        "start": record.start.isoformat() if record.start else None,
        "span": [float(record.t[0]), float(record.t[-1])],
        "used": [[float(s.t[0]), float(s.t[-1])] for s in screened.segments],
        "usable_share": {
            name: float(np.mean(screened.usable_y[:, i])) for i, name in enumerate(study.project.output_names)
        },
        "saturated_share": {
            name: float(np.mean(screened.saturated[:, j])) for j, name in enumerate(study.project.input_names)
        },
        "excluded": [
            {"from": a, "to": b, "signal": f.signal, "reason": f.kind}
            for f in findings
            if f.excludes
            for a, b in f.spans
        ],
        "findings": [
            {
                "kind": f.kind,
                "signal": f.signal,
                "message": f.message,
                "samples": f.samples,
                "excludes": f.excludes,
                "value": f.value,
                "spans": [list(span) for span in f.spans[:20]],
            }
            for f in findings
        ],
        "refused": screened.refusal,
    }
    if screened.segments:
        table["excitation"] = _excitation(study, screened)
    return table


def _excitation(study: Study, screened: Screened) -> dict[str, Any]:
    """How the set-points move (OP in open loop), a row a signal, and what is not enough."""
    setpoints = screened.record.closed and bool(np.isfinite(screened.segments[0].r).any())
    names = study.project.output_names if setpoints else study.project.input_names
    found = excitation(screened.segments, "r" if setpoints else "u", names)
    rows = zip(found.names, found.changes, found.std, found.bands, strict=True)
    return {
        "of": "set-points" if setpoints else "inputs",
        "rank": found.rank,
        "signals": [
            {"signal": name, "changes": int(changes), "std": float(std), "band": band}
            for name, changes, std, band in rows
        ],
        "worst_condition": float(np.max(found.condition)) if found.condition.size else None,
        "sentences": list(found.sentences),
    }
