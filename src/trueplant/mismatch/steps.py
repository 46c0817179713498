"""From a measured step response to the transfer function that suffices for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import FormulaError
from trueplant.lti import MeasuredStep, Structure, TransferFunction, largest_difference
from trueplant.lti.structure import structure_of
from trueplant.mismatch import levels
from trueplant.mismatch.reduction import fit_structure

AT_REST = ("fopdt", "sopdt", "pair", "sopdt+lead", "pair+lead", "sopdt+lag", "sopdt+lag+lead", "pair+lag+lead")
INTEGRATING = ("integrator", "integrator+lag", "integrator+lag+lag", "integrator+lag+lead", "integrator+lag+lag+lead")
AT_ONCE = ("gain", "fopdt+lead")
"""What may answer without delay, beside the others."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A transfer function in place of a measured step response."""

    system: TransferFunction
    structure: Structure | None
    """None where nothing answers."""
    error: float
    """Largest difference of the two step responses, as a share of the largest value of the measured one."""
    at: float
    """When that is."""
    covariance: Array | None = None
    """(n_p, n_p) of the parameters that `structure_of` finds in `system`, by the scatter of the coefficients about it;
    None where it finds none."""


def fit_step(measured: MeasuredStep, structure: Structure | None = None) -> Fitted:
    """The transfer function of a structure that comes nearest to a measured step response, by least squares.

    Without a structure it is the smallest that suffices: the one with the lowest Schwarz's criterion, in which errors
    may be correlated (first order), as those of coefficients that were identified are. Richer ones are tried, by number
    of parameters, until nothing is left to explain or two numbers in succession were of no use.

    Raises FormulaError where there are fewer coefficients than parameters, and for a response that ends where it began:
    no structure has a gain of 0.
    """
    if measured.size == 0:
        return Fitted(TransferFunction(), structure, 0.0, 0.0)
    if abs(measured.values[-1]) <= levels.STEP_RETURNS * measured.size:
        raise FormulaError(
            "the step response ends where it began: if the coefficients are those of an impulse response, say so (kind "
            '"fir"); an element whose gain at rest is 0 cannot be estimated: give it as a formula'
        )
    if structure is not None and _size(structure) >= measured.values.size:
        count = measured.values.size - 1
        raise FormulaError(
            f"{count} coefficients are too few for the {_size(structure)} parameters of {structure}: give more, or a "
            "simpler structure"
        )
    if structure is not None:
        return _fitted(measured, structure, _parameters(measured, structure))
    best = _Tried.of(measured, min(_candidates(measured), key=_size))
    useless = 0
    for count, rivals in groupby(sorted(_candidates(measured), key=_size), key=_size):
        if useless == levels.STEP_USELESS or best.exact or 2 * count > measured.values.size:
            break
        least = min((_Tried.of(measured, rival) for rival in rivals), key=lambda one: one.criterion)
        useless = useless + 1 if least.criterion > best.criterion else 0
        best = min(best, least, key=lambda one: one.criterion)
    return _fitted(measured, best.structure, best.p)


def _size(structure: Structure) -> int:
    return len(structure.names)


