"""How model and plant simulate the records, and the tests on what the plant leaves."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import RESIDUAL_TESTS, OutputEstimate, fit_percent, pieces_of, simulate_piece
from trueplant.identify.pieces import Piece
from trueplant.lti import TransferMatrix
from trueplant.result import FitRow, ResidualTest, ValidationFit
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


def fit_rows(study: Study, found: Identified, plant: TransferMatrix) -> tuple[FitRow, ...]:
    """One row for each output and experiment: how model and plant simulate it, and the tests on the residuals."""
    rows = []
    for i, name in enumerate(study.project.output_names):
        estimate = found.estimates.get(i)
        for k, screened in enumerate(study.screened):
            pieces = pieces_of(found.of_experiment(k), i) if screened.refusal is None else ()
            if not pieces:
                continue
            measured = np.concatenate([np.where(p.valid, p.y, np.nan) for p in pieces])
            by_model, by_plant = (
                fit_percent(measured, np.concatenate([simulate_row(matrix, i, p) for p in pieces]))
                for matrix in (study.model, plant)
            )
            rows.append(
                FitRow(
                    output=name,
                    experiment=study.project.experiments[k].name,
                    fit_percent_model=by_model if study.modelled[i].any() else np.nan,
                    fit_percent_plant=by_plant,
                    validation=None if estimate is None else _validation(estimate),
                    residual_tests=None if estimate is None else _residual_test(study, estimate),
                )
            )
    return tuple(rows)


def simulate_row(matrix: TransferMatrix, i: int, piece: Piece) -> Array:
    """Output i of a piece simulated by a row of a matrix on the recorded inputs, offset and initial state fitted."""
    systems = [(j, matrix[i, j]) for j in range(matrix.shape[1]) if not matrix[i, j].is_zero]
    lags = [-1 / pole.real for _, system in systems for pole in system.poles if pole.real < 0]
    return simulate_piece(piece, systems, lags)


def _validation(estimate: OutputEstimate) -> ValidationFit | None:
    found = estimate.validation
    return None if found is None else ValidationFit(found.kind, found.fit_percent, found.fit_percent_same_data)


def _residual_test(study: Study, estimate: OutputEstimate) -> ResidualTest:
    return ResidualTest(
        whiteness_p=estimate.tests.whiteness_p,
        input_p={name: float(p) for name, p in zip(study.columns, estimate.tests.cross_p, strict=True)},
        noise_model_order=int(estimate.fit.ar.size),
        prediction_error=float(np.sqrt(estimate.fit.variance)),
        samples_per_error=estimate.row.stride,
        further_p={name: test(estimate.fit) for name, test in RESIDUAL_TESTS.items()},
    )
