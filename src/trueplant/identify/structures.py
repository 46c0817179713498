"""Structures that are too simple for what the record shows, and the simplest richer one that is not.

Each element is fitted with a structure that describes all next richer ones, and the likelihood ratio says whether its
own suffices. Where it does not, the richer ones are fitted one by one, and the simplest of them that none of the others
rejects is taken. All of them have noise models of their own: what a structure lacks is in its noise model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.covariance import small_samples
from trueplant.identify.estimate import free_of_noise, polished, with_own_noise
from trueplant.identify.fit import RowFit, evaluate, fit_row
from trueplant.identify.further_lag import with_further_lags
from trueplant.identify.kept_structures import with_richer
from trueplant.identify.likelihood import ratio_p, with_element, with_parameters
from trueplant.identify.longest_noise import beside_longest_noise, restricted
from trueplant.identify.output import OutputEstimate, Rejected
from trueplant.identify.row import Row, Spec
from trueplant.identify.search import improved_element
from trueplant.identify.validate import residual_tests
from trueplant.lti.structure import Structure, translated

Again = Callable[[Sequence[Spec]], OutputEstimate | None]
"""Estimates the row with other elements."""

Starts = Callable[[Array, float], Sequence[Array]]
"""Parameters of another structure to begin from, by those of an element and its time scale."""


def with_structures(
    estimate: OutputEstimate,
    again: Again,
    tested: int,
    confidence: float,
    pinned: Collection[int] = (),
) -> OutputEstimate:
    """The estimate, with richer structures for those elements whose own ones the record rejects.

    Those in the `pinned` columns keep theirs. They are no surer than richer ones would be (`kept_structures`), nor are
    those of which the record leaves open whether they suffice.

    Structures that were rejected before stay so, and those in their places are asked like any that took one.

    `again` estimates the row with other elements. `tested` is the number of elements of the whole matrix; the chance
    over all of them that a structure that suffices is rejected is STRUCTURE_SHARE of 1 - confidence. It is left open
    where at 1 - confidence each would be.
    """
    strict, usual = levels.STRUCTURE_SHARE * (1 - confidence) / tested, 1 - confidence
    columns = [spec.column for spec in estimate.row.specs]
    asked = {j: usual if j in estimate.rejected else strict for j in columns if j not in pinned}
    estimate, p = _replaced(estimate, again, asked, tested, confidence, set(estimate.rejected))
    whole = np.ones(estimate.row.pieces[0].inputs.shape[0])
    whole[columns] = p
    estimate = replace(estimate, structure_p=whole)
    kept = {j: strict for j in columns if j in pinned and whole[j] < strict}
    open_ones = {j: usual for j in columns if j not in pinned and j not in estimate.rejected and whole[j] < usual}
    doubted = kept | open_ones
    if not doubted:
        return estimate
    richer, _ = _replaced(estimate, again, doubted, tested, confidence)
    return replace(with_richer(estimate, richer, confidence), kept=tuple(kept))


def _replaced(
    estimate: OutputEstimate,
    again: Again,
    level: dict[int, float],
    tested: int,
    confidence: float,
    before: Collection[int] = (),
) -> tuple[OutputEstimate, Array]:
    """The estimate with richer structures where they are rejected at the `level` of their column, and p-values of all.

    Those in the columns `before` are so already. One that has taken the place of another was said by nobody: whether it
    suffices is asked at 1 - confidence, and where it does, it counts what it leaves open (`further_lag`).
    """
    level, replaced = dict(level), set(before)
    fit = polished(of_a_part(estimate.fit))
    p = sufficient_p(fit, confidence)
    left = {m for m, spec in enumerate(estimate.row.specs) if spec.column in level}
    while left:
        m = min(left, key=lambda one: float(p[one]))
        old = estimate.row.specs[m]
        found = simplest(fit, m, confidence, level[old.column]) if p[m] < level[old.column] else None
        wider = found and again([_wider(old, *found) if spec is old else spec for spec in estimate.row.specs])
        if not wider:
            left.remove(m)
            continue
        level[old.column] = 1 - confidence
        replaced.add(old.column)
        rejected = Rejected(old.structure, min(float(p[m]) * tested, 1.0))
        estimate = replace(wider, rejected={old.column: rejected, **estimate.rejected})
        # What this element lacked, the others of its row may have taken on.
        fit = polished(of_a_part(estimate.fit))
        p = sufficient_p(fit, confidence)
    return with_further_lags(estimate, replaced, confidence), p


def _wider(spec: Spec, structure: Structure, guess: Array) -> Spec:
    """The element with another structure: of the model's parameters only gains still mean the same."""
    initial = None if spec.initial is None else translated(spec.structure, np.array(spec.initial), structure)
    same = structure.is_gain & (structure.integrators == spec.structure.integrators)
    undeclared = tuple(int(k) for k in np.flatnonzero(~same))
    return Spec(spec.column, structure, initial, undeclared, tuple(float(x) for x in guess))


