"""The paper's own route, (43)-(47): e_Mr = B0/A0 by equation error, then (20), then the declared structures.

The equation error A0 e - B0 r is linear in the coefficients, which is the charm of the method and its weakness:
noise in e enters the regressors too, so that the estimate is biased, and the bias does not go away with longer
records. With dead time in the loop e_Mr is not rational either. Kept because the paper uses it, and for comparison.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError, Refused
from trueplant.identify import levels
from trueplant.loop.controller import Controller
from trueplant.lti.sampled import rows_response, sampled_response
from trueplant.lti.structure import Structure
from trueplant.lti.transfer import TransferMatrix
from trueplant.mismatch import fit_structure
from trueplant.mismatch.expressions import closed_form
from trueplant.record.types import Segment

Element = tuple[int, int]


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """e = B0/A0 r for one output: all set-points over one denominator."""

    num: Array
    """(n_r, m + 1), descending powers."""
    den: Array
    """(n + 1,), monic."""
    lam: float
    fit_percent: float
    """100 (1 - |e - B0/A0 r|/|e|), simulated from rest."""

    def __call__(self, s: ComplexArray) -> ComplexArray:
        """Response (n_s, n_r)."""
        above = np.stack([np.polyval(row, s) for row in self.num], axis=1)
        value: ComplexArray = above / np.polyval(self.den, s)[:, None]
        return value


@dataclass(frozen=True, eq=False)
class PaperFit:
    """What the route gives: parameters of each element, and the error model of each output."""

    parameters: Mapping[Element, Array]
    error_models: tuple[ErrorModel, ...]
    w: Array
    """(n_w,) frequencies of the reduction."""
    plant: ComplexArray
    """(n_w, n_y, n_y) by (20)."""


def equation_error(
    r: Array | Sequence[Array], e: Array | Sequence[Array], h: float, n: int, m: int, lam: float
) -> tuple[Array, Array]:
    """B0 (n_r, m + 1) and A0 (n + 1, monic), descending powers, in e = B0/A0 r (43)-(47).

    r (N, n_r) held, e (N,) running linearly between samples, both from rest; or sequences of those, one a
    record. Both are passed through s^i/(s + lam)^n, exactly for that; lam (rad per time unit) should be somewhat
    above the fastest pole that matters. Least squares: biased under noise.

    Raises Refused where the records do not excite that many coefficients, LoopError for orders that make no sense.
    """
    if not (0 <= m <= n and n >= 1 and lam > 0):
        raise LoopError(f"{m} zeros, {n} poles, lambda {lam:g}: n >= 1, n >= m >= 0 and lambda above 0 are needed")
    records = [(r, e)] if isinstance(e, np.ndarray) else list(zip(r, e, strict=True))
    rows, targets = [], []
    for r_k, e_k in records:
        derivatives = _filtered(np.asarray(e_k, dtype=float), h, n, n, lam, "linear")
        of_r = [_filtered(column, h, n, m, lam, "zoh") for column in np.asarray(r_k, dtype=float).T]
        rows.append(np.hstack([-derivatives[:, 1:], *of_r]))
        targets.append(derivatives[:, 0])
    regressors, target = np.vstack(rows), np.concatenate(targets)
    scale = np.linalg.norm(regressors, axis=0)
    still = np.flatnonzero(scale == 0)
    if still.size:
        what = "e is zero" if still[0] < n else f"set-point {(still[0] - n) // (m + 1) + 1} does not move"
        raise Refused(f"{what} throughout: the equation error needs both; choose records in which it moves")
    solution, _, rank, _ = np.linalg.lstsq(regressors / scale, target, rcond=1e-13)
    if rank < regressors.shape[1]:
        raise Refused(
            f"the records do not excite the {regressors.shape[1]} coefficients of {m} zeros over {n} poles: lower the "
            "order, or use records in which the set-points move at different instants"
        )
    theta = solution / scale
    return theta[n:].reshape(-1, m + 1), np.concatenate([[1.0], theta[:n]])


def paper_route(
    segments: Sequence[Segment],
    model: TransferMatrix,
    controller: Controller,
    structures: Mapping[Element, Structure],
    orders: tuple[int, int] | None = None,
    lam: float | None = None,
) -> PaperFit:
    """Elements {(output, input): structure} by the paper's route: e_Mr by equation error, (20), reduction.

    Segments start from rest; missing PV samples end a segment. orders (n, m) and lam are chosen where not given: of
    the stable models up to fifth order, over a range of lam, the one whose simulation explains e best for the
    number of its coefficients. The plant by (20) is fitted from one period of the record to twice the model's fastest
    pole, each frequency with the same relative weight. No covariance: see the module for why the result is biased.

    An output of which no stable error model explains more than noise does keeps e_Mr = 0, the model as it is. An
    element that the model lacks is zero then, and has no parameters.

    Raises Refused where there are no usable records or set-points, LoopError for a plant that is not square.
    """
    n_y, n_u = model.shape
    if n_y != n_u:
        raise LoopError(f"(20) needs as many inputs as outputs, not {n_u} and {n_y}")
    if not segments:
        raise Refused("there is no usable segment: see what screening left out, and why")
    if not all(np.isfinite(segment.r).all() for segment in segments):
        raise Refused("the equation error needs the set-points of all loops: record them, or use another method")
    h = segments[0].h
    references, errors = [], []
    for segment in segments:
        missing = ~np.isfinite(segment.y).all(axis=1)
        end = int(np.argmax(missing)) if missing.any() else len(segment)
        if end < 10:
            continue
        e = segment.y - segment.y[0] - sampled_response(model, segment.u - segment.u[0], h, segment.hold)
        references.append((segment.r - segment.r[0])[:end])
        errors.append(e[:end])
    if not references:
        raise Refused("no segment has ten samples in a row: the equation error needs records without gaps")
    models = tuple(
        _best(references, [np.ascontiguousarray(e[:, i]) for e in errors], h, orders, lam) for i in range(n_y)
    )
    duration = max(len(r) for r in references) * h
    poles = np.concatenate([element.poles for row in model.elements for element in row])
    fastest = float(np.abs(poles).max()) if poles.size else 0.0
    w = np.geomspace(
        2 * np.pi / duration,
        max(10 / duration, min(levels.PAPER_FASTEST * fastest, np.pi / h / 2)),
        levels.PAPER_POINTS,
    )
    s = 1j * w
    X_r = np.stack([k(s) for k in models], axis=1)
    unit = np.broadcast_to(np.eye(n_y, dtype=complex), X_r.shape)
    plant = closed_form(unit, X_r, model(s), controller(s), F=controller.setpoint(s)).plant
    parameters = {
        (i, j): fit_structure(w, plant[:, i, j], np.abs(plant[:, i, j]), structure).parameters
        for (i, j), structure in structures.items()
        if plant[:, i, j].any()
    }
    return PaperFit(parameters, models, w, plant)


def _filtered(x: Array, h: float, n: int, highest: int, lam: float, hold: str) -> Array:
    """(N, highest + 1): x through s^highest/(s + lam)^n ... 1/(s + lam)^n."""
    num = np.zeros((highest + 1, n + 1))
    num[np.arange(highest + 1), n - highest + np.arange(highest + 1)] = 1.0
    den = np.poly(np.full(n, -lam)).astype(float)
    filtered: Array = rows_response(num, den, 0.0, np.ascontiguousarray(x), h, hold).T
    return filtered


def _best(
    r: Sequence[Array], e: Sequence[Array], h: float, orders: tuple[int, int] | None, lam: float | None
) -> ErrorModel:
    """The stable model with the least Bayesian information criterion of its simulation error."""
    duration = max(len(x) for x in e) * h
    fastest = np.pi / h / 4
    lams = np.geomspace(min(30 / duration, fastest), fastest, levels.PAPER_FILTERS) if lam is None else np.array([lam])
    candidates = [(n, n - 1) for n in range(1, levels.PAPER_LARGEST_ORDER + 1)] if orders is None else [orders]
    energy = sum(float(x @ x) for x in e)
    samples = sum(x.size for x in e)
    # the model without mismatch is a candidate too: e is then disturbance alone
    none = ErrorModel(np.zeros((r[0].shape[1], 1)), np.ones(1), float(lams[0]), 0.0)
    best = samples * np.log(max(energy, 1e-300)), none
    for n, m in candidates:
        for value in lams:
            try:
                num, den = equation_error(r, e, h, n, m, float(value))
            except Refused:
                continue
            if np.any(np.roots(den).real >= 0):
                continue
            left = sum(float(np.sum((x - _simulated(num, den, ref, h)) ** 2)) for ref, x in zip(r, e, strict=True))
            if not np.isfinite(left):
                continue
            criterion = samples * np.log(max(left, 1e-20 * energy, 1e-300)) + (n + num.size) * np.log(samples)
            if criterion < best[0]:
                best = criterion, ErrorModel(num, den, float(value), float(100 * (1 - np.sqrt(left / energy))))
    return best[1]


def _simulated(num: Array, den: Array, r: Array, h: float) -> Array:
    total = np.zeros(len(r))
    for row, column in zip(num, r.T, strict=True):
        padded = np.concatenate([np.zeros(len(den) - len(row)), row])[None, :]
        total += rows_response(padded, den, 0.0, np.ascontiguousarray(column), h)[0]
    return total
