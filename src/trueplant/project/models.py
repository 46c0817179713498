"""The declared model, element by element, as transfer functions in engineering units, whatever it was written as."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import FormulaError, ProjectError, UsageError
from trueplant.lti import MeasuredStep, Structure, TransferFunction, require_proper, tf
from trueplant.lti.structure import structure_of
from trueplant.mismatch.steps import fit_step
from trueplant.project import levels
from trueplant.project.declaration import Declaration
from trueplant.project.fields import require_reason
from trueplant.project.messages import Where, line_of, path
from trueplant.project.model_table import ModelElement
from trueplant.project.step_files import checked_step, chosen_column, element_name, step_of
from trueplant.project.system_files import read_system
from trueplant.record.readers import read_table


@dataclass(frozen=True, eq=False)
class DeclaredModel:
    """One element of the model, in output units per input unit."""

    system: TransferFunction
    source: str = ""
    """Where it comes from, in words; empty for a formula."""
    file: str = ""
    """As the project names it, and ..."""
    sha256: str = ""
    """... what was read of it."""
    measured: MeasuredStep | None = None
    """Its coefficients, where it was given as such; `system` was fitted to them."""
    error: float = 0.0
    """Largest difference of the step response of `system`, as a share of the gain."""
    at: float = 0.0
    """When that is, in the project's time unit."""
    covariance: Array | None = None
    """(n_p, n_p) of the parameters that `structure_of` finds in `system`, by the scatter of the coefficients."""


class ModelFiles:
    """The files of a project's model, each read once."""

    def __init__(self, project: Declaration) -> None:
        self.project = project
        self.table = cache(lambda name: read_table(project.folder / name, fewest=1))
        self.system = cache(lambda name: read_system(project.folder / name, project.time_unit))

    def element(self, entry: ModelElement) -> DeclaredModel:
        """What one entry declares. Raises UsageError."""
        factor = span_factor(self.project, entry)
        if entry.tf is not None:
            return DeclaredModel(tf(entry.tf) * factor if factor != 1.0 else tf(entry.tf))
        given, source, sha256 = self._step(entry) if entry.step is not None else self._system(entry)
        if isinstance(given, TransferFunction):
            model = DeclaredModel(given * factor, source, entry.file or "", sha256)
        else:
            wanted = None if entry.structure in (None, "auto") else Structure.parse(entry.structure)
            fitted = fit_step(given * factor, wanted)
            found = fitted.error, fitted.at, fitted.covariance
            model = DeclaredModel(fitted.system, source, entry.file or "", sha256, given * factor, *found)
        _check(entry, model)
        return model

    def _step(self, entry: ModelElement) -> tuple[MeasuredStep, str, str]:
        if isinstance(entry.step, list):
            assert entry.sample_time is not None  # checked with the table
            coefficients = np.array(entry.step, dtype=float)
            return checked_step(coefficients, entry.sample_time, entry.kind, entry.ramp), "in the project", ""
        table = self.table(entry.step)
        column = chosen_column(table, entry.column, entry.time, element_name(entry.output, entry.input))
        step = step_of(table, column, entry.sample_time or entry.time or "", kind=entry.kind, ramp=entry.ramp)
        return step, f"{entry.step}, column {column}", table.sha256

    def _system(self, entry: ModelElement) -> tuple[TransferFunction | MeasuredStep, str, str]:
        assert entry.state_space is not None
        system = self.system(entry.state_space)
        sources = (*self.project.input_names, *self.project.disturbance_names)
        element = system.element(entry.output, entry.input, self.project.output_names, sources)
        return element, entry.state_space, system.sha256


def declared_models(
    project: Declaration, where: Where, entries: Sequence[ModelElement], text: str
) -> Mapping[tuple[str, str], DeclaredModel]:
    """The entries of the table ``where`` that declare something, by (output, input).

    The `text` of the project tells their lines.
    Raises ProjectError (file, line, key, what to do).
    """
    files, found = ModelFiles(project), {}
    for k, entry in enumerate(entries):
        if entry.wanted:
            continue
        try:
            found[entry.output, entry.input] = files.element(entry)
        except UsageError as error:
            key = (*where, k, "step" if entry.step is not None else "state_space")
            line = line_of(key, text)
            place = f"{project.source}, line {line}" if line else project.source
            raise ProjectError(f"{place}: {path(key)}: {error}") from None
    return found


def _check(entry: ModelElement, model: DeclaredModel) -> None:
    """What a formula was checked for when it was read."""
    if model.error > levels.WORST_CONVERSION:
        raise FormulaError(
            f"no transfer function stands for {model.source}: the nearest ({model.system}) is off by "
            f"{100 * model.error:.0f} % of the gain at {model.at:g}. Check the coefficients, their sample time and "
            "kind, or smooth them"
        )
    require_proper(model.system, model.source)
    require_reason(model.system)
    if not entry.estimate or entry.structure not in (None, "auto") or model.system.is_zero:
        return
    try:
        structure_of(model.system)
    except FormulaError as error:
        raise FormulaError(
            f"{error}; name the structure of the plant's element (structure = ...) or set estimate = false"
        ) from None


def span_factor(project: Declaration, entry: ModelElement) -> float:
    """What gains are multiplied by to be in engineering units."""
    if entry.gain_unit == "engineering":
        return 1.0
    outputs = {one.name: one.span for one in project.outputs}
    inputs = {one.name: one.span for one in project.inputs}
    # that both have one is checked with the project
    (low_y, high_y), (low_u, high_u) = outputs[entry.output] or (0.0, 1.0), inputs[entry.input] or (0.0, 1.0)
    return (high_y - low_y) / (high_u - low_u)
