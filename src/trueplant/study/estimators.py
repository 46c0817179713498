"""The estimators of the literature beside each other on the same records, on request."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from trueplant.errors import FormulaError, Refused, TrueplantError
from trueplant.identify import Row, Spec, estimate_row, pieces_of
from trueplant.identify.instrumental import Order, PolynomialFit, clsrivc, rivc, srivc, state_variable_filter, two_stage
from trueplant.identify.varx import varx
from trueplant.loop import Controller
from trueplant.lti import Structure, TransferFunction, TransferMatrix
from trueplant.record import Segment

Array = NDArray[np.float64]
Place = tuple[int, int]
Found = dict[Place, tuple[Array, Array]]
"""Parameters of each element and their covariance."""

ESTIMATORS = ("direct", "equation-error", "srivc", "rivc", "clsrivc", "two-stage")


@dataclass(frozen=True, eq=False)
class EstimatorComparison:
    """What each estimator makes of the same records."""

    structures: Mapping[Place, Structure]
    found: Mapping[str, Found]
    """By method and (output, input): parameters in the order of the structure's names, and their covariance."""
    not_applied: Mapping[str, str]
    """Why a method gave nothing."""
    notes: Mapping[str, tuple[str, ...]]
    """What to know of each."""
    black_box: Mapping[str, Array]
    """By method: p-values (n_y, n_u) of its plant against the black-box response (`identify.varx`), if there is one."""

    def elements(self, outputs: Sequence[str], inputs: Sequence[str], confidence: float = 0.95) -> dict[str, Any]:
        """{method: elements} as result.json lists methods."""
        z = float(norm.ppf(0.5 + confidence / 2))
        listed: dict[str, Any] = {}
        for method, found in self.found.items():
            rows = []
            for (i, j), (p, covariance) in sorted(found.items()):
                parameters = [
                    _listed(name, float(value), float(error), z)
                    for name, value, error in zip(self.structures[i, j].names, p, _errors(covariance), strict=True)
                ]
                rows.append({"output": outputs[i], "input": inputs[j], "parameters": parameters})
            listed[method] = rows
        return listed

    def __str__(self) -> str:
        lines = []
        for (i, j), structure in sorted(self.structures.items()):
            lines.append(f"input {j + 1} -> output {i + 1}")
            for k, name in enumerate(structure.names):
                values = [
                    f"{method} {found[i, j][0][k]:.4g}{_plus_minus(_errors(found[i, j][1])[k])}"
                    for method, found in self.found.items()
                    if (i, j) in found
                ]
                lines.append(f"  {name}: " + ", ".join(values))
        return "\n".join([*lines, *(f"{method}: {why}" for method, why in self.not_applied.items())])


