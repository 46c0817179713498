"""The compiled loop over time: plant terms, controller entries and limits, one pass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trueplant.arrays import Array, IntArray
from trueplant.compiled import compiled
from trueplant.loop.law import Law, entry_output
from trueplant.loop.valve import stem
from trueplant.lti import require_proper
from trueplant.lti.sampled import discretise, realise, split_dead_time
from trueplant.lti.transfer import TransferMatrix


class Terms(NamedTuple):
    """All delayed terms of a plant, discretised for an input held over the step; first axis: term.

    x[k+1] = A x[k] + b0 u[k-q] + b1 u[k-q-1], output C x[k] + d u[k-q-1]: OP is written after PV was read.
    """

    i: IntArray
    j: IntArray
    order: IntArray
    q: IntArray
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
                found.append((i, j, q, ad, taps[1], taps[2], c[0], d[0]))
    n, width = len(found), max([1, *(f[4].size for f in found)])
    terms = Terms(
        i=np.array([f[0] for f in found], dtype=np.int64),
        j=np.array([f[1] for f in found], dtype=np.int64),
        order=np.array([f[4].size for f in found], dtype=np.int64),
        q=np.array([f[2] for f in found], dtype=np.int64),
        A=np.zeros((n, width, width)),
        b0=np.zeros((n, width)),
        b1=np.zeros((n, width)),
        C=np.zeros((n, width)),
        d=np.array([f[7] for f in found], dtype=float),
    )
    for t, (_, _, _, ad, now, before, c, _) in enumerate(found):
        m = c.size
        terms.A[t, :m, :m], terms.b0[t, :m], terms.b1[t, :m], terms.C[t, :m] = ad, now, before, c
    return terms


@compiled(forceinline=True)
def _term_output(
    t: int, n: int, A: Array, b0: Array, b1: Array, C: Array, x: Array, spare: Array, now: float, before: float
) -> float:
    """States of term t over one step, and its output without feedthrough at the end of it."""
    value = 0.0
    for a in range(n):
        state = b0[t, a] * now + b1[t, a] * before
        for b in range(n):
            state += A[t, a, b] * x[t, b]
        spare[a] = state
        value += C[t, a] * state
    for a in range(n):
        x[t, a] = spare[a]
    return value


@compiled(forceinline=True)
def _within(value: float, limits: Array, i: int) -> float:
    return float(min(max(value, limits[i, 0]), limits[i, 1]))


@compiled
def run_loop(
    terms: Terms,
    law: Law,
    r_mean: Array,
    r_end: Array,
    added: Array,
    smooth: Array,
    spikes: Array,
    quantum: Array,
    behind: Array,
    limits: Array,
    u0: Array,
    y0: Array,
    valves: Array,
    x_law: Array,
    integral: Array,
) -> tuple[Array, Array, Array]:
    """OP (N, n_u), measured PV and continuous output (N, n_y). r_mean, r_end are (n_e, N).
    `added` is what PV holds from one instant to the next, disturbance and noise; `smooth` (N, n_y) what runs on between
    them, and is in the continuous output with what the plant makes of OP. `behind` (N, n_u) is added to OP behind its
    valve; valves (n_u, 4): backlash, stick and both ends of each.

    A continuous entry sees, over the step centred on k, the mean of the continuous output and of
    what is added to it in steps; at the centre of the step that its output is held for, that output is
    extrapolated by half a step. Both are of second order, and what is recorded is the held OP.
    """
    # arrays taken out of their tuples once: within the loop that would cost more than the arithmetic, as would views
    term_i, term_j, term_n, q, A, b0, b1, C, d = terms
    law_i, law_j, every, sampled, ki, clamp, track, law_n, law_A, law_B, law_C, law_D = law
    steps, n_y = added.shape
    n_u, n_e, n_t = u0.size, law_i.size, term_i.size
    pad = 2
    for t in range(n_t):
        pad = max(pad, q[t] + 2)
    u, y, p = np.empty((steps, n_u)), np.empty((steps, n_y)), smooth.copy()
    du = np.zeros((n_u, pad + steps))
    x, spare = np.zeros((n_t, A.shape[1])), np.empty(max(A.shape[1], law_A.shape[1]))
    out, raw = np.zeros(n_e), np.empty(n_u)
    on_top, on_top_before = np.zeros(n_y), np.zeros(n_y)
    position = u0.copy()
    for k in range(steps):
        for t in range(n_t):
            j, last = term_j[t], pad + k - 1 - q[t]
            value = _term_output(t, term_n[t], A, b0, b1, C, x, spare, du[j, last], du[j, last - 1])
            if d[t] != 0.0:
                value += d[t] * du[j, last]
            p[k, term_i[t]] += value
        for i in range(n_y):
            value = y0[i] + p[k, i] + added[k, i]
            if quantum[i] > 0.0:
                value = np.round(value / quantum[i]) * quantum[i]
            y[k, i] = value + spikes[k, i]
            on_top_before[i] = on_top[i]
            on_top[i] = y[k, i] - y0[i] - p[k, i]
        for i in range(n_u):
            raw[i] = 0.0
        for e in range(n_e):
            i, j = law_i[e], law_j[e]
            if every[e] == 1 or k % every[e] == 0:
                y_mean, y_end = y[k, j], y[k, j]
                if not sampled[e]:
                    y_mean += 0.5 * (on_top_before[j] - on_top[j])
                    y_end += 0.5 * (p[k, j] - p[max(k - 1, 0), j])
                integral[e] += ki[e] * (r_mean[e, k] - y_mean)
                if clamp[e]:
                    integral[e] = _within(integral[e], limits, i)
                out[e] = entry_output(
                    e, law_n[e], law_A, law_B, law_C, law_D, x_law, spare,
                    r_mean[e, k], y_mean, r_end[e, k], y_end,
                )  # fmt: skip
            raw[i] += integral[e] + out[e]
        for i in range(n_u):
            u[k, i] = _within(raw[i], limits, i)
            position[i] = stem(u[k, i], position[i], valves[i, 0], valves[i, 1], valves[i, 2], valves[i, 3])
            du[i, pad + k] = position[i] - u0[i] + behind[k, i]
        for e in range(n_e):
            if track[e] > 0.0 and k % every[e] == 0:
                integral[e] += track[e] * (u[k, law_i[e]] - raw[law_i[e]])
    return u, y, p


@compiled
def run_law(
    law: Law, r_mean: Array, r_end: Array, y_mean: Array, y_end: Array, limits: Array, x: Array, integral: Array
) -> Array:
    """OP (N, n_u) of the law alone on given set-points (n_e, N) and PVs (n_e, N)."""
    law_i, _, every, _, ki, clamp, track, n, A, B, C, D = law
    n_e, steps = r_end.shape
    n_u = limits.shape[0]
    u = np.empty((steps, n_u))
    out, raw, spare = np.zeros(n_e), np.empty(n_u), np.empty(A.shape[1])
    for k in range(steps):
        for i in range(n_u):
            raw[i] = 0.0
        for e in range(n_e):
            if every[e] == 1 or k % every[e] == 0:
                integral[e] += ki[e] * (r_mean[e, k] - y_mean[e, k])
                if clamp[e]:
                    integral[e] = _within(integral[e], limits, law_i[e])
                out[e] = entry_output(
                    e, n[e], A, B, C, D, x, spare, r_mean[e, k], y_mean[e, k], r_end[e, k], y_end[e, k]
                )
            raw[law_i[e]] += integral[e] + out[e]
        for i in range(n_u):
            u[k, i] = _within(raw[i], limits, i)
        for e in range(n_e):
            if track[e] > 0.0 and k % every[e] == 0:
                integral[e] += track[e] * (u[k, law_i[e]] - raw[law_i[e]])
    return u
