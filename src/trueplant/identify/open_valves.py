"""Valves that may not follow OP, as likelihood ratios count them.

What a valve that does not follow OP makes of it passes for the plant's, and a test that takes OP at its word then finds
a change that is none. Which bands the valves have is not what such a test asks: so the model and the estimate are
compared each beside the valves that make it likeliest, for beside the model a band may explain what a changed plant
would explain as well. A mean over the bands would hold against the model how exactly it needs to know the band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.output import OutputEstimate
from trueplant.identify.valve_effects import ValveTest, behind
from trueplant.identify.valves import FoundValve, bands_of, times
from trueplant.loop.valve import Valve

Fits = Mapping[int, RowFit]
"""By output."""


def with_open_valves(
    estimates: Mapping[int, OutputEstimate], columns: Sequence[int], valves: Mapping[int, FoundValve]
) -> dict[int, OutputEstimate]:
    """The estimates, with the valves in these columns open to their likelihood ratios.

    Of valves that were found, whose positions the estimates stand on, the bands nearby are.
    """
    fits = {i: estimate.fit for i, estimate in estimates.items() if estimate.fit.count}
    bands = {column: _bands(fits, column, valves.get(column)) for column in columns}
    return {
        i: replace(one, open_valves=partial(gain, fits, bands, i)) if i in fits else one for i, one in estimates.items()
    }


def _bands(fits: Fits, column: int, found: FoundValve | None) -> list[Valve]:
    moved = _moved_by(fits, column)
    if not moved:
        return []
    return _nearby(found.valve) if found is not None else [*chain(*bands_of(fits[moved[0]], column))]


def _nearby(valve: Valve) -> list[Valve]:
    return [times(valve, factor) for factor in levels.VALVE_FACTORS]


def _moved_by(fits: Fits, column: int) -> list[int]:
    """The outputs that an input moves."""
    return [i for i, fit in fits.items() if any(spec.column == column for spec in fit.row.specs)]


def gain(fits: Fits, bands: Mapping[int, Sequence[Valve]], output: int, fit: RowFit) -> float:
    """By how much -2 log likelihood of a plant falls behind its likeliest valves, one output fitted as `fit`.

    Only those of the inputs that move this output, as the others are behind one fit of it as behind another.
    """
    own = {spec.column: bands[spec.column] for spec in fits[output].row.specs if bands.get(spec.column)}
    moved_too = {i for column in own for i in _moved_by(fits, column)}
    every = {i: fit if i == output else fits[i] for i in moved_too}
    valves = likeliest({i: of_a_part(one) for i, one in every.items()}, own)
    moved = {i: _own(one, valves) for i, one in every.items()}
    return max(sum(every[i].deviance - behind(every[i], of).deviance for i, of in moved.items() if of), 0.0)


def _own(fit: RowFit, valves: Mapping[int, Valve]) -> dict[int, Valve]:
    """Those in its inputs."""
    return {spec.column: valves[spec.column] for spec in fit.row.specs if spec.column in valves}


def likeliest(fits: Fits, bands: Mapping[int, Sequence[Valve]]) -> dict[int, Valve]:
    """The valves that make the plant likeliest, by column; none where OP is likelier.

    One after the other, each beside those before, and then each beside all others until nothing gains any more.
    """
    first = {column: _promised(fits, column, own) for column, own in bands.items()} if len(bands) > 1 else {}
    columns = sorted(bands, key=lambda column: -first[column][0] if first else 0.0)
    now, placed = dict(fits), dict[int, Valve]()
    for _ in range(levels.VALVE_ROUNDS):
        before = dict(placed)
        for column in columns:
            tried = [Valve(), *_nearby(placed[column])] if column in placed else bands[column]
            promised, valve = _promised(now, column, tried)
            if promised <= 0 or valve == placed.get(column):
                continue
            moved = {i: behind(now[i], {column: valve}) for i in _moved_by(now, column)}
            if sum(now[i].deviance - fit.deviance for i, fit in moved.items()) > 0:
                now |= moved
                placed[column] = valve
        if placed == before:
            break
    return placed


def _promised(fits: Fits, column: int, valves: Sequence[Valve]) -> tuple[float, Valve]:
    """What the likeliest of these gains to first order, over all outputs, and which it is."""
    gains = np.sum([ValveTest(fits[i], column).of(valves).alone for i in _moved_by(fits, column)], axis=0)
    best = int(np.argmax(gains))
    return float(gains[best]), valves[best]
