"""The last gate: an estimate that predicts worse than the model it is to replace is not given.

Prediction errors of both are compared: differences of their squares, experiment by experiment, and on data that took
no part in an estimate (Diebold and Mariano 1995). Each side gets the starts, offsets and noise coefficients that suit
it best, at the order that was answered. Under the noise model of the answer, coefficients and all, a wrong estimate
would be its own judge: that noise model was fitted to what the wrong plant leaves, takes it out, and amplifies the
white errors of the right one. Both sides predict the same samples of PV one step ahead, so that their errors compare,
whatever noise model made them; and at one order neither is the more flexible.

Integrating elements need nothing of their own: free simulation would add up what a disturbance does from the first
sample on, prediction errors do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.between_experiments import kinds_of, sizes_of
from trueplant.identify.estimate import fit_noise
from trueplant.identify.fit import RowFit, fit_row, linearised, residuals
from trueplant.identify.output import OutputEstimate
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row, Spec
from trueplant.lti.structure import structure_of
from trueplant.lti.transfer import TransferMatrix


@dataclass(frozen=True)
class Worse:
    """Where an estimate predicts worse than the model, beyond chance."""

    experiment: int
    p_value: float
    """That the estimate is right: with the number of comparisons made over the whole plant in it."""
    ratio: float
    """Root mean square prediction error of the estimate over that of the model."""
    unseen: bool
    """Only without these data in the estimate?"""


@dataclass(frozen=True, eq=False)
class _Part:
    """Data on which both are compared, with what is claimed of the plant there."""

    experiment: int
    pieces: tuple[Piece, ...]
    theta: Array
    """(size,) the estimate."""
    covariance: Array
    """(size, size) how far it may be off the plant of these data."""
    unseen: bool = False


def worse_than_model(
    estimates: Mapping[int, OutputEstimate], model: TransferMatrix, level: float = levels.WORSE
) -> dict[int, Worse]:
    """The outputs whose estimate the model (n_y, n_u + n_d) out-predicts, familywise over all comparisons made.

    An output of which the model says nothing has nothing to be compared with.
    """
    compared = {}
    for i, estimate in estimates.items():
        theirs = _model_row(estimate.row, model, i)
        if theirs is not None:
            compared[i] = [(part, *_compared(estimate, part, *theirs)) for part in _parts(estimate)]
    tests = sum(len(parts) for parts in compared.values())
    found = {}
    for i, parts in compared.items():
        part, p, ratio = min(parts, key=lambda one: one[1])
        if p * tests < level:
            found[i] = Worse(part.experiment, p * tests, ratio, part.unseen)
    return found


def _model_row(row: Row, model: TransferMatrix, output: int) -> tuple[Row, Array] | None:
    """The model's own elements in the place of those estimated, with their parameters; None where it has none."""
    known = [
        (spec.column, *structure_of(model[output, spec.column]))
        for spec in row.specs
        if not model[output, spec.column].is_zero
    ]
    if not known:
        return None
    theta = np.concatenate([values for _, _, values in known])
    own = replace(row, specs=tuple(Spec(j, structure) for j, structure, _ in known))
    return own, np.clip(theta, *own.bounds())


def _parts(estimate: OutputEstimate) -> list[_Part]:
    """Each experiment, and the data that the validation kept back."""
    pieces, runs = estimate.row.pieces, estimate.runs
    # One run may differ from the mean of the runs by as much as was found between them.
    spread = 0.0 if runs is None else runs.spread[kinds_of(estimate.fit)] * sizes_of(estimate.fit)
    between = np.diag(np.broadcast_to(np.square(spread), estimate.theta.shape))
    parts = [
        _Part(k, tuple(p for p in pieces if p.experiment == k), estimate.theta, estimate.covariance + between)
        for k in sorted({p.experiment for p in pieces})
    ]
    held = estimate.validation
    if held is not None:
        trained = held.trained
        covariance = trained.covariance + estimate.covariance + between
        parts.append(_Part(held.pieces[0].experiment, held.pieces, trained.theta, covariance, unseen=True))
    return parts


def _compared(estimate: OutputEstimate, part: _Part, row: Row, model: Array) -> tuple[float, float]:
    """The p-value that the estimate is right on a part, and the ratio of the rms prediction errors."""
    # both without the samples that answer to what either of them has not seen of OP
    own = replace(estimate.row, pieces=part.pieces).without_unseen(part.theta)
    row = replace(row, pieces=own.pieces).without_unseen(model)
    own = replace(own, pieces=row.pieces)
    order = estimate.fit.ar.size
    ours, theirs = _fairest(own, part.theta, order), _fairest(row, model, order)
    return _p_value(_errors(ours), _errors(theirs), _leeway(ours, part.covariance), order + 1)


def _fairest(row: Row, theta: Array, order: int) -> RowFit:
    """A plant with the starts, offsets and noise coefficients that suit it best."""
    fixed = np.zeros(theta.size, dtype=bool)
    plain = fit_row(row, theta, np.zeros(0), free=fixed)
    return fit_row(row, theta, fit_noise(plain, order, order), weights=plain.weights, free=fixed)


def _errors(fit: RowFit) -> list[Array]:
    """Prediction errors of each piece, at all of its samples: NaN where there are none."""
    return [e for _, e, _ in residuals(fit)]


def _leeway(fit: RowFit, covariance: Array) -> tuple[float, float]:
    """Mean and variance of the squares that errors of the answered size (covariance (size, size)) of theta add."""
    size = fit.theta.size
    moved = [part.jacobian[:size] for part in linearised(fit.row, fit.theta, fit.ar, np.ones(fit.weights.size))]
    share = np.asarray(sum((j @ j.T for j in moved), np.zeros((size, size)))) @ covariance
    return float(np.trace(share)), float(2 * np.sum(share * share.T))


def _p_value(
    ours: Sequence[Array], theirs: Sequence[Array], leeway: tuple[float, float], block: int
) -> tuple[float, float]:
    """One-sided p-value that the first prediction errors are no larger than the second but for chance.

    Chance is noise, and the errors that the estimate owns up to. Where the other side is right, its errors x are
    innovations, unrelated to how far the two predictions are apart, delta, and x'x rises by 2 x'delta + delta'delta:
    the variance of that is four times that of x'delta, from blocks (as long as the noise model's memory), and not that
    of the moves which made delta large here and small there. Degrees of freedom are those of the blocks, weighted by
    what they say (Satterthwaite).
    """
    gain, noise, said = 0.0, [], []
    squares = np.zeros(2)
    for one, other in zip(ours, theirs, strict=True):
        both = np.isfinite(one) & np.isfinite(other)
        e, x = np.where(both, one, 0.0), np.where(both, other, 0.0)
        starts = np.arange(0, e.size, block)
        gain += float(e @ e - x @ x)
        squares += e @ e, x @ x
        noise.append(np.add.reduceat(x * (e - x), starts))
        said.append(np.add.reduceat((e - x) ** 2, starts))
    weights, sums = np.concatenate(said), np.concatenate(noise)
    ratio = float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 1.0
    variance = 4 * float(sums @ sums) + leeway[1]
    if gain <= leeway[0] or variance <= 0:
        return 1.0, ratio
    freedom = float(np.sum(weights) ** 2 / np.sum(weights**2))
    return float(t.sf((gain - leeway[0]) / np.sqrt(variance), freedom)), ratio
