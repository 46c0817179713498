"""Load steps: instants from which on something nobody recorded acts like an input, found from all outputs together.

A load that steps at the plant's input moves PV as a step of OP would. An autoregression that has to make up for it
takes noise for slow that is not, and a plant that explains how the controller answered it is a wrong one. Loads are
looked for one after the other, each where a step of an input explains most of what the prediction errors have left
over, and stay as long as they explain more than chance would over all inputs and instants. Beside a plant that explains
loads as well they are not found: the search begins at the model too, and the likeliest of all is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import most_moved
from trueplant.identify.estimate import free_of_noise, polished, with_own_noise
from trueplant.identify.fit import RowFit, fit_row, linearised
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.load_gains import likeliest_load
from trueplant.identify.longest_noise import beside_longest_noise
from trueplant.identify.noise import whiten
from trueplant.identify.row import Row
from trueplant.record.types import Load, Segment

Fits = Mapping[int, RowFit]
"""By output."""
Place = tuple[int, Load]
"""Experiment, and a load in it."""


def find_loads(fits: Fits) -> Fits:
    """Likelier fits that take load steps along; none where no load was found besides those they have.

    Long records, of which only a part is searched, and outputs without noise are left as they are.
    """
    own = _noisy(fits)
    if not own or any(most_moved(fit.row) is not fit.row for fit in own.values()):
        return {}
    found = []
    for start in (own, {i: _model(fit) for i, fit in own.items()}):
        loaded = _settled(start)
        if _places(loaded) != _places(own):
            freed = {i: _refitted(replace(fit, free=own[i].free), fit.row) for i, fit in loaded.items()}
            found.append(_needed(_beside_longest_noise(_settled(freed))))
    if not found:
        return {}
    best = min([_beside_longest_noise(own), *found], key=_criterion)
    return {i: polished(fit) for i, fit in best.items()} if _places(best) != _places(own) else {}


def criterion(fits: Fits) -> float:
    """How unlikely fits are, with or without loads and whatever their structures, beside the largest noise models.

    Outputs without noise are left out, as they are by `find_loads`.
    """
    return _criterion(_beside_longest_noise(_noisy(fits)))


def cost_of_loads(fits: Fits) -> float:
    """What all loads of some fits gain in -2 log likelihood by chance."""
    return sum(_cost(fits, place) for place in _places(fits))


def with_loads(segments: Sequence[Segment], fits: Fits) -> tuple[Segment, ...]:
    """The segments with the loads that were found."""
    places = _places(fits)
    return tuple(
        replace(segment, loads=tuple(load for experiment, load in places if experiment == segment.experiment))
        for segment in segments
    )


@dataclass(frozen=True)
class FoundLoad:
    """A step that nobody recorded."""

    experiment: int
    load: Load
    size: float
    """In the unit of the input that it acts like."""
    error: float
    """Standard error of the size, the plant's in it."""


def found_loads(fits: Fits) -> list[FoundLoad]:
    """The loads of some fits with their sizes, over all outputs that they reach, in order of time."""
    told: dict[Place, list[tuple[float, float]]] = {}
    for fit in fits.values():
        for part in linearised(fit.row, fit.theta, fit.ar, fit.weights):
            k, loads = part.number, fit.row.loads(part.number)
            if not loads:
                continue
            unknown = fit.row.unknown(fit.theta, k).columns
            y, valid = fit.row.measured(k)
            output = np.where(valid, y - fit.row.response(fit.theta, k), 0.0)
            columns = fit.weights[k] * np.column_stack([whiten(fit.ar, unknown)[part.use], -part.jacobian.T])
            weights = np.linalg.lstsq(columns, fit.weights[k] * whiten(fit.ar, output)[part.use], rcond=1e-10)[0]
            variances = fit.variance * np.diag(inverse(columns.T @ columns))
            first = unknown.shape[1] - len(loads)
            for n, (load, _) in enumerate(loads, start=first):
                experiment = fit.row.pieces[k].experiment
                told.setdefault((experiment, load), []).append((float(weights[n]), float(variances[n])))
    return [_weighed(place, np.array(told[place])) for place in sorted(told)]


def _weighed(place: Place, sizes: Array) -> FoundLoad:
    """One load from sizes and their variances (n, 2)."""
    shares = 1 / sizes[:, 1]
    return FoundLoad(*place, float(shares @ sizes[:, 0] / shares.sum()), float(shares.sum() ** -0.5))


def _noisy(fits: Fits) -> Fits:
    return {i: fit for i, fit in fits.items() if not free_of_noise(fit)}


def _model(fit: RowFit) -> RowFit:
    """The model with the noise that it leaves; the fit itself where there is no model of an element."""
    if any(spec.initial is None for spec in fit.row.specs):
        return fit
    model = np.concatenate([np.array(spec.initial, dtype=float) for spec in fit.row.specs])
    held = replace(fit, theta=np.clip(model, *fit.row.bounds()), free=np.zeros(model.size, dtype=bool))
    return _renewed(_refitted(held, fit.row))


