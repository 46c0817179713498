"""Valves that do not follow OP: backlash, stick-slip, and ends that OP goes beyond, found by what they do to the
prediction errors.

Each is tried in every input: the stem positions that such a valve would have had are taken for OP, and the fit is
renewed to first order, together with what else could explain the errors: a gain that depends on the operating point,
a second lag or lead, a slow tail. What the valve gains beyond all of these, over all outputs that its input moves, has
to be significant over all that was tried. First order is of little use behind a valve that hides much of what OP does,
as the plant fitted to OP is far off: where valves promise more than chance would, the plant is fitted behind some of
them. The likelihood of stick-slip is a spike: its positions change as soon as the band passes one of the distances at
which it jumps, so that the grid of bands is fine; that of an end is smooth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array, IntArray
from trueplant.identify import levels
from trueplant.identify.between_samples import again_to_means, fitted_to_means
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.moments import in_row
from trueplant.identify.output import OutputEstimate, at_median, averaged
from trueplant.identify.valve_effects import BENDS, Effects, ValveTest, behind, bends
from trueplant.loop.valve import Valve
from trueplant.record.types import Segment
from trueplant.result.budget import Source

STICKING = ("backlash", "stick-slip")
"""Kinds of valves that are suspected in any record."""
KINDS = (*STICKING, "an end")
"""An end is as likely as one of the others, but suspected only where the record speaks for it: an OP that moves between
two levels cannot tell it from a smaller gain."""


@dataclass(frozen=True)
class FoundValve:
    """A valve that is not where its OP is."""

    valve: Valve
    p_value: float
    """That it is, with what a search over all valves and bands finds in noise taken off."""
    error: float = 0.0
    """Relative standard error of the band, or of what OP goes beyond the end, as the likelihoods of those nearby have
    it; 0 where not looked for."""

    @property
    def band(self) -> float:
        """In the unit of OP; 0 of one that only has an end."""
        return self.valve.backlash or self.valve.stick

    @property
    def end(self) -> float | None:
        """Where the stem goes no further while OP does."""
        return next((end for end in (self.valve.low, self.valve.high) if np.isfinite(end)), None)


@dataclass(frozen=True)
class Tries:
    """What may be a valve in one input."""

    kinds: tuple[tuple[Valve, ...], ...]
    span: tuple[float, float]
    """The range of OP."""

    @property
    def valves(self) -> tuple[Valve, ...]:
        return tuple(chain(*self.kinds))

    def open_to(self, tried: Sequence[Tried]) -> Tries:
        """With ends only where the record speaks for one."""
        suspected = bool(tried) and bool(tried[-1].odds.any())
        return self if suspected else replace(self, kinds=self.kinds[: len(STICKING)])

    def times(self, valve: Valve, factor: float) -> Valve:
        """One whose band, or the part of OP's range that its stem does not reach, is so many times as wide."""
        if factor == 1.0:
            return valve
        (low, high), factor = self.span, float(factor)
        ends = low + factor * (valve.low - low), high - factor * (high - valve.high)
        return Valve(valve.backlash * factor, valve.stick * factor, *ends)

    def step(self, ends: Sequence[Valve]) -> float:
        """How far the logarithms of the parts of OP's range that they do not reach are from one to the next."""
        low, high = self.span
        widths = np.array([of.low - low if of.low > -np.inf else high - of.high for of in ends])
        return float(np.median(np.abs(np.diff(np.log(widths)))))

    def nearby(self, valve: Valve) -> list[Valve]:
        return [self.times(valve, factor) for factor in levels.VALVE_FACTORS]


@dataclass(frozen=True, eq=False)
class Tried:
    """One kind of valve in one input: the likeliest of its bands, and what it would make of the plant."""

    found: FoundValve
    log_p: float
    """The logarithm of its p-value."""
    odds: Array
    """(n_bands,) Of each band against a valve that follows OP: the ratio of likelihoods, times the odds before."""
    shifts: Mapping[int, Array]
    """(n_bands, size) By output: by how much the plant's parameters would be larger behind each of them."""
    behind: Mapping[int, RowFit]
    """By output: the plant fitted behind the likeliest."""


def try_valves(estimates: Mapping[int, OutputEstimate], columns: Sequence[int]) -> dict[int, tuple[Tried, ...]]:
    """All kinds of valves in each of these inputs, by column; none where OP does not move."""
    fits = {i: estimate.fit for i, estimate in estimates.items() if estimate.fit.count}
    found = {}
    for column in columns:
        own = {i: fit for i, fit in fits.items() if any(spec.column == column for spec in fit.row.specs)}
        found[column] = _tried(own, column, len(columns)) if own else ()
    return found


