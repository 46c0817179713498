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
    begin, _ = fit_structure(w, measured.sampled_frequency_response(w), w / w[0], structure, h)
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
    return np.asarray(found.x[structure.sorted(found.x)], dtype=float)


def _fitted(measured: MeasuredStep, structure: Structure, p: Array) -> Fitted:
    system = structure.transfer(p)
    return Fitted(system, structure, *largest_difference(measured, system), _covariance(measured, system))


def _covariance(measured: MeasuredStep, system: TransferFunction) -> Array | None:
    """That of least squares whose errors are correlated (first order): misfit counts as scatter does."""
    from scipy.signal import lfilter

    try:
        structure, p = structure_of(system)
    except FormulaError:
        return None
    rows = structure.response_and_gradient(p, np.ones(measured.values.size), measured.sample_time)
    e, J = rows[0] - measured.values, rows[1:].T
    power, free = float(e @ e), max(e.size - p.size, 1)
    follows = min(_correlation(e), levels.STEP_CORRELATION)
    forwards = lfilter([1.0], [1.0, -follows], J, axis=0)
    backwards = lfilter([1.0], [1.0, -follows], J[::-1], axis=0)[::-1]
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    inverse = np.linalg.pinv(J.T @ J / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
    middle = power / free * (J.T @ (forwards + backwards - J))
    return np.asarray(inverse @ (middle + middle.T) / 2 @ inverse, dtype=float)


def _correlation(e: Array) -> float:
    """Of each error with the next one, 0 at least."""
    power = float(e @ e)
    return max(float(e[1:] @ e[:-1]) / power, 0.0) if power > 0 else 0.0
