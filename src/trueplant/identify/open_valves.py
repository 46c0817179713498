"""Valves that may not follow OP, as likelihood ratios count them.

What a valve that does not follow OP makes of it passes for the plant's, and a test that takes OP at its word then finds
a change that is none. So a likelihood ratio is one of means over all bands that are open, each beside the plant of the
hypothesis in question: beside the model a band may explain what a changed plant would explain as well. Bands have the
odds that they had before the record was looked at, and what the other outputs say of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.output import OutputEstimate
from trueplant.identify.valve_effects import ValveTest, behind
from trueplant.identify.valves import FoundValve, bands_of, odds_before, times
from trueplant.loop.valve import Valve


@dataclass(frozen=True, eq=False)
class OpenBands:
    """The bands of one valve that are open, for the tests of one output."""

    column: int
    bands: tuple[Valve, ...]
    before: Array
    """(n_bands,) log odds of each against the positions that the fits stand on, before the record is looked at."""
    others: tuple[RowFit, ...]
    """Of the other outputs that the input moves."""

    def gain(self, fit: RowFit) -> float:
        """By how much -2 log likelihood of a fit falls where it is a mean over the bands."""
        if not any(spec.column == self.column for spec in fit.row.specs):
            return 0.0
        odds = self._odds
        every = np.append(odds + self._evidence(fit), 0.0)
        return float(2 * (logsumexp(every) - logsumexp(np.append(odds, 0.0))))

    @cached_property
    def _odds(self) -> Array:
        """(n_bands,) their logarithms, with what the other outputs say."""
        return np.asarray(self.before + sum(self._evidence(fit) for fit in self.others))

    def _evidence(self, fit: RowFit) -> Array:
        """(n_bands,) log of the ratio of likelihoods, to first order.

        What the likeliest gains with the plant fitted behind it is the most that counts, as in the search.
        """
        part = of_a_part(fit)
        gains = ValveTest(part, self.column).of(self.bands).alone
        most = part.deviance - behind(part, self.column, self.bands[int(np.argmax(gains))]).deviance
        return np.asarray(np.minimum(gains, max(most, 0.0)) / 2)


def with_open_valves(
    estimates: Mapping[int, OutputEstimate], columns: Sequence[int], valves: Mapping[int, FoundValve]
) -> dict[int, OutputEstimate]:
    """The estimates, with the valves in these columns open to their likelihood ratios.

    Of valves that were found, whose positions the estimates stand on, the bands nearby are.
    """
    fits = {i: estimate.fit for i, estimate in estimates.items() if estimate.fit.count}
    out = dict(estimates)
    for column in columns:
        own = [i for i, fit in fits.items() if any(spec.column == column for spec in fit.row.specs)]
        for i in own:
            bands, before = _bands(fits[i], column, valves.get(column))
            if bands:
                others = tuple(fits[k] for k in own if k != i)
                more = OpenBands(column, bands, before, others).gain
                out[i] = replace(out[i], open_valves=(*out[i].open_valves, more))
    return out


def _bands(fit: RowFit, column: int, found: FoundValve | None) -> tuple[tuple[Valve, ...], Array]:
    """The bands that are open, and their log odds: of all, one valve in five does not follow OP."""
    if found is not None:
        nearby = tuple(times(found.valve, factor) for factor in levels.VALVE_FACTORS)
        return nearby, np.log(np.gradient(np.log(levels.VALVE_FACTORS)))
    kinds = bands_of(fit, column)
    shares = [np.full(len(kind), odds_before(kind)) for kind in kinds]
    return tuple(valve for kind in kinds for valve in kind), np.log(np.concatenate([np.zeros(0), *shares]))
