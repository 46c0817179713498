"""Which elements have changed: joint Wald tests with familywise control over the matrix.

The elements are tested jointly over the directions of their parameters that the record determines, and Holm's
procedure (1979) keeps the chance of a single false alarm in the whole matrix at the level asked for. Two gains that
cannot be told one by one may be known very well in sum. Within an element that has
changed, its parameters are tested one by one with Holm's procedure again: one is called changed where its own
familywise p-value and that of its element say so. An element may so have changed although it cannot be told in which
parameter. It is unchanged only where a change worth knowing would have been seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog
from scipy.stats import chi2, norm

from trueplant.arrays import Array, ComplexArray
from trueplant.detect import levels
from trueplant.identify.levels import STRUCTURE_SHARE
from trueplant.result.status import ElementVerdict


@dataclass(frozen=True, eq=False)
class Evidence:
    """One element as it goes into the tests. Vectors have one entry a parameter."""

    model: tuple[float | None, ...]
    """The model's values; None where the model has none to compare with."""
    plant: Array
    covariance: Array
    answered: tuple[bool, ...]
    """What may be judged by itself."""
    strictest: float | None = None
    """p-value of another test of the same question (likelihood ratio, absence), if there is one: the larger counts."""
    joint: Array | None = None
    """Covariance for the test of the whole element, if it is not the one that single parameters are judged by."""
    detectable: float = 0.0
    """The change that would just have been found, as a share (`detectable_change`)."""
    structure_p: float | None = None
    """p-value, over all elements, that the declared structure suffices; None where it is not rejected."""
    worth_knowing: Array | None = None
    """Change of each parameter that is worth knowing, 0 where it is not to be judged at all. Directions whose standard
    error is larger are left out of the test of the element. None: all that is answered is tested."""
    beside: Array | None = None
    """Covariance for Wald's test beside `strictest`, without what that test counts by itself; what is known is told by
    `joint`. None: `joint`."""

    @property
    def whole(self) -> Array:
        """(n, n) that the test of the whole element goes by."""
        return self.covariance if self.joint is None else self.joint


@dataclass(frozen=True)
class ParameterVerdict:
    p_value: float | None
    p_adjusted: float | None
    changed: bool | None
    """None where there is no model to have changed from."""


@dataclass(frozen=True)
class Verdict:
    """What is said of an element, with familywise p-values."""

    verdict: ElementVerdict
    p_adjusted: float | None
    parameters: tuple[ParameterVerdict, ...]
    detectable: float | None = None
    """The change that would just have been found, as a share; None where nothing was tested."""

    @property
    def lacks_power(self) -> bool:
        """Was it tested, without being able to find a change worth knowing?"""
        return self.verdict == ElementVerdict.NOT_IDENTIFIABLE and self.p_adjusted is not None


def holm(p_values: ArrayLike) -> Array:
    """Familywise p-values by Holm's step-down procedure."""
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p)
    factors = p.size - np.arange(p.size)
    adjusted = np.empty(p.size)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return adjusted


def level_of(confidence: float) -> float:
    """Of a false alarm by a parameter anywhere in the matrix; the rest is for structures."""
    return (1 - confidence) * (1 - STRUCTURE_SHARE)


@dataclass(frozen=True, eq=False)
class _Known:
    """What is known of an element, and so tested."""

    index: NDArray[np.intp]
    """The parameters that it is known in."""
    scale: Array
    directions: Array
    """(n, n_index) in units of `scale`."""
    shift: Array
    """(n_index,) of plant from model."""


def _known(evidence: Evidence) -> _Known | None:
    """The directions whose standard error is below what is worth knowing; None where there is none."""
    told = np.array([value is not None for value in evidence.model])
    if evidence.worth_knowing is None:
        index, largest = np.flatnonzero(told & evidence.answered), np.inf
        scale = np.sqrt(np.maximum(np.diag(evidence.whole)[index], levels.SMALLEST_VARIANCE))
    else:
        index, largest = np.flatnonzero(told & (evidence.worth_knowing > 0)), 1.0
        scale = evidence.worth_knowing[index]
    shift = evidence.plant[index] - np.array([evidence.model[k] for k in index], dtype=float)
    values, vectors = np.linalg.eigh(evidence.whole[np.ix_(index, index)] / np.outer(scale, scale))
    use = (values > levels.DEGENERATE * np.max(values, initial=0.0)) & (values <= largest)
    return _Known(index, scale, vectors[:, use].T, shift) if use.any() else None


def _joint_p(evidence: Evidence, known: _Known) -> float:
    """That the parameters all still have the model's values, as far as they are known."""
    rotated = known.directions @ (known.shift / known.scale)
    counted = (evidence.whole if evidence.beside is None else evidence.beside)[np.ix_(known.index, known.index)]
    within = known.directions @ (counted / np.outer(known.scale, known.scale)) @ known.directions.T
    wald = float(chi2.sf(rotated @ np.linalg.solve(within, rotated), rotated.size))
    return wald if evidence.strictest is None else max(wald, evidence.strictest)


