"""What a simulated record of the splitter gives: our estimate, the paper's route, and the Cramer-Rao bound.

The bound is that of the record: sigma^2 (sum psi psi')^-1, psi the gradients of the prediction error by plant,
operating point and noise coefficients, filtered by the inverse of the true noise model. White noise plus a first-order
disturbance is ARMA(1, 1).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.identify import Row, Spec, identify_output, paper_route, pieces_of
from trueplant.lti import sampled_response
from trueplant.lti.structure import structure_of
from trueplant.paper import levels
from trueplant.paper.records import ELEMENTS, FOPDT, POLE, case, noise_std, parameters, record, segment_of
from trueplant.record import Segment

NAMES = tuple(f"{name}{i + 1}{j + 1}" for i, j in ELEMENTS for name in ("gain", "tau", "delay"))


@dataclass(frozen=True, eq=False)
class Estimates:
    """Results of one record, or of several (first axis); parameters in the order of NAMES."""

    ours: Array
    std: Array
    inside: BoolArray
    """True where the 95 % interval holds the truth."""
    bound: Array
    """Cramer-Rao variance."""
    route: Array
    """The paper's route."""
    orders: NDArray[np.intp]
    """Order of our noise model for each output."""


def estimate(kind: str, seed: int) -> Estimates:
    """Everything from one record."""
    segment = segment_of(record(kind, seed))
    loop = case()
    found: list[tuple[Array, Array, BoolArray, Array]] = []
    orders = []
    for i, columns in enumerate(((0, 1), (1,))):
        truth = np.concatenate([structure_of(loop.plant[i, j])[1] for j in columns])
        specs = [Spec(j, FOPDT, tuple(structure_of(loop.model[i, j])[1])) for j in columns]
        output = identify_output([segment], i, specs)
        assert output is not None
        inside = (output.intervals[:, 0] <= truth) & (truth <= output.intervals[:, 1])
        std = np.sqrt(np.diag(output.covariance))
        found.append((output.theta, std, inside, bound(segment, i, columns, kind)))
        orders.append(output.fit.ar.size)
    theta, std, inside, variance = (np.concatenate(x) for x in zip(*found, strict=True))
    return Estimates(theta, std, inside.astype(bool), variance, route(segment), np.array(orders))


def route(segment: Segment) -> Array:
    """The paper's own route on the same record: e_Mr by equation error, (20), reduction to the structures."""
    loop = case()
    found = paper_route([segment], loop.model, loop.controller, dict.fromkeys(ELEMENTS, FOPDT))
    return np.concatenate([found.parameters[element] for element in ELEMENTS])


def together(runs: Iterable[Estimates]) -> Estimates:
    """Several records, stacked along a new first axis."""
    kept = list(runs)
    return Estimates(*(np.stack([getattr(run, name) for run in kept]) for name in Estimates.__dataclass_fields__))


def noise_model(kind: str) -> tuple[Array, Array, float]:
    """a, c and the variance of the innovations of a/c v = e, for v of variance 1."""
    if kind == "white":
        return np.ones(1), np.ones(1), 1.0
    white, driven = 0.5, 0.5 * (1 - POLE**2)
    # c and s2 from the two autocovariances of (1 - p q^-1) v: s2 (1 + c^2) and s2 c
    at_0, at_1 = white * (1 + POLE**2) + driven, -white * POLE
    half = -at_0 / (2 * at_1)
    c = -(half - np.sqrt(half**2 - 1))
    return np.array([1.0, -POLE]), np.array([1.0, c]), float(at_1 / c)


def bound(segment: Segment, output: int, columns: tuple[int, ...], kind: str) -> Array:
    """Cramer-Rao variances of one output's parameters for this record."""
    from scipy.signal import lfilter

    loop = case()
    truth = np.concatenate([structure_of(loop.plant[output, j])[1] for j in columns])
    truth = truth + levels.OFF_GRID * np.tile([0.0, 0.0, 1.0], len(columns))
    row = Row(tuple(Spec(j, FOPDT) for j in columns), pieces_of([segment], output), 1)
    y, _ = row.measured(0)
    response, gradient = row.response_and_gradient(truth, 0)
    unknown = row.unknown(truth, 0)
    nuisance = unknown.columns
    # inputs count from their first sample: what that leaves out is an operating point and a past, known here
    own = [sampled_response(loop.plant[output, j], segment.u[:, j], segment.h) for j in columns]
    whole = np.sum(own, axis=0)
    past = np.asarray(np.linalg.lstsq(nuisance, whole - response, rcond=None)[0], dtype=float)
    gradient = gradient + unknown.gradient(past)
    a, c, variance = noise_model(kind)
    psi = [lfilter(a, c, gradient, axis=0), lfilter(a, c, nuisance, axis=0)]
    if kind != "white":
        v = y - whole
        psi += [np.concatenate([[0.0], lfilter([1.0], c, x)[:-1]])[:, None] for x in (v, lfilter(a, c, v))]
    gradients = np.hstack(psi)[0 if kind == "white" else levels.SETTLED :]
    scale = np.linalg.norm(gradients, axis=0)
    inverse = np.linalg.pinv((gradients / scale).T @ (gradients / scale))
    innovation = variance * noise_std(kind)[output] ** 2
    return np.asarray(innovation * np.diag(inverse) / scale**2)[: truth.size]


def percent(values: Array) -> Array:
    """Absolute deviation from the truth in % of the true value; a true dead time of 0 counts in per cent of 1 min."""
    truth = parameters(case().plant)
    return np.asarray(100 * np.abs(values - truth) / np.where(truth == 0, 1.0, np.abs(truth)))


def ratio_to_bound(runs: Estimates) -> Array:
    """(9,) rms error over the root of the mean bound."""
    error = runs.ours - parameters(case().plant)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0) / np.mean(runs.bound, axis=0)))


def bound_percent(runs: Estimates) -> Array:
    """(9,) the root of the mean bound in % of the true values, as `percent`."""
    return percent(parameters(case().plant) + np.sqrt(np.mean(runs.bound, axis=0)))