def sufficient_p(fit: RowFit, confidence: float) -> Array:
    """(n_specs,) p-values that the structure of each element suffices.

    By the likelihood ratio against a structure with one lag and one lead more, which may have a complex pair; of one
    that answers at once, with one lag more.
    """
    if free_of_noise(fit):
        return np.ones(len(fit.row.specs))
    return np.array([_sufficient_p(fit, m, confidence) for m in range(len(fit.row.specs))])


def _sufficient_p(fit: RowFit, m: int, confidence: float) -> float:
    structure = fit.row.specs[m].structure
    if not any(np.any(piece.inputs[fit.row.specs[m].column]) for piece in fit.row.pieces):
        return 1.0
    if structure.relative_degree == 0:
        wanted = replace(structure, lags=structure.lags + 1)
    elif structure.lags:
        wanted = replace(structure, lags=structure.lags - 1, pairs=structure.pairs + 1, leads=structure.leads + 1)
    else:
        wanted = replace(structure, lags=1, leads=structure.leads + 1)

    def starts(p: Array, scale: float, shares: Sequence[float] = levels.SECOND_LAGS) -> Sequence[Array]:
        lags = np.sort(p[structure.is_lag])
        if wanted.pairs > structure.pairs:
            pairs = [_pair(lags[-1], share * scale) for share in shares]
            return [_start(structure, p, wanted, scale, lags[:-1], pair) for pair in pairs]
        return [_start(structure, p, wanted, scale, np.append(lags, share * scale)) for share in shares]

    rivals = [_fitted(fit, m, wanted, starts)]
    if _model_out_of_reach(fit, m) is not None:  # so far off, the richest may end beside what a simpler one finds
        simpler = replace(structure, lags=structure.lags + 1)
        rivals.append(_fitted(fit, m, simpler, partial(_starts, structure, simpler)))
    if wanted.leads > structure.leads:
        rivals.append(polished(_best(_from_cancelled(fit, m, wanted, partial(starts, shares=levels.CANCELLED_LAGS)))))
    return suffices_p(fit, _best(rivals), m, confidence)


def simplest(fit: RowFit, m: int, confidence: float, level: float) -> tuple[Structure, Array] | None:
    """The simplest richer structure of element m that none of the others rejects at this level, with its parameters.

    None where no richer structure is better beyond chance.
    """
    declared = fit.row.specs[m].structure
    tried = dict.fromkeys(structure for structure, _ in richer(declared, *_element(fit, m)))
    found = {one: _fitted(fit, m, one, partial(_starts, declared, one)) for one in tried}
    both = replace(declared, lags=declared.lags + 1, leads=declared.leads + 1)

    def including(p: Array, scale: float) -> Sequence[Array]:
        lags = [np.append(p[declared.is_lag], share * scale) for share in levels.CANCELLED_LAGS]
        return [_start(declared, p, both, scale, of) for of in lags]

    if both in found:
        found[both] = _best([found[both], polished(_best(_from_cancelled(fit, m, both, including)))])
    taken, best = declared, fit
    criterion = dict(zip(found, _criteria([*found.values()]), strict=True))
    # Real lags come before complex pairs: a pair that is damped enough describes two lags as well.
    for structure in sorted(found, key=lambda one: (len(one.names), one.pairs, criterion[one])):
        if len(found) * _ratio_p(best, found[structure], m, confidence) < level:
            taken, best = structure, found[structure]
    return None if taken is declared else with_real_lags(taken, best.theta[best.row.slices[m]])


def with_real_lags(structure: Structure, p: Array) -> tuple[Structure, Array]:
    """The same element, its complex pairs that do not swing as two lags each."""
    frequencies, dampings = p[structure.is_frequency], p[structure.is_damping]
    real = dampings >= 1
    root = np.sqrt(dampings[real] ** 2 - 1)
    lags = np.concatenate([(dampings[real] + side * root) / frequencies[real] for side in (1, -1)])
    same = replace(structure, lags=structure.lags + lags.size, pairs=structure.pairs - int(real.sum()))
    return same, same.parameters(
        p[structure.is_gain],
        np.append(p[structure.is_lag], lags),
        frequencies[~real],
        dampings[~real],
        p[structure.is_lead],
        p[structure.is_dead_time],
    )