def _settled(fits: Fits) -> Fits:
    """Loads and noise models in turn: all that are found, each where it explains most beside the others, if it does."""
    for _ in range(levels.LOAD_ROUNDS):
        before = _places(fits)
        fits = _more(fits)
        for place in before:
            fits = _moved(fits, place)
        if _places(fits) == before:
            break
        fits = {i: _renewed(fit) for i, fit in fits.items()}
    return fits


def _more(fits: Fits) -> Fits:
    """The fits with further loads, as long as they gain beyond chance."""
    most = max(fit.count for fit in fits.values()) // levels.SAMPLES_PER_LOAD
    while len(_places(fits)) < most:
        place = _likeliest(fits)
        if place is None:
            break
        other = _with(fits, place)
        if _rise(other, fits) < _cost(fits, place):
            break
        fits = other
    return fits


def _moved(fits: Fits, place: Place) -> Fits:
    """The fits with one load where it explains most, or without it."""
    without = _without(fits, place)
    other = _likeliest(without)
    if other is not None and other != place:
        moved = _with(without, other)
        fits, place = (moved, other) if _rise(moved, fits) > 0 else (fits, place)
    return fits if _rise(fits, without) > _cost(fits, place) else without


def _likeliest(fits: Fits) -> Place | None:
    found = likeliest_load(fits, _chance(fits, 1))
    return None if found is None else (found.experiment, found.load)


def _refitted(fit: RowFit, row: Row) -> RowFit:
    short, near = levels.TRIED_STEPS, levels.TRIED_SETTLED
    return fit_row(
        row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False, iterations=short, settled=near
    )


def _renewed(fit: RowFit) -> RowFit:
    return with_own_noise(fit, levels.TRIED_STEPS)


def _places(fits: Fits) -> list[Place]:
    """All loads that step within the data, in order of time."""
    rows = [fit.row for fit in fits.values()]
    return sorted({(piece.experiment, load) for row in rows for piece in row.pieces for load in piece.stepping})


def _reached(fits: Fits, place: Place) -> list[int]:
    """The outputs that a load can reach."""
    return [i for i, fit in fits.items() if any(spec.column == place[1].column for spec in fit.row.specs)]


def _with(fits: Fits, place: Place) -> Fits:
    return {**fits, **{i: _refitted(fits[i], loaded(fits[i].row, place)) for i in _reached(fits, place)}}


def loaded(row: Row, place: Place) -> Row:
    """The row with one load more."""
    experiment, load = place
    pieces = (
        replace(piece, loads=(*piece.loads, load)) if piece.experiment == experiment else piece for piece in row.pieces
    )
    return replace(row, pieces=tuple(pieces))


def _without(fits: Fits, place: Place) -> Fits:
    """The fits without one load."""
    experiment, load = place
    out = dict(fits)
    for i in _reached(fits, place):
        pieces = (
            replace(piece, loads=tuple(own for own in piece.loads if piece.experiment != experiment or own != load))
            for piece in fits[i].row.pieces
        )
        out[i] = _refitted(fits[i], replace(fits[i].row, pieces=tuple(pieces)))
    return out


def _rise(fits: Fits, others: Fits) -> float:
    """By how much -2 log likelihood rises from some fits to others."""
    return sum(fit.left * float(np.log(max(others[i].cost, 1e-300) / max(fit.cost, 1e-300))) for i, fit in fits.items())


def _cost(fits: Fits, place: Place) -> float:
    return _chance(fits, len(_reached(fits, place)))


def _chance(fits: Fits, sizes: int) -> float:
    """What a load of so many sizes gains in -2 log likelihood by chance, over all inputs and samples, in LOAD_STEP of
    records."""
    columns = {spec.column for fit in fits.values() for spec in fit.row.specs}
    tried = max(fit.count for fit in fits.values()) * len(columns)
    return float(chi2.isf(levels.LOAD_STEP / max(tried, 1), sizes))


def _beside_longest_noise(fits: Fits) -> Fits:
    return {i: beside_longest_noise(fit) for i, fit in fits.items()}


def _needed(fits: Fits) -> Fits:
    """The fits without the loads that gain no more than chance."""
    for place in _places(fits):
        without = _without(fits, place)
        fits = without if _rise(fits, without) < _cost(fits, place) else fits
    return fits


def _criterion(fits: Fits) -> float:
    """-2 log likelihood, and what loads and parameters cost (Schwarz 1978)."""
    deviance = 0.0
    for fit in fits.values():
        deviance += fit.left * float(np.log(max(fit.cost, 1e-300) / max(fit.count, 1)))
        deviance += int(fit.free.sum()) * float(np.log(max(fit.count, 1)))
    return deviance + cost_of_loads(fits)
