"""The compiled loop over time: plant terms, controller entries and limits, one pass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueplant.loop.law import Law, entry_output
from trueplant.lti import require_proper
from trueplant.lti.sampled import discretise, realise, split_dead_time
from trueplant.lti.transfer import TransferMatrix

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Terms(NamedTuple):
    """All delayed terms of a plant, discretised for an input held over the step; first axis: term.

    x[k+1] = A x[k] + b0 u[k-q] + b1 u[k-q-1], output C x[k] + d u[k-q-late].
    """

    i: IntArray
    j: IntArray
    order: IntArray
    q: IntArray
    late: IntArray
    A: Array
    b0: Array
    b1: Array
    C: Array
    d: Array


def terms_of(plant: TransferMatrix, h: float) -> Terms:
    """The plant's terms for steps of h: exact matrix exponentials, dead times to any fraction of a step."""
    found = []
    for i, row in enumerate(plant.elements):
        for j, element in enumerate(row):
            require_proper(element, f"the plant's element ({i + 1}, {j + 1})")
            for term in element.terms:
                num = np.zeros((1, len(term.den)))
                num[0, len(term.den) - len(term.num) :] = term.num
                a, b, c, d = realise(num, np.array(term.den))
                q, phi = split_dead_time(term.dead_time, h)
                ad, taps = discretise(a, b, h, phi, False)
                found.append((i, j, q, int(phi > 0), ad, taps[1], taps[2], c[0], d[0]))
    n, width = len(found), max([1, *(f[5].size for f in found)])
    terms = Terms(
        i=np.array([f[0] for f in found], dtype=np.int64),
        j=np.array([f[1] for f in found], dtype=np.int64),
        order=np.array([f[5].size for f in found], dtype=np.int64),
        q=np.array([f[2] for f in found], dtype=np.int64),
        late=np.array([f[3] for f in found], dtype=np.int64),
        A=np.zeros((n, width, width)),
        b0=np.zeros((n, width)),
        b1=np.zeros((n, width)),
        C=np.zeros((n, width)),
        d=np.array([f[8] for f in found], dtype=float),
    )
    for t, (_, _, _, _, ad, now, before, c, _) in enumerate(found):
        m = c.size
        terms.A[t, :m, :m], terms.b0[t, :m], terms.b1[t, :m], terms.C[t, :m] = ad, now, before, c
    return terms


@njit(cache=True)
def _plant_output(terms: Terms, x: Array, du: Array, k: int, p: Array) -> None:
    """Plant output p[k] from the states and the inputs before step k."""
    for t in range(terms.i.size):
        value = 0.0
        for a in range(terms.order[t]):
            value += terms.C[t, a] * x[t, a]
        if terms.d[t] != 0.0:
            back = k - max(terms.q[t] + terms.late[t], 1)
            if back >= 0:
                value += terms.d[t] * du[back, terms.j[t]]
        p[k, terms.i[t]] += value


@njit(cache=True)
def _plant_advance(terms: Terms, x: Array, du: Array, k: int, new: Array) -> None:
    """States from the instant k to k + 1."""
    for t in range(terms.i.size):
        at = k - terms.q[t]
        now = du[at, terms.j[t]] if at >= 0 else 0.0
        before = du[at - 1, terms.j[t]] if at >= 1 else 0.0
        n = terms.order[t]
        if n == 1:
            x[t, 0] = terms.A[t, 0, 0] * x[t, 0] + terms.b0[t, 0] * now + terms.b1[t, 0] * before
            continue
        for a in range(n):
            value = terms.b0[t, a] * now + terms.b1[t, a] * before
            for b in range(n):
                value += terms.A[t, a, b] * x[t, b]
            new[a] = value
        for a in range(n):
            x[t, a] = new[a]


