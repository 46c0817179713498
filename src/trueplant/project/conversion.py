"""A model in another form: transfer functions, step coefficients or impulse responses, with what that costs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from trueplant.arrays import Array
from trueplant.errors import UsageError
from trueplant.lti import (
    MeasuredStep,
    Structure,
    TransferFunction,
    largest_difference,
    sampled_response,
    tf,
    to_formula,
)
from trueplant.lti.measured import Kind
from trueplant.mismatch.steps import fit_step
from trueplant.project import levels
from trueplant.project.document import to_toml
from trueplant.project.project import Project
from trueplant.project.step_files import element_name, step_of
from trueplant.project.system_files import read_system
from trueplant.record.readers import read_table

TIMES = ("t", "time")
"""Columns of times in a file of coefficients, in lower case."""
ARROW = element_name("", "")


@dataclass(frozen=True, eq=False)
class Element:
    """One element, as it was given."""

    output: str
    input: str
    given: TransferFunction | MeasuredStep


@dataclass(frozen=True, eq=False)
class Model:
    """All elements of a model that are not zero; times in `time_unit`, empty where nobody said one."""

    elements: tuple[Element, ...]
    time_unit: str
    files: tuple[Path, ...]
    """What was read."""


@dataclass(frozen=True)
class Cost:
    """What the conversion of one element changed: a share of the gain, and when."""

    output: str
    input: str
    error: float
    at: float
    integrating: bool


@dataclass(frozen=True)
class Coefficients:
    """How a file of coefficients is read. `sample_time` is needed where it has no column of times."""

    kind: Kind = "step"
    sample_time: float | None = None
    ramps: Collection[str] = ()
    """Columns that integrate."""


def read_model(path: Path, said: Coefficients) -> Model:
    """The model of a project file, a JSON file of a whole model, or a table of coefficients (CSV, Parquet, XLSX).

    Raises UsageError (file, place, what to do).
    """
    if path.suffix.lower() == ".toml":
        project = Project.load(path)
        found = [
            Element(y, u, one.system if one.measured is None else one.measured)
            for (y, u), one in project.models.items()
        ]
        return _model(path, found, project.time_unit, project.files)
    if path.suffix.lower() == ".json":
        system = read_system(path)
        outputs = system.outputs or tuple(f"y{i + 1}" for i in range(len(system.elements)))
        inputs = system.inputs or tuple(f"u{j + 1}" for j in range(len(system.elements[0])))
        found = [
            Element(y, u, one)
            for y, row in zip(outputs, system.elements, strict=True)
            for u, one in zip(inputs, row, strict=True)
        ]
        return _model(path, found, system.time_unit, (path,))
    return _model(path, list(_columns(path, said)), "", (path,))


def _model(path: Path, elements: Sequence[Element], time_unit: str, files: Sequence[Path]) -> Model:
    there = tuple(
        e for e in elements if (e.given.size > 0 if isinstance(e.given, MeasuredStep) else not e.given.is_zero)
    )
    if not there:
        raise UsageError(f"{path} has no model element other than zero: nothing can be converted")
    return Model(there, time_unit, tuple(files))


def _columns(path: Path, said: Coefficients) -> Iterator[Element]:
    table = read_table(path, fewest=1)
    time = next((name for name in table.names if name.lower() in TIMES), None)
    times = time or said.sample_time
    if times is None:
        raise UsageError(f"{path} has no column of times (t): say the time between coefficients with --sample-time")
    unknown = [name for name in said.ramps if name not in table.names]
    if unknown:
        table.column(unknown[0])
    for name in table.names:
        if name != time:
            source, arrow, output = name.partition(ARROW)
            step = step_of(table, name, times, said.kind, name in said.ramps)
            yield Element(output, source, step) if arrow else Element(name, "input", step)


# -- to transfer functions -------------------------------------------------------------------------------------


def as_formulas(model: Model, structure: str | None = None) -> tuple[str, tuple[Cost, ...]]:
    """[[model]] entries as TOML, and what each cost; coefficients are fitted by `structure`, else by what suffices."""
    wanted = None if structure is None else Structure.parse(structure)
    entries, costs = [], []
    for one in model.elements:
        fitted = _fitted(one.given, wanted) if isinstance(one.given, MeasuredStep) else one.given
        formula = to_formula(fitted)
        entries.append({"output": one.output, "input": one.input, "tf": formula})
        # what was written counts, with its digits
        error = largest_difference(one.given, tf(formula)) if isinstance(one.given, MeasuredStep) else (0.0, 0.0)
        costs.append(Cost(one.output, one.input, *error, bool(np.isinf(fitted.dc_gain))))
    unit = f"# times in {model.time_unit}\n" if model.time_unit else ""
    return unit + to_toml({"model": entries}), tuple(costs)


def _fitted(given: MeasuredStep, wanted: Structure | None) -> TransferFunction:
    """The transfer function that comes nearest; a dead time that is nothing beside the sample time is left out."""
    system = fit_step(given, wanted).system
    least = levels.EVEN * given.sample_time
    return TransferFunction(tuple(t if t.dead_time > least else replace(t, dead_time=0.0) for t in system.terms))


# -- to coefficients -------------------------------------------------------------------------------------------


def as_coefficients(
    model: Model, kind: Kind, sample_time: float | None = None
) -> tuple[pl.DataFrame, tuple[Cost, ...]]:
    """A column of times from the step on and one for each element, and what each cost."""
    h = sample_time or _sample_time(model)
    count = _count(model, h)
    if 2 * levels.FINE * count > levels.MOST_SAMPLES:
        raise UsageError(f"{count:,} coefficients an element are too many: say a longer --sample-time")
    columns, costs = {"t": h * np.arange(count + 1)}, []
    for one in model.elements:
        step = _sampled(one.given, h, count)
        columns[element_name(one.output, one.input)] = step.values if kind == "step" else step.fir
        costs.append(Cost(one.output, one.input, *_apart(one.given, step), step.integrating))
    return pl.DataFrame(columns), tuple(costs)


def _sample_time(model: Model) -> float:
    """That of coefficients that were given; else one at which they come close to the model, if not too many have to."""
    own = [one.given.sample_time for one in model.elements if isinstance(one.given, MeasuredStep)]
    if own:
        return min(own)
    h = _round(max(step_span(one.given) for one in model.elements) / levels.COEFFICIENTS)
    while not _close(model, h) and _count(model, _round(h / 2)) <= levels.MOST_COEFFICIENTS:
        h = _round(h / 2)
    return h


def _count(model: Model, h: float) -> int:
    """Coefficients in which the slowest element settles."""
    longest = max(step_span(one.given) for one in model.elements)
    return max(int(np.ceil(longest / h - levels.EVEN)), levels.FEWEST_COEFFICIENTS)


def _close(model: Model, h: float) -> bool:
    steps = [(one.given, _sampled(one.given, h, _count(model, h))) for one in model.elements]
    return all(_apart(given, step)[0] <= levels.CLOSE_CONVERSION for given, step in steps)


def step_span(given: TransferFunction | MeasuredStep) -> float:
    """How long a step response takes; of an integrator, how long its lags and dead time do."""
    if isinstance(given, MeasuredStep):
        return float(given.t[-1])
    slow = max((-1 / p.real for p in given.poles if p.real < 0), default=0.0)
    late = max(term.dead_time for term in given.terms)
    return float(levels.SETTLED_TIMES * slow + late) or 1.0


def _round(x: float) -> float:
    """The next of 1, 2, 5, 10, ... below."""
    decade = 10.0 ** np.floor(np.log10(x))
    return float(max(m * decade for m in (1, 2, 5) if m * decade <= x * (1 + levels.EVEN)))


def _sampled(given: TransferFunction | MeasuredStep, h: float, count: int) -> MeasuredStep:
    if isinstance(given, TransferFunction):
        if any(p.real > 0 for p in given.poles):
            raise UsageError(f"{given} is unstable: its step response has no end")
        return MeasuredStep.of_system(given, h, count)
    return MeasuredStep(given(h * np.arange(count + 1)), h, given.integrating)


def _apart(given: TransferFunction | MeasuredStep, step: MeasuredStep) -> tuple[float, float]:
    """Largest difference of the response as given from straight lines between the coefficients, and where they end."""
    t = step.sample_time / levels.FINE * np.arange(2 * levels.FINE * step.values.size)
    if isinstance(given, TransferFunction):
        exact: Array = sampled_response(given, np.ones(t.size), step.sample_time / levels.FINE)
    else:
        exact = given(t)
    if step.integrating:
        t, exact = t[: t.size // 2], exact[: t.size // 2]
    apart = np.abs(exact - step(t))
    worst = int(np.argmax(apart))
    return float(apart[worst] / step.size) if step.size else 0.0, float(t[worst])