def _is_beyond(evidence: Evidence, known: _Known, tolerance: float) -> bool:
    """Has the element moved by more than a share of the model's values, in what is known of it?

    It has not where some parameters that have not moved by more would look the same: two lags of which only the sum is
    known.
    """
    allowed = tolerance * np.abs([evidence.model[k] or 0.0 for k in known.index]) / known.scale
    moved = known.directions @ (known.shift / known.scale)
    ends = np.column_stack([-allowed, allowed])
    infeasible = 2
    return bool(linprog(np.zeros(allowed.size), A_eq=known.directions, b_eq=moved, bounds=ends).status == infeasible)


def judge(
    elements: Sequence[Evidence],
    confidence: float = 0.95,
    tolerance_percent: float = 0.0,
    worth_knowing: float = levels.WORTH_KNOWING,
) -> tuple[Verdict, ...]:
    """A verdict for each element, familywise over all of them.

    A change counts as one when it is significant and larger than `tolerance_percent` of the model's value. An element
    without one is unchanged if a change of `worth_knowing` (a share) would have been found, else not identifiable. One
    whose structure was rejected has changed; of the chance of a false alarm a share is left to that.
    """
    level = level_of(confidence)
    tested = [
        [k for k, (m, ok) in enumerate(zip(e.model, e.answered, strict=True)) if ok and m is not None] for e in elements
    ]
    known = [_known(e) for e in elements]
    adjusted = iter(holm([_joint_p(e, k) for e, k in zip(elements, known, strict=True) if k is not None]))
    familywise = [None if k is None else float(next(adjusted)) for k in known]
    tolerance = tolerance_percent / 100
    beyond = [
        k is not None and (not tolerance or _is_beyond(e, k, tolerance)) for e, k in zip(elements, known, strict=True)
    ]
    return tuple(
        _verdict(e, t, p, level, tolerance, b, worth_knowing)
        for e, t, p, b in zip(elements, tested, familywise, beyond, strict=True)
    )


def _verdict(
    evidence: Evidence,
    tested: Sequence[int],
    p_element: float | None,
    level: float,
    tolerance: float,
    beyond_tolerance: bool,
    worth_knowing: float,
) -> Verdict:
    none = ParameterVerdict(None, None, False)
    parameters = [none] * len(evidence.model)
    if p_element is None and evidence.structure_p is None:
        return Verdict(ElementVerdict.NOT_IDENTIFIABLE, None, tuple(parameters))
    if p_element is None:
        return Verdict(ElementVerdict.CHANGED, evidence.structure_p, tuple(parameters), evidence.detectable)
    shift = np.array([evidence.plant[k] - (evidence.model[k] or 0.0) for k in tested])
    sigma = np.sqrt(np.maximum(np.diag(evidence.covariance)[list(tested)], 1e-300))
    raw = 2 * norm.sf(np.abs(shift) / sigma)
    adjusted = np.maximum(holm(raw), p_element)
    allowed = tolerance * np.abs([evidence.model[k] or 0.0 for k in tested])
    beyond = np.abs(shift) > allowed
    significant = p_element < level
    for k, p, q, c in zip(tested, raw, adjusted, significant & (adjusted < level) & beyond, strict=True):
        parameters[k] = ParameterVerdict(float(p), float(q), bool(c))
    if evidence.structure_p is not None:
        said, p_element = ElementVerdict.CHANGED, min(p_element, evidence.structure_p)
    elif significant and (beyond_tolerance or beyond.any()):
        said = ElementVerdict.CHANGED
    elif evidence.detectable <= worth_knowing:
        said = ElementVerdict.UNCHANGED
    else:
        said = ElementVerdict.NOT_IDENTIFIABLE
    return Verdict(said, p_element, tuple(parameters), evidence.detectable)


def importance_in_loop(delta: ComplexArray, q_s: ComplexArray) -> Array:
    """Peak over frequency of the largest singular value of each Delta_ij alone in Delta Q Shat: (n_y, n_u).

    delta is (n_w, n_y, n_u), q_s = Q Shat is (n_w, n_u, n_y). Above 1 the change can be as large as the
    set-point itself; 0 leaves the loop as it was.
    """
    rows = np.linalg.norm(q_s, axis=2)
    peak: Array = np.max(np.abs(delta) * rows[:, None, :], axis=0)
    return peak


def importance_open_loop(delta: ComplexArray, model: ComplexArray) -> Array:
    """Largest |Delta_ij| over frequency relative to the largest |Ghat_ij| (to its row's where that is 0)."""
    own = np.max(np.abs(model), axis=0)
    row = np.max(own, axis=1, keepdims=True)
    size = np.where(own > 0, own, row)
    peak = np.max(np.abs(delta), axis=0)
    return np.asarray(np.divide(peak, size, out=np.full(own.shape, np.inf), where=size > 0))


def grade(half_widths: Sequence[float], answered: Sequence[bool], sound: bool) -> str:
    """How well an element is known, A to D.

    A: every parameter answered, each interval within 10 % of its value, residuals as they should be.
    B: the same within 25 %, or within 10 % with residuals that show structure.
    C: every parameter answered. D: some are not.
    `half_widths` are relative (of the dead time: to dead time plus lag).
    """
    if not all(answered) or not answered:
        return "D"
    widest = max(half_widths)
    if widest <= levels.GRADE_A:
        return "A" if sound else "B"
    return "B" if widest <= levels.GRADE_B and sound else "C"