def _errors(covariance: Array) -> Array:
    """Standard errors; NaN where the method gives none."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _plus_minus(error: float) -> str:
    return f" ± {error:.2g}" if np.isfinite(error) else " (error unknown)"


def _listed(name: str, value: float, error: float, z: float) -> dict[str, Any]:
    known = np.isfinite(error)
    interval = (value - z * error, value + z * error) if known else None
    return {"name": name, "plant": value, "std_error": error if known else None, "ci": interval}


def compare_estimators(
    segments: Sequence[Segment],
    structures: Mapping[Place, Structure],
    controller: Controller | None = None,
    model: TransferMatrix | None = None,
    methods: Sequence[str] = ESTIMATORS,
) -> EstimatorComparison:
    """Run the named estimators on the elements {(output, input): structure}, each row by itself.

    direct: the fit of `trueplant run` (prediction errors, autoregressive noise); the others are those of
    `identify.instrumental`. `model` is where the search begins, if given; `controller` is needed by clsrivc alone. What
    does not apply, or comes out with poles of another kind than its structure has, says why. Where the records afford
    it each plant found is held against a black-box response of the same records.

    Raises Refused where no method gives anything, FormulaError for a name that is not among ESTIMATORS.
    """
    unknown = [name for name in methods if name not in ESTIMATORS]
    if unknown:
        raise FormulaError(f"unknown estimator {unknown[0]!r}: use {', '.join(ESTIMATORS)}")
    found: dict[str, Found] = {}
    refused: dict[str, str] = {}
    notes: dict[str, tuple[str, ...]] = {}
    rows = {i: sorted(j for k, j in structures if k == i) for i in sorted({i for i, _ in structures})}
    orders = {i: [Order.of(j, structures[i, j]) for j in columns] for i, columns in rows.items()}
    iterative = set(methods) - {"direct", "equation-error"}
    starts = {i: _start(segments, i, orders[i], model) for i in rows} if iterative else {}
    for name in methods:
        try:
            if name == "direct":
                found[name], notes[name] = _direct(segments, structures, rows, model), ()
                continue
            fits = _fits(name, segments, orders, starts, controller)
            found[name] = _in_structures(fits, structures)
            notes[name] = tuple(dict.fromkeys(note for fit in fits.values() for note in fit.notes))
        except (TrueplantError, np.linalg.LinAlgError) as error:
            refused[name] = str(error)
    if not found:
        raise Refused("no estimator applies: " + "; ".join(f"{name}: {why}" for name, why in refused.items()))
    try:
        tests = _black_box(segments, structures, found)
    except TrueplantError as error:
        tests = {}
        refused["black box"] = str(error)
    return EstimatorComparison(dict(structures), found, refused, notes, tests)


def _fits(
    name: str,
    segments: Sequence[Segment],
    orders: Mapping[int, Sequence[Order]],
    starts: Mapping[int, Array | None],
    controller: Controller | None,
) -> dict[int, PolynomialFit]:
    """One of the polynomial estimators on every output."""
    if name == "clsrivc":
        if controller is None:
            raise Refused("clsrivc drives its instrument through the controller: declare it, or use two-stage")
        if any(order.column >= controller.n_u for row in orders.values() for order in row):
            raise Refused("clsrivc knows no measured disturbances: use srivc or rivc")
        given = {i: start for i, start in starts.items() if start is not None}
        return clsrivc(segments, orders, controller, given or None)
    estimators: Mapping[str, Callable[[int], PolynomialFit]] = {
        "srivc": lambda i: srivc(segments, i, orders[i], starts[i]),
        "rivc": lambda i: rivc(segments, i, orders[i], start=starts[i]),
        "two-stage": lambda i: two_stage(segments, i, orders[i], starts[i]),
        "equation-error": lambda i: _equation_error(segments, i, orders[i]),
    }
    return {i: estimators[name](i) for i in orders}


def _in_structures(fits: Mapping[int, PolynomialFit], structures: Mapping[Place, Structure]) -> Found:
    found: Found = {}
    for i, fit in fits.items():
        for k, order in enumerate(fit.orders):
            structure = structures[i, order.column]
            value, covariance = fit.as_structure(structure, k)
            if order.keeps_dead_time and structure.has_dead_time:
                covariance[-1, :] = covariance[:, -1] = np.nan  # found on a grid: its error is not known
            found[i, order.column] = value, covariance
    return found


def _equation_error(segments: Sequence[Segment], output: int, orders: Sequence[Order]) -> PolynomialFit:
    if len(orders) > 1:
        raise Refused("the equation error has one denominator: it is for outputs with one input")
    return state_variable_filter(segments, output, orders[0])


def _start(
    segments: Sequence[Segment], output: int, orders: Sequence[Order], model: TransferMatrix | None
) -> Array | None:
    """SRIVC's coefficients, from the model or from its own search, whichever costs less; None where both fail."""
    fits: list[PolynomialFit] = []
    for start in (None, _coefficients(orders, output, model)):
        if start is not None or not fits:
            try:
                fits.append(srivc(segments, output, orders, start))
            except (TrueplantError, np.linalg.LinAlgError):
                continue
    return min(fits, key=lambda fit: fit.cost).theta if fits else None


def _coefficients(orders: Sequence[Order], output: int, model: TransferMatrix | None) -> Array | None:
    """The model's, where it has all of these elements in these orders."""
    if model is None:
        return None
    parts = [
        order.coefficients(model[output, order.column]) if order.column < model.shape[1] else None for order in orders
    ]
    return None if any(part is None for part in parts) else np.concatenate([p for p in parts if p is not None])


def _direct(
    segments: Sequence[Segment],
    structures: Mapping[Place, Structure],
    rows: Mapping[int, Sequence[int]],
    model: TransferMatrix | None,
) -> Found:
    found: Found = {}
    for i, columns in rows.items():
        starts = [_parameters(structures[i, j], model, i, j) for j in columns]
        specs = tuple(Spec(j, structures[i, j], start) for j, start in zip(columns, starts, strict=True))
        row = Row(specs, pieces_of(segments, i))
        if not row.pieces:
            raise Refused(f"output {i + 1} was not measured in any segment: see what screening left out, and why")
        fit = estimate_row(row, max(piece.span for piece in row.pieces) / 20)
        for j, part in zip(columns, row.slices, strict=True):
            found[i, j] = fit.theta[part], fit.covariance[part, part]
    return found


def _parameters(structure: Structure, model: TransferMatrix | None, i: int, j: int) -> tuple[float, ...] | None:
    from trueplant.lti import structure_of

    if model is None or j >= model.shape[1]:
        return None
    try:
        kind, value = structure_of(model[i, j])
    except FormulaError:
        return None
    return tuple(float(x) for x in value) if kind == structure else None


def _black_box(
    segments: Sequence[Segment], structures: Mapping[Place, Structure], found: Mapping[str, Found]
) -> dict[str, Array]:
    n_y, n_u = segments[0].y.shape[1], segments[0].u.shape[1]
    response = varx(segments)
    tests = {}
    for name, elements in found.items():
        plant = [[TransferFunction()] * n_u for _ in range(n_y)]
        for (i, j), (p, _) in elements.items():
            if j < n_u:
                plant[i][j] = structures[i, j].transfer(p)
        tests[name] = response.test(TransferMatrix(tuple(tuple(row) for row in plant)), segments[0].hold)[0]
    return tests
