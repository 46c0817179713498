"""Valves that do not follow OP: backlash and stick-slip, found by what they do to the prediction errors.

A valve with a band is tried in every input: the stem positions that it would have had are taken for OP, and the fit is
renewed to first order, together with what else could explain the errors: a gain that depends on the operating point,
a second lag or lead, a slow tail. What the valve gains beyond all of these, over all outputs that its input moves, has
to be significant over all that was tried. The likelihood of stick-slip is a spike: its positions change as soon as the
band passes one of the distances at which it jumps, so that the grid of bands is fine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.moments import in_row
from trueplant.identify.output import OutputEstimate, at_median, averaged
from trueplant.identify.valve_effects import ValveTest, behind
from trueplant.loop.valve import Valve
from trueplant.record.types import Segment
from trueplant.result.budget import Source

BANDS = {"backlash": levels.BACKLASHES, "stick": levels.STICK_BANDS}
"""The kinds of valves, and how wide their bands may be, relative to the range of OP."""


@dataclass(frozen=True)
class FoundValve:
    """A valve that is not where its OP is."""

    valve: Valve
    p_value: float
    """That it is, with what a search over all valves and bands finds in noise taken off."""
    error: float = 0.0
    """Relative standard error of the band, as the likelihoods of those nearby have it; 0 where not looked for."""

    @property
    def band(self) -> float:
        """In the unit of OP."""
        return self.valve.backlash or self.valve.stick


@dataclass(frozen=True, eq=False)
class Tried:
    """One kind of valve in one input: the likeliest of its bands, and what it would make of the plant."""

    found: FoundValve
    odds: Array
    """(n_bands,) Of each band against a valve that follows OP: the ratio of likelihoods, times the odds before."""
    shifts: Mapping[int, Array]
    """(n_bands, size) By output: by how much the plant's parameters would be larger behind each of them."""
    behind: Mapping[int, RowFit]
    """By output: the plant fitted behind the likeliest."""


def try_valves(estimates: Mapping[int, OutputEstimate], columns: Sequence[int]) -> dict[int, tuple[Tried, ...]]:
    """Both kinds of valves in each of these inputs, by column; none where OP does not move."""
    fits = {i: estimate.fit for i, estimate in estimates.items() if estimate.fit.count}
    found = {}
    for column in columns:
        own = {i: fit for i, fit in fits.items() if any(spec.column == column for spec in fit.row.specs)}
        found[column] = _tried(own, column, len(columns)) if own else ()
    return found


def sticking(tried: Mapping[int, Sequence[Tried]]) -> dict[int, FoundValve]:
    """The valve of which it is surest that it does not follow OP, by its column; empty where that is within chance."""
    every = [(one.found.p_value, column, one.found) for column, ones in tried.items() for one in ones]
    p, column, found = min(every, key=lambda one: one[:2], default=(1.0, 0, None))
    return {} if found is None or p >= levels.VALVE else {column: found}


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
                out[i] = averaged(estimate, np.outer([1.0, -1.0], lean), np.full(2, 0.5), confidence, Source.VALVE)
    return out


def _tried(fits: Mapping[int, RowFit], column: int, inputs: int) -> tuple[Tried, ...]:
    parts = {i: of_a_part(fit) for i, fit in fits.items()}
    kinds = bands_of(next(iter(parts.values())), column)
    tests = [ValveTest(fit, column) for fit in parts.values()] if kinds else []
    return tuple(_kind(parts, tests, column, kind, inputs) for kind in kinds)


def bands_of(fit: RowFit, column: int) -> list[list[Valve]]:
    """By kind, the valves that an input may have: bands relative to the range of its OP; none where it stands still."""
    moved = float(np.ptp(np.concatenate([piece.recorded[column] for piece in fit.row.pieces])))
    if not moved > 0:
        return []
    return [[Valve(**{name: float(share * moved)}) for share in shares] for name, shares in BANDS.items()]