def sticking(tried: Mapping[int, Sequence[Tried]]) -> dict[int, FoundValve]:
    """The valve of which it is surest that it does not follow OP, by its column; empty where that is within chance."""
    every = [(one.log_p, column, one.found) for column, ones in tried.items() for one in ones]
    log_p, column, found = min(every, key=lambda one: one[:2], default=(0.0, 0, None))
    return {} if found is None or log_p >= np.log(levels.VALVE) else {column: found}


def over_open_valves(
    estimates: Mapping[int, OutputEstimate], tried: Mapping[int, Sequence[Tried]], confidence: float
) -> dict[int, OutputEstimate]:
    """The medians over what valves that may not follow OP, though not beyond chance, would make of the estimates."""
    out = dict(estimates)
    for ones in tried.values():
        odds = np.concatenate([np.ones(1), *(one.odds for one in ones)])
        shares = odds / odds.sum()
        for i in out.keys() & (ones[0].behind.keys() if ones else ()):
            moved = [in_row(one.shifts[i], one.behind[i], out[i].row, out[i].theta) for one in ones]
            shifts = np.vstack([np.zeros((1, out[i].row.size)), *moved])
            out[i] = at_median(out[i], shifts, shares, confidence, Source.VALVE)
    return out


def widened_for_bands(
    estimates: Mapping[int, OutputEstimate], valves: Mapping[int, FoundValve], confidence: float
) -> dict[int, OutputEstimate]:
    """The estimates behind valves that stick, with what their bands leave open."""
    out = dict(estimates)
    for column, found in valves.items():
        for i, estimate in out.items():
            if any(spec.column == column for spec in estimate.row.specs):
                lean = _lean(of_a_part(estimate.fit), column, found)
                nowhere, spread = np.zeros((1, lean.size)), np.outer(lean, lean)[None]
                out[i] = averaged(estimate, nowhere, np.ones(1), confidence, Source.VALVE, spread)
    return out


def _tried(fits: Mapping[int, RowFit], column: int, inputs: int) -> tuple[Tried, ...]:
    parts = {i: of_a_part(fit) for i, fit in fits.items()}
    tries = tries_of(next(iter(parts.values())), column)
    if not tries.kinds:
        return ()
    search = Search(parts, [ValveTest(fit, column) for fit in parts.values()], column, tries, inputs)
    return (*(_band(search, kind) for kind in tries.kinds[: len(STICKING)]), _end(search, tries.kinds[-1]))


def tries_of(fit: RowFit, column: int) -> Tries:
    """The valves that an input may have: bands relative to the range of its OP, ends where it is; none where it stands
    still."""
    op = np.concatenate([piece.recorded[column] + piece.about[column] for piece in fit.row.pieces])
    low, high = float(op.min()), float(op.max())
    if not high > low:
        return Tries((), (low, high))
    backlashes, sticks = ([float(x) for x in (high - low) * of] for of in (levels.BACKLASHES, levels.STICK_BANDS))
    ends = [Valve(low=-x) for x in _ends(-op)] + [Valve(high=x) for x in _ends(op)]
    kinds = [Valve(backlash=x) for x in backlashes], [Valve(stick=x) for x in sticks], ends
    return Tries(tuple(tuple(kind) for kind in kinds if kind), (low, high))


