"""The estimators of the literature beside each other on the same records, on request."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import FormulaError, Refused, TrueplantError
from trueplant.identify import Held, Row, Spec, estimate_row, pieces_of
from trueplant.identify.instrumental import Order, PolynomialFit, clsrivc, rivc, srivc, state_variable_filter, two_stage
from trueplant.loop import Controller
from trueplant.lti import Structure, TransferFunction, TransferMatrix, structure_of
from trueplant.record import Segment
from trueplant.study.methods.black_box import second_opinion

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


@dataclass(frozen=True, eq=False)
class Task:
    """What the estimators work on, each row of elements by itself."""

    segments: Sequence[Segment]
    structures: Mapping[Place, Structure]
    controller: Controller | None = None
    model: TransferMatrix | None = None
    outputs: Sequence[str] = ()
    inputs: Sequence[str] = ()
    """Names for what is said; numbers where there are none."""

    @cached_property
    def rows(self) -> dict[int, list[int]]:
        """The columns of each output."""
        return {i: sorted(j for k, j in self.structures if k == i) for i in sorted({i for i, _ in self.structures})}

    @cached_property
    def held(self) -> dict[int, list[Held]]:
        """The elements of the model that are not asked for: they stay as they are."""
        if self.model is None:
            return {i: [] for i in self.rows}
        return {
            i: [
                Held(j, self.model[i, j])
                for j in range(self.model.shape[1])
                if (i, j) not in self.structures and not self.model[i, j].is_zero
            ]
            for i in self.rows
        }

    def orders(self, i: int) -> list[Order]:
        """Raises LoopError where a structure is not a single B/A e^(-theta s)."""
        return [Order.of(j, self.structures[i, j]) for j in self.rows[i]]

    def said(self, i: int, j: int | None = None) -> str:
        """An output, or an element."""
        output = self.outputs[i] if self.outputs else f"output {i + 1}"
        if j is None:
            return output
        return f"{self.inputs[j] if self.inputs else f'input {j + 1}'} -> {output}"

    @cached_property
    def initial(self) -> dict[int, Array | None]:
        """By output the coefficients from which the search of all estimators starts; None where none were found."""
        return {i: self._initial(i) for i in self.rows}

    def _initial(self, i: int) -> Array | None:
        """SRIVC's coefficients, from the model or from its own search, whichever costs less; None where both fail."""
        fits: list[PolynomialFit] = []
        try:
            orders = self.orders(i)
        except TrueplantError:
            return None  # each estimator will say why
        for guess in (None, _coefficients(orders, i, self.model)):
            if guess is not None or not fits:
                try:
                    fits.append(srivc(self.segments, i, orders, guess, self.held[i]))
                except (TrueplantError, np.linalg.LinAlgError):
                    continue
        return min(fits, key=lambda fit: fit.cost).theta if fits else None


@dataclass(frozen=True, eq=False)
class Answer:
    """What one estimator found, of what it found nothing and why, and what to know of it."""

    found: Found
    refused: str
    """Empty where every element was answered."""
    notes: tuple[str, ...] = ()
    biases: tuple[str, ...] = ()
    """Those of the notes that say where it is known to be biased, and so need not agree with the fit."""


def compare_estimators(
    segments: Sequence[Segment],
    structures: Mapping[Place, Structure],
    controller: Controller | None = None,
    model: TransferMatrix | None = None,
    methods: Sequence[str] = ESTIMATORS,
) -> EstimatorComparison:
    """Run the named estimators on the elements {(output, input): structure}, each row by itself.

    direct: the fit of `trueplant run` (prediction errors, autoregressive noise); the others are those of
    `identify.instrumental`. `model` is where the search begins, if given, and holds the elements that are not asked
    for; `controller` is needed by clsrivc alone. What does not apply, or comes out with poles of another kind than its
    structure has, says why. Where the records afford it each plant found is held against a black-box response of the
    same records. A project file asks for the same with `analysis.method`.

    Raises Refused where no method gives anything, FormulaError for a name that is not among ESTIMATORS.
    """
    unknown = [name for name in methods if name not in ESTIMATORS]
    if unknown:
        raise FormulaError(f"unknown estimator {unknown[0]!r}: use {', '.join(ESTIMATORS)}")
    task = Task(segments, structures, controller, model)
    answers = {name: estimate_by(name, task) for name in methods}
    refused = {name: answer.refused for name, answer in answers.items() if answer.refused}
    found = {name: answer.found for name, answer in answers.items() if answer.found}
    if not found:
        raise Refused("no estimator applies: " + "; ".join(f"{name}: {why}" for name, why in refused.items()))
    shape = segments[0].y.shape[1], segments[0].u.shape[1]
    opinion = second_opinion(segments, {name: plant_of(task, elements, shape) for name, elements in found.items()})
    if opinion.refused:
        refused["black box"] = opinion.refused
    notes = {name: answers[name].notes for name in found}
    return EstimatorComparison(dict(structures), found, refused, notes, opinion.p_values)


