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
from scipy.signal import lfilter
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit, Whitening, fit_row
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.moments import in_row
from trueplant.identify.output import OutputEstimate, averaged
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
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
    leans: Mapping[int, Array]
    """(size,) By output: by how much a standard error of the band moves the plant behind it; of a valve that sticks
    beyond chance."""


def try_valves(estimates: Mapping[int, OutputEstimate], columns: Sequence[int]) -> dict[int, tuple[Tried, ...]]:
    """Both kinds of valves in each of these inputs, by column; none where OP does not move."""
    fits = {i: estimate.fit for i, estimate in estimates.items() if estimate.fit.count}
    found = {}
    for column in columns:
        own = {i: fit for i, fit in fits.items() if any(spec.column == column for spec in fit.row.specs)}
        found[column] = _tried(own, column, len(columns)) if own else ()
    return found


def sticking(tried: Mapping[int, Sequence[Tried]]) -> dict[int, FoundValve]:
    """The valves that do not follow OP beyond chance, by column."""
    best = {
        column: min((one.found for one in ones), key=lambda one: one.p_value) for column, ones in tried.items() if ones
    }
    return {column: one for column, one in best.items() if one.p_value < levels.VALVE}


def widened_for_valves(
    estimates: Mapping[int, OutputEstimate], tried: Mapping[int, Sequence[Tried]], confidence: float
) -> dict[int, OutputEstimate]:
    """The estimates with what valves that may not follow OP, though not beyond chance, would move."""
    out = dict(estimates)
    for ones in tried.values():
        odds = np.concatenate([np.ones(1), *(one.odds for one in ones)])
        for i in out.keys() & (ones[0].behind.keys() if ones else ()):
            moved = [in_row(one.shifts[i], one.behind[i], out[i].row, out[i].theta) for one in ones]
            shifts = np.vstack([np.zeros((1, out[i].row.size)), *moved])
            out[i] = averaged(out[i], shifts, odds / odds.sum(), confidence, Source.VALVE)
    return out


def widened_for_bands(
    estimates: Mapping[int, OutputEstimate],
    valves: Mapping[int, FoundValve],
    tried: Mapping[int, Sequence[Tried]],
    confidence: float,
) -> dict[int, OutputEstimate]:
    """The estimates behind valves that stick, with what their bands leave open."""
    out = dict(estimates)
    for column, found in valves.items():
        one = next(one for one in tried[column] if one.found is found)
        for i in out.keys() & one.leans.keys():
            shifts = in_row(np.outer([1.0, -1.0], one.leans[i]), one.behind[i], out[i].row, out[i].theta)
            out[i] = averaged(out[i], shifts, np.full(2, 0.5), confidence, Source.VALVE)
    return out


def _tried(fits: Mapping[int, RowFit], column: int, inputs: int) -> tuple[Tried, ...]:
    parts = {i: of_a_part(fit) for i, fit in fits.items()}
    op = np.concatenate([piece.inputs[column] for piece in next(iter(parts.values())).row.pieces])
    moved = float(np.ptp(op))
    if not moved > 0:
        return ()
    tests = [_Test(fit, column, fit.row) for fit in parts.values()]
    kinds = [[Valve(**{name: float(share * moved)}) for share in shares] for name, shares in BANDS.items()]
    return tuple(_kind(parts, tests, column, kind, inputs) for kind in kinds)


def _kind(fits: Mapping[int, RowFit], tests: Sequence[_Test], column: int, kind: Sequence[Valve], inputs: int) -> Tried:
    """One kind of valve; p-value by Bonferroni over its bands, both kinds, and so many inputs.

    To first order a wide band may promise what no plant keeps: what the likeliest gains with the plant fitted behind it
    is the most that counts.
    """
    every = [[test.of(valve) for test in tests] for valve in kind]
    evidence = np.array([sum(one.evidence for one in ones) for ones in every])
    best = int(np.argmax(evidence))
    valve, error, gain = kind[best], 0.0, sum(one.beyond for one in every[best])
    searched = len(kind) * len(BANDS) * inputs
    if searched * chi2.sf(max(gain, 0.0), 1) < levels.VALVE:
        valve, error = _refined(list(fits.values()), column, valve)
    behind = {i: _behind(fit, column, valve) for i, fit in fits.items()}
    most = sum(fits[i].deviance - behind[i].deviance for i in fits)
    p = float(min(1.0, searched * chi2.sf(max(min(gain, most), 0.0), 1)))
    ratios = np.exp(np.minimum(evidence, min(most / 2, levels.LARGEST_EXPONENT)))
    odds = levels.STICKS / len(BANDS) * ratios / len(kind)
    shifts = {i: np.array([ones[n].shift for ones in every]) for n, i in enumerate(fits)}
    leans = {i: _lean(fit, column, valve, error) for i, fit in fits.items()} if p < levels.VALVE else {}
    return Tried(FoundValve(valve, p, error), odds, shifts, behind, leans)


