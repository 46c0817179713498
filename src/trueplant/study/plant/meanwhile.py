"""What changed between stretches of the same data: the plant, the noise, or both; each said only against the other."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from trueplant.detect import Moved, TwoFits, likeliest_change
from trueplant.identify import OutputEstimate, RowFit, cost_of_loads
from trueplant.result import Code, Reason
from trueplant.study import levels
from trueplant.study.study import Study

Run = tuple[int, int]
"""An output in an experiment."""


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two stretches of one output whose noise is compared."""

    output: int
    name: str
    """Of the later one."""
    fit: RowFit
    border: int
    """The first sample of the later one, over all pieces of `fit` on end."""


def changed_meanwhile(
    study: Study, estimates: Mapping[int, OutputEstimate], level: float, instead: Collection[Run] = ()
) -> list[Reason]:
    """Disturbances and plants that were not the same throughout; each kind at `level` over the whole study.

    `instead`: where a plant that moved was found likelier than loads (`moved_instead`).
    """
    # without a noise model a record is free of noise, and what is left of it is rounding
    estimates = {i: estimate for i, estimate in estimates.items() if estimate.fit.ar.size}
    experiments = {i: _experiments(estimate.fit) for i, estimate in estimates.items()}
    pairs = [pair for i, estimate in estimates.items() for pair in _pairs(study, i, estimate, experiments[i])]
    runs = [(i, fit) for i, own in experiments.items() for _, fit in own]
    likeliest = cache(likeliest_change)  # of one experiment both questions ask for the same
    causes = [_disturbance(study, pair, likeliest(pair.fit), level / len(pairs)) for pair in pairs]
    causes += [_moved(study, i, estimates[i], likeliest(fit), level / len(runs), instead) for i, fit in runs]
    return [cause for cause in causes if cause is not None]


def moved_instead(loaded: Mapping[int, RowFit], plain: Mapping[int, RowFit]) -> frozenset[Run]:
    """Where plants moved once, if that is likelier than that loads stepped which nobody recorded; else nowhere.

    A plant that moved looks like a load at each move of OP that follows. Both are judged by Schwarz's criterion, on the
    same stretches with a noise of its own for each. `plain` are the fits without loads, by output.
    """
    with_loads, with_moves, found = cost_of_loads(loaded), 0.0, set()
    for i, whole in plain.items():
        for k, fit in _experiments(whole) if whole.ar.size else ():
            coarse = likeliest_change(fit)
            if coarse is None:
                return frozenset()
            change, other = coarse.refined(), _part(loaded[i], [k])
            still, stepped, each = change.beside(fit), change.beside(other), np.log(fit.count)
            if still is None or stepped is None:
                return frozenset()
            with_loads += stepped.deviance(fit.variance) + other.free.sum() * each
            one = still.deviance(fit.variance)
            two = change.sides.deviance(fit.variance) + fit.free.sum() * each + 2 * np.log(change.tried)
            with_moves += min(one, two) + fit.free.sum() * each
            found |= {(i, k)} if two < one else set()
    return frozenset(found) if with_moves < with_loads else frozenset()


def _experiments(fit: RowFit) -> list[tuple[int, RowFit]]:
    """The experiments with their pieces, at the plant of all of them."""
    return [(k, _part(fit, [k])) for k in sorted({piece.experiment for piece in fit.row.pieces})]


def _part(fit: RowFit, experiments: list[int]) -> RowFit:
    """A fit with the pieces of some experiments alone, in this order."""
    kept = [n for k in experiments for n, piece in enumerate(fit.row.pieces) if piece.experiment == k]
    row = replace(fit.row, pieces=tuple(fit.row.pieces[n] for n in kept))
    return replace(fit, row=row, weights=fit.weights[kept])


def _pairs(
    study: Study, i: int, estimate: OutputEstimate, experiments: Sequence[tuple[int, RowFit]]
) -> Iterator[_Pair]:
    """Each later experiment beside the first that can be compared; of one experiment its halves.

    What interpolation between odd instants makes of the noise is no change of it.
    """
    odd = {segment.experiment for segment in study.segments if segment.stamps is not None}
    experiments = [(k, fit) for k, fit in experiments if k not in odd]
    if not experiments:
        return
    (first, own), *later = experiments
    if not later:
        yield _Pair(i, "second half", own, own.row.middle)
    border = sum(piece.y.size for piece in own.row.pieces)
    for k, _ in later:
        both = _part(estimate.fit, [first, k])
        yield _Pair(i, study.project.experiments[k].name, both, border)


def _disturbance(study: Study, pair: _Pair, moved: Moved | None, level: float) -> Reason | None:
    """The noise of the later stretch is another one, whatever the plant did meanwhile.

    The rival explanation is a plant that moved, at the instant that suits it best: each stretch is compared with what
    lies on one side of that instant.
    """
    if moved is None:
        return None
    found = _compared(pair, moved)
    if found is not None and found.noise_p < level:
        found = _compared(pair, moved.refined())
    if found is None or not found.noise_p < level or not found.explained:
        return None
    (std, now), (correlation, after) = found.std, found.correlation
    message = (
        f"the disturbance has changed: its standard deviation was {std:.3g} and is {now:.3g} here, its correlation "
        f"from one sample to the next was {correlation:.2g} and is {after:.2g} (p = {found.noise_p:.1g}, with a plant "
        "of its own for each stretch). That by itself is no mismatch"
    )
    return Reason(Code.CAUSE_DISTURBANCE, message, f"{study.project.output_names[pair.output]}, {pair.name}")


def _compared(pair: _Pair, moved: Moved) -> TwoFits | None:
    total = sum(piece.y.size for piece in pair.fit.row.pieces)
    stretches = moved.stretch(0, pair.border), moved.stretch(pair.border, total)
    if min(sum(int(np.sum(piece.valid)) for piece in pieces) for pieces in stretches) < levels.FEWEST_ERRORS:
        return None
    return TwoFits.of(pair.fit, *stretches)


def _moved(
    study: Study, i: int, estimate: OutputEstimate, moved: Moved | None, level: float, instead: Collection[Run]
) -> Reason | None:
    """The plant of an experiment was not the same before and after some instant, whatever the noise did."""
    if moved is None:
        return None
    p, k = moved.p_value(study.project.analysis.confidence), moved.fit.row.pieces[0].experiment
    if p < level:
        tested = f"(p = {p:.1g}, with a noise of its own for each)"
    elif (i, k) in instead:
        tested = "(likelier than that something stepped at moves after it which nobody recorded)"
    else:
        return None
    when = study.screened[k].record.calendar.text(moved.refined().time)
    suits = f"one plant suits it best until about {when}, and another from then on {tested}"
    message = (
        f"{suits}: the plant has moved meanwhile, or its structure is too simple here, and what comes nearest to it "
        "differs from move to move; `trueplant track` shows which stretches differ"
        if estimate.undermodelled or estimate.kept
        else f"the plant was not the same throughout the record: {suits}. What is given for it here lies between the "
        "two; `trueplant track` says what has changed and since when"
    )
    return Reason(
        Code.CAUSE_MOVED_MEANWHILE, message, f"{study.project.output_names[i]}, {study.project.experiments[k].name}"
    )