def estimate_by(name: str, task: Task) -> Answer:
    """One of ESTIMATORS on every row: what does not apply to a row, or an element, is refused there alone."""
    found: Found = {}
    refused: dict[str, str] = {}
    notes: dict[int, tuple[str, ...]] = {}
    biases: dict[int, str] = {}
    groups = [list(task.rows)] if name == "clsrivc" else [[i] for i in task.rows]
    for group in groups:
        try:
            if name == "direct":
                found |= _direct(task, group[0])
                continue
            fits = _fits(name, task, group)
        except (TrueplantError, np.linalg.LinAlgError) as error:
            refused |= dict.fromkeys((task.said(i) for i in group), str(error))
            continue
        for i, fit in fits.items():
            notes[i], biases[i] = fit.notes, fit.bias
            for k, order in enumerate(fit.orders):
                try:
                    found[i, order.column] = _in_structure(fit, k, task.structures[i, order.column])
                except FormulaError as error:
                    refused[task.said(i, order.column)] = str(error)
    alike = len(set(refused.values())) == 1 and not found
    why = next(iter(refused.values())) if alike else "; ".join(f"{where}: {text}" for where, text in refused.items())
    everywhere = [note for note in next(iter(notes.values()), ()) if all(note in of for of in notes.values())]
    here = {(i, note): f"{task.said(i)}: {note}" for i, of in notes.items() for note in of if note not in everywhere}
    biased = dict.fromkeys(here.get((i, bias), bias) for i, bias in biases.items() if bias)
    return Answer(found, why, (*everywhere, *here.values()), tuple(biased))


def plant_of(task: Task, found: Found, shape: tuple[int, int]) -> TransferMatrix:
    """The plant (n_y, n_u) with the elements found, and those that are held."""
    n_y, n_u = shape
    plant = [[TransferFunction()] * n_u for _ in range(n_y)]
    kept = {(i, element.column): element.system for i, row in task.held.items() for element in row}
    answered = {(i, j): task.structures[i, j].transfer(p) for (i, j), (p, _) in found.items()}
    for (i, j), system in (kept | answered).items():
        if j < n_u:
            plant[i][j] = system
    return TransferMatrix(tuple(tuple(row) for row in plant))


def _fits(name: str, task: Task, rows: Sequence[int]) -> dict[int, PolynomialFit]:
    """One of the polynomial estimators on some outputs, clsrivc on all."""
    segments, held = task.segments, task.held
    orders = {i: task.orders(i) for i in rows}
    if name == "clsrivc":
        if not any(segment.closed for segment in segments):
            raise Refused("these records are in open loop: clsrivc and srivc are the same there, use srivc")
        if task.controller is None:
            raise Refused("clsrivc drives its instrument through the controller: declare it, or use two-stage")
        if any(column >= task.controller.n_u for row in task.rows.values() for column in row):
            raise Refused("clsrivc knows no measured disturbances: use srivc or rivc")
        given = {i: start for i in rows if (start := task.initial[i]) is not None}
        return clsrivc(segments, orders, task.controller, given or None, held)
    estimators: Mapping[str, Callable[[int], PolynomialFit]] = {
        "srivc": lambda i: srivc(segments, i, orders[i], task.initial[i], held[i]),
        "rivc": lambda i: rivc(segments, i, orders[i], initial=task.initial[i], held=held[i]),
        "two-stage": lambda i: two_stage(segments, i, orders[i], task.initial[i], held[i]),
        "equation-error": lambda i: _equation_error(segments, i, orders[i], held[i]),
    }
    return {i: estimators[name](i) for i in rows}


def _in_structure(fit: PolynomialFit, k: int, structure: Structure) -> tuple[Array, Array]:
    value, covariance = fit.as_structure(structure, k)
    if fit.orders[k].keeps_dead_time and structure.has_dead_time:
        covariance[-1, :] = covariance[:, -1] = np.nan  # found on a grid: its error is not known
    return value, covariance


def _equation_error(
    segments: Sequence[Segment], output: int, orders: Sequence[Order], held: Sequence[Held]
) -> PolynomialFit:
    if len(orders) > 1:
        raise Refused("the equation error has one denominator: it is for outputs with one input")
    return state_variable_filter(segments, output, orders[0], held=held)


def _coefficients(orders: Sequence[Order], output: int, model: TransferMatrix | None) -> Array | None:
    """The model's, where it has all of these elements in these orders."""
    if model is None:
        return None
    parts = [
        order.coefficients(model[output, order.column]) if order.column < model.shape[1] else None for order in orders
    ]
    return None if any(part is None for part in parts) else np.concatenate([p for p in parts if p is not None])


def _direct(task: Task, i: int) -> Found:
    columns = task.rows[i]
    specs = tuple(Spec(j, task.structures[i, j], _parameters(task, i, j)) for j in columns)
    row = Row(specs, pieces_of(task.segments, i, task.held[i]))
    if not row.pieces:
        raise Refused(f"output {i + 1} was not measured in any segment: see what screening left out, and why")
    fit = estimate_row(row, row.guessed_time_scale)
    return {(i, j): (fit.theta[part], fit.covariance[part, part]) for j, part in zip(columns, row.slices, strict=True)}


def _parameters(task: Task, i: int, j: int) -> tuple[float, ...] | None:
    if task.model is None or j >= task.model.shape[1]:
        return None
    try:
        kind, value = structure_of(task.model[i, j])
    except FormulaError:
        return None
    return tuple(float(x) for x in value) if kind == task.structures[i, j] else None