def _candidates(measured: MeasuredStep) -> Iterator[Structure]:
    names = INTEGRATING if measured.integrating else AT_REST
    if measured.values[0] != 0.0:
        names = (*AT_ONCE, *names)
    return map(Structure.parse, names)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A structure with the parameters that come nearest."""

    structure: Structure
    p: Array
    criterion: float
    exact: bool
    """What is left is rounding."""

    @classmethod
    def of(cls, measured: MeasuredStep, structure: Structure) -> _Tried:
        p = _parameters(measured, structure)
        e = structure.response(p, np.ones(measured.values.size), measured.sample_time) - measured.values
        power, rounding, follows = float(e @ e), levels.STEP_ROUNDING * measured.size, min(_correlation(e), 1.0)
        new = np.concatenate([e[:1], e[1:] - follows * e[:-1]])
        criterion = e.size * np.log(np.mean(new**2) + rounding**2) + _size(structure) * np.log(e.size)
        return cls(structure, p, float(criterion), power <= e.size * rounding**2)


def _parameters(measured: MeasuredStep, structure: Structure) -> Array:
    """(n_p,) least squares on the coefficients, from where the frequency response says."""
    from scipy.optimize import least_squares

    h, ones = measured.sample_time, np.ones(measured.values.size)
    w = np.geomspace(levels.STEP_LOWEST / measured.t[-1], levels.STEP_HIGHEST * np.pi / h, levels.STEP_FREQUENCIES)
    # by Parseval a weight of 1/w on the response weighs the step response evenly
    begin = fit_structure(w, measured.sampled_frequency_response(w), w / w[0], structure, h).parameters
    low, high = structure.bounds()
    found = least_squares(
        lambda p: structure.response(p, ones, h) - measured.values,
        np.maximum(begin, low + 1e-9 * h),
        lambda p: structure.response_and_gradient(p, ones, h)[1:].T,
        bounds=(low, high),
        x_scale="jac",
        xtol=1e-13,
        ftol=1e-13,
        gtol=1e-13,
        max_nfev=levels.STEP_SEARCH,
    )
    # the search only comes near a bound, and a dead time of 1e-16 is none
    p = np.where(found.x - low < 1e-9 * h, low, found.x)
    return np.asarray(p[structure.sorted(p)], dtype=float)


def _fitted(measured: MeasuredStep, structure: Structure, p: Array) -> Fitted:
    system = structure.transfer(p)
    return Fitted(system, structure, *largest_difference(measured, system), _covariance(measured, system))


def _covariance(measured: MeasuredStep, system: TransferFunction) -> Array | None:
    """That of least squares whose errors are correlated (first order): misfit counts as scatter does.

    By how much they are is known only so well: the covariance is the mean over all correlations, each weighted by its
    restricted likelihood, which allows for what the parameters have taken out of the errors.
    """
    from scipy.linalg import matmul_toeplitz

    try:
        structure, p = structure_of(system)
    except FormulaError:
        return None
    rows = structure.response_and_gradient(p, np.ones(measured.values.size), measured.sample_time)[:, 1:]
    e, J = rows[0] - measured.values[1:], rows[1:].T
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    J = J / scale
    inverse = np.linalg.pinv(J.T @ J, rcond=1e-12)
    middle = J.T @ matmul_toeplitz(_autocovariance(e, J), J)
    return np.asarray(inverse @ (middle + middle.T) / 2 @ inverse / np.outer(scale, scale), dtype=float)


def _autocovariance(e: Array, J: Array) -> Array:
    """(n,) of the errors behind what is left of them, e (n,), beside parameters with the gradient J (n, n_p)."""
    n, count = J.shape
    follows = np.linspace(0.0, levels.STEP_CORRELATION, levels.STEP_CORRELATIONS)
    first = np.sqrt(1 - follows**2)[:, None]
    given = np.column_stack([e, J])
    later = given[1:] - follows[:, None, None] * given[:-1]
    white = np.concatenate([(first * given[0])[:, None], later], axis=1)
    left, jacobian = white[..., 0], white[..., 1:]
    q, r = np.linalg.qr(jacobian)
    left = left - np.einsum("fnp,fp->fn", q, np.einsum("fnp,fn->fp", q, left))
    free = max(n - count, 1)
    power = np.maximum(np.sum(left**2, axis=1) / free, 1e-300)
    size = np.sum(np.log(np.maximum(np.abs(np.diagonal(r, axis1=1, axis2=2)), 1e-12)), axis=1)
    unlikely = free * np.log(power) / 2 - np.log(first[:, 0]) + size
    weight = np.exp(unlikely.min() - unlikely)
    variance = weight / np.sum(weight) * power / (1 - follows**2)
    return np.asarray(variance @ follows[:, None] ** np.arange(n), dtype=float)


def _correlation(e: Array) -> float:
    """Of each error with the next one, 0 at least."""
    power = float(e @ e)
    return max(float(e[1:] @ e[:-1]) / power, 0.0) if power > 0 else 0.0