def odds_before(kind: Sequence[Valve]) -> float:
    """Of each of its bands, before the record is looked at, against a valve that follows OP."""
    return levels.STICKS / len(BANDS) / len(kind)


def _kind(
    fits: Mapping[int, RowFit], tests: Sequence[ValveTest], column: int, kind: Sequence[Valve], inputs: int
) -> Tried:
    """One kind of valve; p-value by Bonferroni over its bands, both kinds, and so many inputs.

    To first order a wide band may promise what no plant keeps: what the likeliest gains with the plant fitted behind it
    is the most that counts.
    """
    effects = [test.of(kind) for test in tests]
    evidence = np.sum([of.evidence for of in effects], axis=0)
    best = int(np.argmax(evidence))
    valve, error, gain = kind[best], 0.0, sum(float(of.beyond[best]) for of in effects)
    searched = len(kind) * len(BANDS) * inputs
    if searched * chi2.sf(max(gain, 0.0), 1) < levels.VALVE:
        valve, error = _refined(list(fits.values()), column, valve)
    moved = {i: behind(fit, {column: valve}) for i, fit in fits.items()}
    most = sum(fits[i].deviance - moved[i].deviance for i in fits)
    p = float(min(1.0, searched * chi2.sf(max(min(gain, most), 0.0), 1)))
    ratios = np.exp(np.minimum(evidence, min(most / 2, levels.LARGEST_EXPONENT)))
    odds = odds_before(kind) * ratios
    shifts = {i: of.shifts for i, of in zip(fits, effects, strict=True)}
    return Tried(FoundValve(valve, p, error), odds, shifts, moved)


def _refined(fits: Sequence[RowFit], column: int, valve: Valve) -> tuple[Valve, float]:
    """The width that explains most, and its relative standard error as the likelihoods of those nearby have it.

    The plant is fitted behind each: what was found beside a plant fitted to OP leans.
    """
    error = 0.0
    for _ in range(levels.VALVE_ROUNDS):
        found = [behind(fit, {column: valve}) for fit in fits]
        tests = [ValveTest(fit, column) for fit in found]
        nearby = [times(valve, factor) for factor in levels.VALVE_FACTORS]
        evidence = np.sum([test.of(nearby).evidence for test in tests], axis=0)
        best = int(np.argmax(evidence))
        apart = np.log(levels.VALVE_FACTORS / levels.VALVE_FACTORS[best])
        shares = np.exp(evidence - evidence[best]) * np.gradient(apart)
        error = float(np.sqrt(shares @ apart**2 / shares.sum()))
        if nearby[best] == valve:
            break
        valve = nearby[best]
    return valve, error


def times(valve: Valve, factor: float) -> Valve:
    """One whose band is so many times as wide."""
    return Valve(valve.backlash * factor, valve.stick * factor)


def _lean(fit: RowFit, column: int, found: FoundValve) -> Array:
    """(size,) by how much a relative standard error of the band moves the plant behind the valve."""
    widths = [times(found.valve, float(np.exp(side))) for side in (found.error, -found.error)]
    wider, narrower = (behind(fit, {column: valve}) for valve in widths)
    return np.asarray((wider.theta - narrower.theta) / 2)


def behind_valves(segments: Sequence[Segment], valves: Mapping[int, FoundValve]) -> tuple[Segment, ...]:
    """The segments with the positions of their stems for OP, from where on these are known.

    Where a stem stood at the beginning of a record, or after a gap, is not known until OP has moved through its band.
    Segments in which it never does are left out, but for those in which it does not move at all, nor its stem.
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
            known = travel > found.band
            first = max(first, int(np.argmax(known)) if known[-1] else len(segment) if travel[-1] > 0 else 0)
        if first == len(segment):
            continue
        sent = segment.u if segment.sent is None else segment.sent
        moved.append(replace(segment, u=u, sent=sent).part(first))
    return tuple(moved)
