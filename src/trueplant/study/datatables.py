"""The tables of a result that describe data, fit and provenance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trueplant.identify import OutputEstimate, fit_percent, pieces_of, simulate_piece
from trueplant.lti import TransferMatrix

if TYPE_CHECKING:
    from trueplant.record import Screened
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]


def provenance(study: Study) -> dict[str, Any]:
    """Where the result comes from, enough to make it again."""
    from trueplant import __version__

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
    from trueplant.record import excitation

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


def fit_rows(
    study: Study, estimates: Mapping[int, OutputEstimate], plant: TransferMatrix
) -> tuple[dict[str, Any], ...]:
    """One row for each output and experiment: how model and plant simulate it, and the tests on the residuals."""
    rows = []
    for i, name in enumerate(study.project.output_names):
        tests = _tests(study, estimates[i]) if i in estimates else {}
        for k, screened in enumerate(study.screened):
            if screened.refusal is not None:
                continue
            pieces = pieces_of(screened.segments, i)
            if not pieces:
                continue
            measured = np.concatenate([np.where(p.valid, p.y, np.nan) for p in pieces])
            row: dict[str, Any] = {"output": name, "experiment": study.project.experiments[k].name}
            for label, matrix in (("model", study.model), ("plant", plant)):
                simulated = np.concatenate([simulate_row(matrix, i, p) for p in pieces])
                row[f"fit_percent_{label}"] = fit_percent(measured, simulated)
            rows.append(row | tests)
    return tuple(rows)


def simulate_row(matrix: TransferMatrix, i: int, piece: Any) -> Array:
    """Output i of a piece simulated by a row of a matrix on the recorded inputs, offset and initial state fitted."""
    systems = [(j, matrix[i, j]) for j in range(matrix.shape[1]) if not matrix[i, j].is_zero]
    lags = [-1 / pole.real for _, system in systems for pole in system.poles if pole.real < 0]
    return simulate_piece(piece, systems, lags)


def _tests(study: Study, estimate: OutputEstimate) -> dict[str, Any]:
    validation = estimate.validation
    return {
        "validation": None
        if validation is None
        else {
            "kind": validation.kind,
            "fit_percent": validation.fit_percent,
            "fit_percent_same_data": validation.fit_percent_same_data,
        },
        "residual_tests": {
            "whiteness_p": estimate.tests.whiteness_p,
            "input_p": {name: float(p) for name, p in zip(study.columns, estimate.tests.cross_p, strict=True)},
            "noise_model_order": int(estimate.fit.ar.size),
            "prediction_error": float(np.sqrt(estimate.fit.variance)),
            "samples_per_error": estimate.row.stride,
        },
    }
