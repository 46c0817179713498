"""How model and plant simulate the records, and the tests on what the plant leaves."""

from __future__ import annotations

from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import OutputEstimate, fit_percent, pieces_of, simulate_piece
from trueplant.lti import TransferMatrix
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


def fit_rows(study: Study, found: Identified, plant: TransferMatrix) -> tuple[dict[str, Any], ...]:
    """One row for each output and experiment: how model and plant simulate it, and the tests on the residuals."""
    rows = []
    for i, name in enumerate(study.project.output_names):
        tests = _tests(study, found.estimates[i]) if i in found.estimates else {}
        for k, screened in enumerate(study.screened):
            if screened.refusal is not None:
                continue
            pieces = pieces_of(found.of_experiment(k), i)
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