def _ends(op: Array) -> list[float]:
    """Upper ends that cut off parts of what OP does in all, from its lowest on, as BEYOND_ENDS says.

    Of long records as many samples as a search takes are enough to place them.
    """
    at = np.sort(op[:: max(op.size // levels.SEARCHED_ERRORS, 1)])
    steps = np.diff(at) * np.arange(at.size - 1, 0, -1)
    cut = np.append(np.cumsum(steps[::-1])[::-1], 0.0) / steps.sum()
    return [float(x) for x in np.interp(levels.BEYOND_ENDS, cut[::-1], at[::-1])]


def odds_before(kind: Sequence[Valve]) -> float:
    """Of each of its bands, before the record is looked at, against a valve that follows OP."""
    return levels.STICKS / len(STICKING) / len(kind)


@dataclass(frozen=True, eq=False)
class Search:
    """One input of the outputs that it moves, ready for valves to be tried in it."""

    fits: Mapping[int, RowFit]
    tests: Sequence[ValveTest]
    column: int
    tries: Tries
    inputs: int
    """In so many inputs valves are looked for."""

    def log_p(self, kind: Sequence[Valve], gain: float) -> float:
        """By Bonferroni over the valves of its kind, all kinds, and all inputs."""
        return min(0.0, float(np.log(self._searched(kind)) + chi2.logsf(max(gain, 0.0), 1)))

    def enough(self, kind: Sequence[Valve]) -> float:
        """The gain that is beyond chance."""
        return float(chi2.isf(levels.VALVE / self._searched(kind), 1))

    def _searched(self, kind: Sequence[Valve]) -> int:
        return len(kind) * len(KINDS) * self.inputs

    def looked_at(self, kind: Sequence[Valve]) -> tuple[list[Effects], dict[int, Placed]]:
        """All of a kind to first order, and with the plant fitted behind them the likeliest, and some of those that
        promise more than chance would, by their place."""
        effects = [test.of(kind) for test in self.tests]
        alone, evidence, beyond = (np.sum(each, axis=0) for each in zip(*(of.sums for of in effects), strict=True))
        enough = self.enough(kind)
        asked = sorted({int(np.argmax(evidence)), *_spread(np.flatnonzero(alone > enough))})
        return effects, {k: self.placed(kind[k], float(beyond[k]), enough) for k in asked}

    def placed(self, valve: Valve, promised: float, enough: float) -> Placed:
        """To first order a wide band may promise what no plant keeps: what is gained with the plant fitted behind it is
        the most that counts. And a valve that hides much of what OP does promises little, as the plant fitted to OP is
        far off: so what else could explain the errors is asked behind the valve too. Where measurements of PV are left
        out, what it did meanwhile passes for a stem's: it has to gain as much by their means.
        """
        moved = {i: behind(fit, {self.column: valve}) for i, fit in self.fits.items()}
        most = sum(self.fits[i].deviance - moved[i].deviance for i in moved)
        if most > enough:
            means = self._means.items()
            most = min(most, sum(one.deviance - again_to_means(moved[i], one).deviance for i, one in means))
        gain, evidence = min(promised, most), -np.inf
        if most > enough:
            after = [ValveTest(fit, self.column) for fit in moved.values()]
            less = sum(test.gained - one.gained for test, one in zip(self.tests, after, strict=True))
            gain = max(gain, most - max(less, 0.0))
            evidence = most / 2 + sum(one.open_to - test.open_to for test, one in zip(self.tests, after, strict=True))
        return Placed(valve, moved, promised, most, gain, evidence)

    def refined(self, valve: Valve) -> Refined:
        """The plant is fitted behind each: what was found beside a plant fitted to OP leans."""
        for _ in range(levels.VALVE_ROUNDS):
            nearby = self.tries.nearby(valve)
            tests = [ValveTest(behind(fit, {self.column: valve}), self.column) for fit in self.fits.values()]
            effects = [test.of(nearby) for test in tests]
            evidence = np.sum([of.evidence for of in effects], axis=0)
            best = int(np.argmax(evidence))
            apart = np.log(levels.VALVE_FACTORS / levels.VALVE_FACTORS[best])
            shares = np.exp(evidence - evidence[best]) * np.gradient(apart)
            error = float(np.sqrt(shares @ apart**2 / shares.sum()))
            shifts = [of.shifts - of.shifts[best] for of in effects]
            found = Refined(nearby[best], error, evidence - evidence[best], shifts)
            if levels.VALVE_FACTORS[best] == 1.0:
                break
            valve = nearby[best]
        return found

    @cached_property
    def _means(self) -> dict[int, RowFit]:
        """The fits to means of PV, by output; as they are where nothing is left out."""
        return {i: fitted_to_means(fit) for i, fit in self.fits.items()}

    def moved(self, placed: Placed) -> dict[int, Array]:
        """(size,) by output, by how much the plant's parameters are larger behind a valve."""
        return {i: placed.behind[i].theta - fit.theta for i, fit in self.fits.items()}


def _spread(places: IntArray) -> list[int]:
    """As many of these, evenly spread, as are worth their fits."""
    chosen = np.linspace(0, places.size - 1, min(places.size, levels.VALVES_PLACED))
    return [int(k) for k in places[chosen.astype(int)]]


@dataclass(frozen=True, eq=False)
class Placed:
    """A valve placed in front of a plant, which is fitted behind it."""

    valve: Valve
    behind: Mapping[int, RowFit]
    promised: float
    """What it gains in -2 log likelihood to first order, where all else that could explain the errors is there."""
    most: float
    """What it gains where nothing else is."""
    gain: float
    """What it gains beside all else, as far as the plant keeps that."""
    evidence: float
    """log of the ratio of likelihoods, beside all else as far as the record needs that; -inf where it gains too little
    to ask."""

    def is_bent(self, column: int) -> bool:
        """Does OP act beyond the end after all, or is the gain not the same throughout before it?"""
        fallen = sum(bends(fit, column) for fit in self.behind.values())
        return bool(chi2.sf(fallen, len(BENDS) * len(self.behind)) < levels.UNDERMODELLED)


@dataclass(frozen=True, eq=False)
class Refined:
    """The valve that explains most, and those nearby, as far as they are from it by VALVE_FACTORS."""

    valve: Valve
    error: float
    """Relative standard error of its width, as their likelihoods have it."""
    evidence: Array
    """(n_factors,) log of the ratio of their likelihoods to its own."""
    shifts: list[Array]
    """(n_factors, size) for each output, by how much the plant's parameters would be larger than behind it."""


def _band(search: Search, kind: Sequence[Valve]) -> Tried:
    """Backlash or stick-slip, the likeliest of its bands; all of them have their odds."""
    effects, placed = search.looked_at(kind)
    evidence = np.sum([of.evidence for of in effects], axis=0)
    shifts = {i: of.shifts for i, of in zip(search.fits, effects, strict=True)}
    for k, one in placed.items():
        if one.evidence > evidence[k]:
            evidence[k] = one.evidence
            for i, moved in search.moved(one).items():
                shifts[i][k] = moved
    most, enough = max(one.most for one in placed.values()), search.enough(kind)
    best, error = max(placed.values(), key=lambda one: (one.gain > enough, one.evidence, one.gain)), 0.0
    if (best.most > 0 and max(best.promised, best.gain) > enough) or best.evidence > 0:
        refined = search.refined(best.valve)
        best, error = search.placed(refined.valve, best.promised, enough), refined.error
    log_p = search.log_p(kind, best.gain)
    odds = odds_before(kind) * np.exp(np.minimum(evidence, min(most / 2, levels.LARGEST_EXPONENT)))
    return Tried(FoundValve(best.valve, float(np.exp(log_p)), error), log_p, odds, shifts, best.behind)


def _end(search: Search, kind: Sequence[Valve]) -> Tried:
    """An end of which the record speaks, if OP does nothing beyond it; its likelihood is smooth, and those nearby have
    their odds."""
    _, placed = search.looked_at(kind)
    best = max(placed.values(), key=lambda one: one.evidence)
    if best.evidence > 0:
        refined = search.refined(best.valve)
        best = search.placed(refined.valve, best.promised, search.enough(kind))
        if not best.is_bent(search.column):
            evidence = np.minimum(best.evidence + refined.evidence, min(best.most / 2, levels.LARGEST_EXPONENT))
            closer = np.gradient(np.log(levels.VALVE_FACTORS)) / search.tries.step(kind)
            moved = search.moved(best).items()
            shifts = {i: one + own for (i, one), own in zip(moved, refined.shifts, strict=True)}
            log_p = search.log_p(kind, best.gain)
            found = FoundValve(best.valve, float(np.exp(log_p)), refined.error)
            return Tried(found, log_p, odds_before(kind) * closer * np.exp(evidence), shifts, best.behind)
    nowhere = {i: np.zeros((1, fit.theta.size)) for i, fit in search.fits.items()}
    return Tried(FoundValve(best.valve, 1.0), 0.0, np.zeros(1), nowhere, best.behind)


def _lean(fit: RowFit, column: int, found: FoundValve) -> Array:
    """(size,) by how much a relative standard error of the band moves the plant behind the valve."""
    tries = tries_of(fit, column)
    widths = [tries.times(found.valve, float(np.exp(side))) for side in (found.error, -found.error)]
    wider, narrower = (behind(fit, {column: valve}) for valve in widths)
    return np.asarray((wider.theta - narrower.theta) / 2)


def behind_valves(segments: Sequence[Segment], valves: Mapping[int, FoundValve]) -> tuple[Segment, ...]:
    """The segments with the positions of their stems for OP, from where on these are known.

    Where a stem stood at the beginning of a record, or after a gap, is not known until OP has moved through its band.
    Segments in which it never does are left out, but for those in which it does not move at all, nor its stem. Of one
    that only has an end it is known throughout.
    """
    if not valves:
        return tuple(segments)
    moved = []
    for segment in segments:
        u, first = segment.u.copy(), 0
        for column, found in valves.items():
            op = segment.u[:, column]
            u[:, column] = found.valve.positions(op)
            travel = np.maximum.accumulate(op) - np.minimum.accumulate(op)
            known = travel > found.band if found.band else np.ones(op.size, dtype=bool)
            first = max(first, int(np.argmax(known)) if known[-1] else len(segment) if travel[-1] > 0 else 0)
        if first == len(segment):
            continue
        sent = segment.u if segment.sent is None else segment.sent
        moved.append(replace(segment, u=u, sent=sent).part(first))
    return tuple(moved)
