"""What structures of one plant have in common: a gain at rest and a time to answer.

They are the first two moments of an impulse response. Lags and leads of another structure mean other things.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trueplant.arrays import Array
from trueplant.identify.fit import RowFit
from trueplant.identify.row import Row
from trueplant.lti.structure import Structure


def moments(structure: Structure, p: Array) -> tuple[Array, Array]:
    """(2,) gain (slope where it integrates) and time of an element; (2, n_p) their derivatives by its parameters.

    Delayed terms count alike for the time: what they say together has no mean where their gains cancel.
    """
    frequency, damping = p[structure.is_frequency], p[structure.is_damping]
    by_time = structure.is_lag - structure.is_lead.astype(float) + _shared_dead_time(structure)
    time = float(by_time @ p + np.sum(2 * damping / frequency))
    by_time[structure.is_frequency], by_time[structure.is_damping] = -2 * damping / frequency**2, 2 / frequency
    by_gain = structure.is_gain.astype(float)
    return np.array([by_gain @ p, time]), np.array([by_gain, by_time])


def directions(structure: Structure, p: Array) -> Array:
    """(2, n_p) how the parameters move with the gain, and with the time: by lags, or else by dead time."""
    slower = np.where(structure.is_lag, p, 0.0) - np.where(structure.is_frequency, p, 0.0)
    lags = float(p[structure.is_lag].sum() + np.sum(2 * p[structure.is_damping] / p[structure.is_frequency]))
    by_time = slower / lags if lags > 0 else structure.is_dead_time.astype(float)
    return np.array([structure.is_gain / structure.is_gain.sum(), by_time])


def in_row(shifts: Array, fit: RowFit, row: Row, theta: Array) -> Array:
    """(m, row.size) what shifts (m, size) of the parameters of a fit are in another row of the same output, at theta.

    An element of another structure moves by as much in gain, in dead time and in the rest of its time. 0 for elements
    that only one has, or that integrate in one only.
    """
    out = np.zeros((len(shifts), row.size))
    for here, there, structure, other in _alike(fit.row, row):
        moved = shifts[:, here]
        if structure != other:
            moved = moved @ _three(structure, fit.theta[here])[1].T @ _along(other, theta[there])
        out[:, there] = moved
    return out


def apart(fit: RowFit, row: Row, theta: Array) -> Array:
    """(row.size,) how far the plant of a fit is from that of another row of the same output, at theta; as `in_row`."""
    out = np.zeros(row.size)
    for here, there, structure, other in _alike(fit.row, row):
        p, q = fit.theta[here], theta[there]
        between = p - q if structure == other else (_three(structure, p)[0] - _three(other, q)[0]) @ _along(other, q)
        out[there] = between
    return out


def _alike(one: Row, other: Row) -> Iterator[tuple[slice, slice, Structure, Structure]]:
    """The places and structures of elements of the same input that integrate in both rows or in none."""
    own = {spec.column: (spec.structure, part) for spec, part in zip(one.specs, one.slices, strict=True)}
    for spec, there in zip(other.specs, other.slices, strict=True):
        if spec.column in own:
            structure, here = own[spec.column]
            if structure.integrators == spec.structure.integrators:
                yield here, there, structure, spec.structure


def _three(structure: Structure, p: Array) -> tuple[Array, Array]:
    """(3,) gain, time without dead time, and dead time of an element, and (3, n_p) their derivatives."""
    dead = _shared_dead_time(structure)
    (gain, time), (by_gain, by_time) = moments(structure, p)
    return np.array([gain, time - dead @ p, dead @ p]), np.array([by_gain, by_time - dead, dead])


def _along(structure: Structure, p: Array) -> Array:
    """(3, n_p) how the parameters move with each of the three."""
    return np.vstack([directions(structure, p), structure.is_dead_time])


def _shared_dead_time(structure: Structure) -> Array:
    """(n_p,) the mean of all dead times, as a sum over the parameters."""
    return np.asarray(structure.is_dead_time / max(int(structure.is_dead_time.sum()), 1))