def _refined(fits: Sequence[RowFit], column: int, valve: Valve) -> tuple[Valve, float]:
    """The width that explains most, and its relative standard error as the likelihoods of those nearby have it.

    The plant is fitted behind each: what was found beside a plant fitted to OP leans.
    """
    error = 0.0
    for _ in range(levels.VALVE_ROUNDS):
        behind = [_behind(fit, column, valve) for fit in fits]
        tests = [_Test(moved, column, fit.row) for moved, fit in zip(behind, fits, strict=True)]
        nearby = [_times(valve, factor) for factor in levels.VALVE_FACTORS]
        evidence = np.array([sum(test.of(one).evidence for test in tests) for one in nearby])
        best = int(np.argmax(evidence))
        apart = np.log(levels.VALVE_FACTORS / levels.VALVE_FACTORS[best])
        shares = np.exp(evidence - evidence[best]) * np.gradient(apart)
        error = float(np.sqrt(shares @ apart**2 / shares.sum()))
        if nearby[best] == valve:
            break
        valve = nearby[best]
    return valve, error


def _times(valve: Valve, factor: float) -> Valve:
    return Valve(valve.backlash * factor, valve.stick * factor)


def _lean(fit: RowFit, column: int, valve: Valve, error: float) -> Array:
    """(size,) by how much a relative standard error of the band moves the plant behind the valve."""
    wider, narrower = (_behind(fit, column, _times(valve, float(np.exp(side)))) for side in (error, -error))
    return np.asarray((wider.theta - narrower.theta) / 2)


def _behind(fit: RowFit, column: int, valve: Valve) -> RowFit:
    """The fit with the positions of the valve's stem for its input."""
    pieces = []
    for piece in fit.row.pieces:
        inputs = piece.inputs.copy()
        inputs[column] = valve.positions(inputs[column])
        pieces.append(replace(piece, inputs=inputs))
    row = replace(fit.row, pieces=tuple(pieces))
    return fit_row(row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False)


@dataclass(frozen=True, eq=False)
class _Effect:
    """What a valve does to the fit of one output, the plant renewed to first order."""

    evidence: float
    """Log of the ratio of likelihoods, beside what else could explain the errors as far as the record needs that."""
    beyond: float
    """What it gains in -2 log likelihood where all else that could explain the errors is there."""
    shift: Array
    """(size,) by how much the plant's parameters would be larger."""