def richer(structure: Structure, p: Array, scale: float) -> Iterator[tuple[Structure, Array]]:
    """Next richer structures with parameters to begin a search from, several of each, about this time scale.

    They differ in what a search over time scale, dead time, gain and leads does not find: the ratios of the lags, and
    the damping. None of them answers at once: those have no dead time that could be found.
    """
    lags = np.sort(p[structure.is_lag])
    for share in levels.SECOND_LAGS:
        wanted = replace(structure, lags=structure.lags + 1)
        yield wanted, _start(structure, p, wanted, scale, np.append(lags, share * scale))
        if structure.relative_degree == 0:
            continue
        wanted = replace(wanted, leads=structure.leads + 1)
        yield wanted, _start(structure, p, wanted, scale, np.append(lags, share * scale))
    if structure.integrators:
        wanted = replace(structure, lags=structure.lags + 1, integrators=structure.integrators - 1)
        for share in levels.CANCELLED_LAGS:
            start = _start(structure, p, wanted, scale, np.append(lags, share * scale))
            start[wanted.is_gain] *= share * scale
            yield wanted, start
    if structure.relative_degree > 1:
        wanted = replace(structure, leads=structure.leads + 1)
        yield wanted, _start(structure, p, wanted, scale, lags)
    if structure.lags:
        wanted = replace(structure, lags=max(structure.lags - 2, 0), pairs=structure.pairs + 1)
        for damping in levels.PAIR_DAMPINGS:
            yield wanted, _start(structure, p, wanted, scale, lags[: wanted.lags], (2 / scale, damping))
    if structure.lags and not structure.integrators and structure.relative_degree > 0:
        wanted = replace(structure, lags=structure.lags - 1, integrators=1)
        start = _start(structure, p, wanted, scale, lags[:-1])
        start[wanted.is_gain] /= lags[-1]
        yield wanted, start


def _starts(structure: Structure, wanted: Structure, p: Array, scale: float) -> Sequence[Array]:
    """Those of `richer` that are of the structure wanted."""
    return [start for other, start in richer(structure, p, scale) if other == wanted]


def time_scale(fit: RowFit, m: int) -> float:
    """How long element m takes to answer; of one that answers at once, what is guessed of one without a model."""
    return _element(fit, m)[1]


def _element(fit: RowFit, m: int) -> tuple[Array, float]:
    """Parameters of element m, and its time scale."""
    p = fit.theta[fit.row.slices[m]]
    return p, _time_scale(fit, m, p)


def _model_out_of_reach(fit: RowFit, m: int) -> tuple[Array, float] | None:
    """The same of its model; None where there is none, or a search from the element gets there."""
    initial, part = fit.row.specs[m].initial, fit.row.slices[m]
    if initial is None:
        return None
    low, high = fit.row.bounds()
    p = np.clip(initial, low[part], high[part])
    scale = _time_scale(fit, m, p)
    reached = levels.STRETCH.min() <= scale / time_scale(fit, m) <= levels.STRETCH.max()
    return None if reached else (p, scale)


def _time_scale(fit: RowFit, m: int, p: Array) -> float:
    structure = fit.row.specs[m].structure
    own = structure.lag(p) or structure.longest_dead_time(p)
    return own if own > 0 else fit.row.guessed_time_scale


def _pair(one: float, other: float) -> tuple[float, float]:
    """Natural frequency and damping ratio of two lags."""
    root = float(np.sqrt(one * other))
    return 1 / root, (one + other) / (2 * root)


def _start(
    structure: Structure, p: Array, wanted: Structure, scale: float, lags: Array, pair: tuple[float, ...] = ()
) -> Array:
    """Parameters of another structure, with these lags, and this natural frequency and damping ratio for a new pair."""
    leads = np.append(p[structure.is_lead], scale / 2)[: wanted.leads]
    frequencies, dampings = np.append(p[structure.is_frequency], pair[:1]), np.append(p[structure.is_damping], pair[1:])
    dead_times = structure.dead_times(p) if wanted.has_dead_time else 0.0
    return wanted.parameters(p[structure.is_gain], lags, frequencies, dampings, leads, dead_times)


