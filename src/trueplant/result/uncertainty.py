"""What is known of the plant's parameters together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.lti import KnownRow, Structure, TransferFunction, TransferMatrix, UncertainPlant, tf, to_formula


@dataclass(frozen=True)
class UncertainParameter:
    """One parameter of one element of an output."""

    input: str
    name: str
    value: float
    unknown: bool
    """True where the data do not answer it: its variance is then not known, and given as 0."""


@dataclass(frozen=True)
class UncertainRow:
    """The parameters of one output that were estimated together."""

    output: str
    structures: Mapping[str, str]
    """By input."""
    parameters: tuple[UncertainParameter, ...]
    covariance: tuple[tuple[float, ...], ...]
    """In the order of the parameters."""


@dataclass(frozen=True)
class HeldElement:
    """An element that is taken as the model has it, as if certain."""

    output: str
    input: str
    tf: str


@dataclass(frozen=True)
class Uncertainty:
    """The plant as estimated, with what is uncertain of it; outputs are independent of each other."""

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    """The inputs, then the measured disturbances."""
    rows: tuple[UncertainRow, ...]
    held: tuple[HeldElement, ...]

    @classmethod
    def of(cls, plant: UncertainPlant, outputs: tuple[str, ...], inputs: tuple[str, ...]) -> Uncertainty:
        """What is to be written of a plant, whose rows and columns have these names."""
        estimated = {(i, j) for i, row in plant.rows.items() for j in row.columns}
        places = ((i, j) for i in range(len(outputs)) for j in range(len(inputs)) if (i, j) not in estimated)
        held = (HeldElement(outputs[i], inputs[j], to_formula(plant.nominal[i, j], 17)) for i, j in places)
        rows = (_row(outputs[i], inputs, row) for i, row in sorted(plant.rows.items()))
        return cls(outputs, inputs, tuple(rows), tuple(one for one in held if one.tf != "0"))

    def plant(self, time_unit: str) -> UncertainPlant:
        """The plant again, (n_y, n_u + n_d), to calculate with."""
        elements = [[TransferFunction()] * len(self.inputs) for _ in self.outputs]
        for held in self.held:
            elements[self.outputs.index(held.output)][self.inputs.index(held.input)] = tf(held.tf)
        rows = {}
        for row in self.rows:
            known = KnownRow(
                tuple(self.inputs.index(name) for name in row.structures),
                tuple(Structure.parse(text) for text in row.structures.values()),
                np.array([p.value for p in row.parameters]),
                np.array(row.covariance, dtype=float),
                tuple(k for k, p in enumerate(row.parameters) if p.unknown),
            )
            i = self.outputs.index(row.output)
            rows[i] = known
            for j, structure, part in zip(known.columns, known.structures, known.slices, strict=True):
                elements[i][j] = structure.transfer(known.theta[part])
        return UncertainPlant(TransferMatrix(tuple(tuple(row) for row in elements), time_unit), rows)


def _row(output: str, inputs: Sequence[str], row: KnownRow) -> UncertainRow:
    parameters = (
        UncertainParameter(inputs[j], name, float(row.theta[k]), k in row.unknown)
        for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True)
        for k, name in zip(range(part.start, part.stop), structure.names, strict=True)
    )
    structures = {inputs[j]: str(structure) for j, structure in zip(row.columns, row.structures, strict=True)}
    return UncertainRow(output, structures, tuple(parameters), tuple(tuple(line) for line in row.covariance.tolist()))