class _Test:
    """The prediction errors of one output, ready for what valves in one of its inputs would change.

    `recorded` has OP as it was recorded; `fit` may stand on the positions of a stem already. The distances from the
    model are errors besides: behind a wide band a plant beyond all bounds would be as likely to first order.
    """

    def __init__(self, fit: RowFit, column: int, recorded: Row) -> None:
        self._fit, self._column = fit, column
        self._m = next(m for m, spec in enumerate(fit.row.specs) if spec.column == column)
        every = zip(fit.row.pieces, recorded.pieces, Whitening.of(fit), strict=True)
        self._parts = [(piece, raw.inputs[column], of_piece) for piece, raw, of_piece in every if of_piece is not None]
        self._free = np.concatenate([fit.free, np.ones(fit.ar.size, dtype=bool)])
        distances, slopes = np.sqrt(fit.variance) * np.array(fit.row.prior.errors(fit.theta))
        prior = np.diag(np.append(slopes, np.zeros(fit.ar.size)))[self._free, : fit.theta.size]
        jacobian = np.hstack([*(whitening.jacobian[self._free] for _, _, whitening in self._parts), prior]).T
        others = [whitening(_rivals(fit, self._m, piece)) for piece, _, whitening in self._parts]
        rivals = np.hstack([*others, np.zeros((len(others[0]), fit.theta.size))]).T
        self._errors = np.concatenate([*(whitening.errors for _, _, whitening in self._parts), distances])
        size = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
        size[size == 0] = 1.0
        self._renewed = np.linalg.pinv(jacobian / size, rcond=levels.LOST) / size[:, None]
        self._plant = orthonormal(jacobian)
        self._all = orthonormal(np.hstack([jacobian, rivals]))
        more = self._all.shape[1] - self._plant.shape[1]
        gained = fit.left * np.log(_left(self._errors, self._plant) / _left(self._errors, self._all))
        # log odds that what else could explain the errors is needed, by the Bayesian criterion
        self._needed = (gained - more * np.log(self._errors.size)) / 2

    def of(self, valve: Valve) -> _Effect:
        changes = []
        for piece, op, whitening in self._parts:
            moved = valve.positions(op) - piece.inputs[self._column]
            changed = _element_response(self._fit, self._m, piece, moved)
            changes.append(whitening(changed[None])[0])
        changed = np.concatenate([*changes, np.zeros(self._fit.theta.size)])
        shift = np.zeros(self._free.size)
        shift[self._free] = self._renewed @ changed
        alone, beyond = (self._gain(basis, changed) for basis in (self._plant, self._all))
        evidence = np.logaddexp(alone / 2, self._needed + beyond / 2) - np.logaddexp(0.0, self._needed)
        return _Effect(float(evidence), beyond, shift[: self._fit.theta.size])

    def _gain(self, basis: Array, changed: Array) -> float:
        """What -2 log likelihood gains by the change (n,) of the errors, where a basis (n, k) explains what it can."""
        left = _left(self._errors, basis) / _left(self._errors - changed, basis)
        return float(self._fit.left * np.log(left))


def _left(e: Array, basis: Array) -> float:
    """Sum of squares that a basis (n, k) leaves of errors e (n,)."""
    rest = e - basis @ (basis.T @ e)
    return max(float(rest @ rest), 1e-300)


def _element_response(fit: RowFit, m: int, piece: Piece, u: Array) -> Array:
    """Response (n,) of element m to u (N,) at the strided samples."""
    row = fit.row
    spec, part = row.specs[m], row.slices[m]
    return spec.structure.response(fit.theta[part], u, piece.h, piece.hold[spec.column], row.stride)


def _rivals(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_rivals, n) what else could explain the errors: a gain that varies with OP, another structure."""
    op = piece.inputs[fit.row.specs[m].column]
    squared = _element_response(fit, m, piece, (op - op.mean()) ** 2)
    return np.vstack([squared, _beyond(fit, m, piece)])


def _beyond(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_directions, n) what a structure richer than that of element m adds to its response, to first order."""
    row, spec = fit.row, fit.row.specs[m]
    answer = _element_response(fit, m, piece, piece.inputs[spec.column])
    step = row.stride * piece.h
    faster = np.gradient(answer, step)
    directions = [faster, np.gradient(faster, step)]
    own = spec.structure.lag(fit.theta[row.slices[m]])
    longest = max(of.span for of in row.pieces) / levels.SLOW_SPANS
    for times in levels.RICHER_LAGS:
        pole = float(np.exp(-step / np.clip(times * own, step, max(longest, step))))
        directions.append(np.asarray(lfilter([1 - pole], [1.0, -pole], answer)))
    return np.array(directions)


def behind_valves(segments: Sequence[Segment], valves: Mapping[int, FoundValve]) -> tuple[Segment, ...]:
    """The segments with the positions of their stems for OP, from where on these are known.

    Where a stem stood at the beginning of a record, or after a gap, is not known until OP has moved through its band.
    """
    moved = []
    for segment in segments:
        u, first = segment.u.copy(), 0
        for column, found in valves.items():
            op = segment.u[:, column]
            u[:, column] = found.valve.positions(op)
            travel = np.maximum.accumulate(op) - np.minimum.accumulate(op)
            first = max(first, int(np.argmax(travel > found.band)) if travel[-1] > found.band else 0)
        moved.append(replace(segment, u=u).part(first))
    return tuple(moved)