def _fitted(fit: RowFit, m: int, structure: Structure, starts: Starts) -> RowFit:
    """The row with another structure for element m: the best of several fits, each begun from the best of the starts.

    Two begin at the element, with the noise model as it is and with none: what the structure lacked is in the first.
    Where the model is out of reach one more begins there, with none: an element may be a trace of OP in PV, beside a
    noise model that has the plant's answers.
    """
    row, free = with_element(fit, m, Spec(fit.row.specs[m].column, structure))

    def begun(ar: Array, of: tuple[Array, float]) -> Array:
        whole = (with_parameters(fit, m, start) for start in starts(*of))
        return max((improved_element(row, theta, ar, m) for theta in whole), key=lambda found: found[1])[0]

    def without_noise(theta: Array) -> RowFit:
        return with_own_noise(_short_fit(fit, row, free, theta, np.zeros(0)), levels.TRIED_STEPS)

    own, model = begun(fit.ar, _element(fit, m)), _model_out_of_reach(fit, m)
    found = polished(_best([_short_fit(fit, row, free, own, fit.ar), without_noise(own)]))
    return found if model is None else _best([found, polished(without_noise(begun(np.zeros(0), model)))])


def _briefly(fit: RowFit, m: int, structure: Structure, start: Array) -> RowFit:
    """A short fit of the row with another structure for element m, from this start, with the noise model as it is."""
    row, free = with_element(fit, m, Spec(fit.row.specs[m].column, structure))
    return _short_fit(fit, row, free, with_parameters(fit, m, start), fit.ar)


def _from_cancelled(fit: RowFit, m: int, wanted: Structure, starts: Starts) -> list[RowFit]:
    """Short fits of the row with a further lag and lead that cancel: they begin at the fit, and cannot end above it.

    `starts` have a further lag of each of CANCELLED_LAGS.
    """
    fits, (p, scale) = [], _element(fit, m)
    for share, begun in zip(levels.CANCELLED_LAGS, starts(p, scale), strict=True):
        begun[np.flatnonzero(wanted.is_lead)[-1]] = share * scale
        fits.append(_briefly(fit, m, wanted, begun))
    return fits


def _short_fit(fit: RowFit, row: Row, free: BoolArray, theta: Array, ar: Array) -> RowFit:
    begun, short = np.clip(theta, *row.bounds()), levels.TRIED_STEPS
    return fit_row(
        row, begun, ar, weights=fit.weights, free=free, reweight=False, iterations=short, settled=levels.TRIED_SETTLED
    )


def _best(fits: Sequence[RowFit]) -> RowFit:
    return fits[int(np.argmin(_criteria(fits)))]


def suffices_p(fit: RowFit, rival: RowFit, m: int, confidence: float) -> float:
    """p-value that the fit suffices beside a rival with another structure for element m.

    By the likelihood ratio, each with its own noise model; where that looks clear, with the largest as well, by the
    restricted likelihood of the richer one: what slow noise could explain counts there. Not where the model is out of
    reach, so that noise has to explain the plant's answers, and prediction errors follow the input all the same.
    """
    p = _ratio_p(fit, rival, m, confidence)
    if p > 1 - confidence:
        return p
    one = beside_longest_noise(fit)
    column, far = fit.row.specs[m].column, _model_out_of_reach(fit, m) is not None
    if far and residual_tests(one).cross_p[column] < levels.UNDERMODELLED:
        return p
    other = beside_longest_noise(rival)
    return max(p, _ratio_p(restricted(one, other), restricted(other), m, confidence))


def _ratio_p(fit: RowFit, rival: RowFit, m: int, confidence: float) -> float:
    one, other = _criteria([fit, rival])
    rise = fit.left * (one - other) / float(small_samples(rival, confidence)[rival.row.slices[m]].mean())
    return ratio_p(rise, _freedom(fit, rival))


def _freedom(fit: RowFit, rival: RowFit) -> int:
    """How many more parameters and initial states a rival has: states are free again after every gap."""
    more = int(rival.free.sum()) - int(fit.free.sum()) + rival.row.nuisance_count - fit.row.nuisance_count
    return max(more, 1)


def _criteria(fits: Sequence[RowFit]) -> list[float]:
    """-2 log likelihood of a sample, and its share of what the noise model costs (Schwarz 1978), of fits of one row.

    Over the samples that all of them can predict, and without the prior, as the rivals have none.
    """
    longest, found = max(fit.ar.size for fit in fits), []
    for fit in fits:
        # Longer by zeros: the same predictions, of those samples that the longest noise model can predict.
        point = evaluate(fit.row, fit.theta, np.append(fit.ar, np.zeros(longest - fit.ar.size)), fit.weights)
        deviance = np.log(max(float(point.power[:, 0].sum()), 1e-300) / max(point.count, 1))
        if fit.row.restricted is not None:
            deviance += fit.row.restricted.penalty(fit.ar)[0] / max(point.count, 1)
        found.append(float(deviance + np.log(max(point.count, 1)) / max(point.count, 1) * fit.ar.size))
    return found
