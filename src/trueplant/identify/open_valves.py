"""Valves that may not follow OP, as likelihood ratios count them.

What a valve that does not follow OP makes of it passes for the plant's, and a test that takes OP at its word then finds
a change that is none. Which bands the valves have is not what such a test asks: so the model and the estimate are
compared each beside the valves that make it likeliest, for beside the model a band may explain what a changed plant
would explain as well. A mean over the bands would hold against the model how exactly it needs to know the band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.joint_plant import JointPlant
from trueplant.identify.output import OutputEstimate
from trueplant.identify.valve_effects import RowErrors, behind
from trueplant.identify.valves import FoundValve, Tried, Tries, tries_of
from trueplant.loop.valve import Valve

Fits = Mapping[int, RowFit]
"""By output."""


class Plant(Protocol):
    """The outputs of a plant as they were fitted, to place valves in front of."""

    @property
    def deviance(self) -> float:
        """-2 log likelihood up to a constant."""
        ...

    def promised(self, column: int, valves: Sequence[Valve]) -> Array:
        """(m,) by how much it falls to first order behind each of these in an input."""
        ...

    def behind(self, valves: Mapping[int, Valve]) -> Plant:
        """With the positions of the valves' stems for their inputs, by column."""
        ...


@dataclass(frozen=True, eq=False)
class OutputByOutput:
    """Outputs that were fitted one by one."""

    rows: Mapping[int, RowErrors]
    """By output."""

    @classmethod
    def of(cls, fits: Fits) -> OutputByOutput:
        return cls({i: RowErrors(fit) for i, fit in fits.items()})

    @property
    def deviance(self) -> float:
        return sum(row.fit.deviance for row in self.rows.values())

    def promised(self, column: int, valves: Sequence[Valve]) -> Array:
        moved = [row for row in self.rows.values() if column in _columns(row.fit)]
        return np.asarray(np.sum([row.promised(column, valves) for row in moved], axis=0))

    def behind(self, valves: Mapping[int, Valve]) -> OutputByOutput:
        rows = dict(self.rows)
        for i, row in self.rows.items():
            if own := {j: valves[j] for j in _columns(row.fit) if j in valves}:
                rows[i] = RowErrors(behind(row.fit, own))
        return OutputByOutput(rows)


def with_open_valves(
    estimates: Mapping[int, OutputEstimate],
    tried: Mapping[int, Sequence[Tried]],
    valves: Mapping[int, FoundValve],
) -> dict[int, OutputEstimate]:
    """The estimates, with the valves that were tried, by column, open to their likelihood ratios.

    Of valves that were found, whose positions the estimates stand on, the bands nearby are.
    """
    fits = {i: estimate.fit for i, estimate in estimates.items() if estimate.fit.count}
    columns = [column for column in {**tried, **valves} if _moved_by(fits, column)]
    bands = {column: _tries(fits, column, tried.get(column, ()), valves.get(column)) for column in sorted(columns)}
    return {
        i: replace(one, open_valves=partial(gain, fits, bands, i)) if i in fits else one for i, one in estimates.items()
    }


def _tries(fits: Fits, column: int, tried: Sequence[Tried], found: FoundValve | None) -> Tries:
    tries = tries_of(fits[_moved_by(fits, column)[0]], column)
    return tries.open_to(tried) if found is None else replace(tries, kinds=(tuple(tries.nearby(found.valve)),))


def _columns(fit: RowFit) -> list[int]:
    return [spec.column for spec in fit.row.specs]


def _moved_by(fits: Fits, column: int) -> list[int]:
    """The outputs that an input moves."""
    return [i for i, fit in fits.items() if column in _columns(fit)]


def gain(fits: Fits, bands: Mapping[int, Tries], output: int, beside: RowFit | JointPlant) -> float:
    """By how much -2 log likelihood of a plant falls behind its likeliest valves, one output fitted as `beside`, or all
    together.

    Only those of the inputs that move this output, as the others are behind one fit of it as behind another.
    """
    own = {column: bands[column] for column in _columns(fits[output]) if column in bands and bands[column].kinds}
    if isinstance(beside, JointPlant):
        tried = tuple(own.items())
        if tried not in beside.gained:
            beside.gained[tried] = max(beside.deviance - beside.behind(likeliest(beside, own)).deviance, 0.0)
        return beside.gained[tried]
    moved_too = {i for column in own for i in _moved_by(fits, column)}
    every = {i: beside if i == output else fits[i] for i in moved_too}
    plant, part = (OutputByOutput.of(of) for of in (every, {i: of_a_part(fit) for i, fit in every.items()}))
    return max(plant.deviance - plant.behind(likeliest(part, own)).deviance, 0.0)


def likeliest(plant: Plant, bands: Mapping[int, Tries]) -> dict[int, Valve]:
    """The valves that make the plant likeliest, by column; none where OP is likelier.

    One after the other, each beside those before, and then each beside all others until nothing gains any more.
    """
    first, placed = {column: plant.promised(column, own.valves) for column, own in bands.items()}, dict[int, Valve]()
    columns = sorted(bands, key=lambda column: -float(np.max(first[column])))
    for _ in range(levels.VALVE_ROUNDS):
        before = dict(placed)
        for column in columns:
            own, now = bands[column], placed.get(column)
            tried = own.valves if now is None else (Valve(), *own.nearby(now), *own.valves)
            promised = plant.promised(column, tried) if placed else first[column]
            valve = tried[int(np.argmax(promised))]
            if np.max(promised) <= 0 or valve == placed.get(column):
                continue
            moved = plant.behind({column: valve})
            if moved.deviance < plant.deviance:
                plant, placed[column] = moved, valve
        if placed == before:
            break
    return placed