@njit(cache=True)
def run_loop(
    terms: Terms,
    law: Law,
    r_mean: Array,
    r_end: Array,
    disturbance: Array,
    noise: Array,
    spikes: Array,
    quantum: Array,
    input_disturbance: Array,
    limits: Array,
    u0: Array,
    y0: Array,
    x_law: Array,
    integral: Array,
) -> tuple[Array, Array, Array]:
    """OP (N, n_u), measured PV and true PV (N, n_y). r_mean, r_end are (n_e, N); see `simulate` for the rest.

    A continuous entry sees, over the step centred on k, the mean of the plant's continuous output and of
    what is added to it in steps; at the centre of the step that its output is held for, the plant's output is
    extrapolated by half a step. Both are of second order, and what is recorded is the held OP.
    """
    steps, n_y = disturbance.shape
    n_u, n_e = u0.size, law.i.size
    u = np.empty((steps, n_u))
    du = np.empty((steps, n_u))
    y = np.empty((steps, n_y))
    p = np.zeros((steps, n_y))
    x = np.zeros((terms.i.size, terms.A.shape[1]))
    new = np.empty(terms.A.shape[1])
    out = np.zeros(n_e)
    raw = np.empty(n_u)
    added_before = np.zeros(n_y)
    added = np.zeros(n_y)
    for k in range(steps):
        _plant_output(terms, x, du, k, p)
        for i in range(n_y):
            value = y0[i] + p[k, i] + disturbance[k, i] + noise[k, i]
            if quantum[i] > 0.0:
                value = np.round(value / quantum[i]) * quantum[i]
            y[k, i] = value + spikes[k, i]
            added_before[i] = added[i]
            added[i] = y[k, i] - y0[i] - p[k, i]
        for i in range(n_u):
            raw[i] = 0.0
        for e in range(n_e):
            j = law.j[e]
            if law.sampled[e]:
                if k % law.every[e] == 0:
                    integral[e] += law.ki[e] * (r_end[e, k] - y[k, j])
                    _clamp(law, e, limits, integral)
                    out[e] = entry_output(law, e, x_law, r_end[e, k], y[k, j], r_end[e, k], y[k, j])
            else:
                y_mean = y[k, j] + 0.5 * (added_before[j] - added[j])
                y_end = y[k, j] + 0.5 * (p[k, j] - p[k - 1, j] if k > 0 else 0.0)
                integral[e] += law.ki[e] * (r_mean[e, k] - y_mean)
                _clamp(law, e, limits, integral)
                out[e] = entry_output(law, e, x_law, r_mean[e, k], y_mean, r_end[e, k], y_end)
            raw[law.i[e]] += integral[e] + out[e]
        _write(law, raw, limits, integral, u, k)
        for i in range(n_u):
            du[k, i] = u[k, i] - u0[i] + input_disturbance[k, i]
        _plant_advance(terms, x, du, k, new)
    return u, y, p


@njit(cache=True)
def run_law(
    law: Law, r_mean: Array, r_end: Array, y_mean: Array, y_end: Array, limits: Array, x: Array, integral: Array
) -> Array:
    """OP (N, n_u) of the law alone on given set-points (n_e, N) and PVs (n_e, N)."""
    n_e, steps = r_end.shape
    n_u = limits.shape[0]
    u = np.empty((steps, n_u))
    out = np.zeros(n_e)
    raw = np.empty(n_u)
    for k in range(steps):
        for i in range(n_u):
            raw[i] = 0.0
        for e in range(n_e):
            if k % law.every[e] == 0:
                integral[e] += law.ki[e] * (r_mean[e, k] - y_mean[e, k])
                _clamp(law, e, limits, integral)
                out[e] = entry_output(law, e, x, r_mean[e, k], y_mean[e, k], r_end[e, k], y_end[e, k])
            raw[law.i[e]] += integral[e] + out[e]
        _write(law, raw, limits, integral, u, k)
    return u


@njit(cache=True)
def _clamp(law: Law, e: int, limits: Array, integral: Array) -> None:
    if law.clamp[e]:
        i = law.i[e]
        integral[e] = min(max(integral[e], limits[i, 0]), limits[i, 1])


@njit(cache=True)
def _write(law: Law, raw: Array, limits: Array, integral: Array, u: Array, k: int) -> None:
    """OP within its limits, and back-calculation for the entries that just ran."""
    for i in range(raw.size):
        u[k, i] = min(max(raw[i], limits[i, 0]), limits[i, 1])
    for e in range(law.i.size):
        if law.track[e] > 0.0 and k % law.every[e] == 0:
            integral[e] += law.track[e] * (u[k, law.i[e]] - raw[law.i[e]])
