"""Controllers as recursions: flat arrays that the compiled loops of this room run.

Each entry is, with the mean of its signals over the step that ends now and their values at its end,

    I[k] = I[k-1] + ki (r_mean - y_mean)
    u[k] = I[k] + C x[k-1] + (d1r r_mean - d1y y_mean) + (d0r r_end - d0y y_end)
    x[k] = A x[k-1] + Br r_mean - By y_mean

For a sampled entry mean and end are the sample itself, and the matrices are those of the backward
difference. For a continuous entry they are exact for signals that are constant over the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.compiled import compiled
from trueplant.errors import LoopError
from trueplant.loop import levels
from trueplant.loop.controller import Controller
from trueplant.loop.pid import PID, Entry
from trueplant.lti.sampled import expm, realise, sampled_response
from trueplant.lti.transfer import TransferFunction


class Law(NamedTuple):
    """All entries of a controller; first axis: entry."""

    i: IntArray
    j: IntArray
    every: IntArray
    """Steps from one scan to the next."""
    sampled: BoolArray
    ki: Array
    clamp: BoolArray
    track: Array
    """Step over the time constant of back-calculation; 0 without it."""
    order: IntArray
    A: Array
    B: Array
    """(n_e, n, 2): Br and By."""
    C: Array
    D: Array
    """(n_e, 4): d1r, d1y, d0r, d0y."""


class StateSpace(NamedTuple):
    a: Array
    b: Array
    c: Array
    d: float


def law_of(controller: Controller, h: float) -> Law:
    """The recursion for steps of h. Raises LoopError for what cannot be run in time."""
    n = len(controller.entries)
    systems = [dynamics(entry, place) for place, entry in controller.entries.items()]
    width = max([1, *(s.b.size for s in systems)])
    law = Law(
        i=np.array([i for i, _ in controller.entries], dtype=np.int64),
        j=np.array([j for _, j in controller.entries], dtype=np.int64),
        every=np.ones(n, dtype=np.int64),
        sampled=np.zeros(n, dtype=np.bool_),
        ki=np.zeros(n),
        clamp=np.zeros(n, dtype=np.bool_),
        track=np.zeros(n),
        order=np.array([s.b.size for s in systems], dtype=np.int64),
        A=np.zeros((n, width, width)),
        B=np.zeros((n, width, 2)),
        C=np.zeros((n, width)),
        D=np.zeros((n, 4)),
    )
    for e, (entry, system) in enumerate(zip(controller.entries.values(), systems, strict=True)):
        law.every[e] = _scan_steps(entry, h)
        law.sampled[e] = entry.sample_time is not None
        _fill(law, e, entry, system, h)
    return law


def _scan_steps(entry: Entry, h: float) -> int:
    if entry.sample_time is None:
        return 1
    steps = round(entry.sample_time / h)
    if steps < 1 or abs(steps * h - entry.sample_time) > levels.WHOLE_SCAN * h:
        raise LoopError(
            f"the scan of a controller ({entry.sample_time:g}) must be a whole multiple of the step ({h:g}): "
            f"choose a step that divides it"
        )
    return steps


def dynamics(entry: Entry, place: tuple[int, int]) -> StateSpace:
    """What of the entry has states besides the integral: the filtered derivative, or the transfer function."""
    where = f"the controller from output {place[1] + 1} to input {place[0] + 1}"
    if isinstance(entry, PID):
        _, _, kd, tf = entry.parallel
        if kd == 0 or (tf == 0 and entry.sample_time is not None):
            return StateSpace(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 0.0)
        if tf == 0:
            raise LoopError(f"{where} has a derivative without a filter: give it a filter time or a sample_time")
        return StateSpace(np.array([[-1 / tf]]), np.array([1 / tf]), np.array([-kd / tf]), kd / tf)
    return state_space(entry.tf, where)


def state_space(system: TransferFunction, where: str) -> StateSpace:
    if not system.is_proper:
        raise LoopError(f"{where} is improper ({system}): add a filter to run it in time")
    if any(term.dead_time for term in system.terms):
        raise LoopError(
            f"{where} contains a dead time ({system}): it has a frequency function but cannot be run in time"
        )
    parts = []
    for term in system.terms:
        num = np.zeros((1, len(term.den)))
        num[0, len(term.den) - len(term.num) :] = term.num
        parts.append(realise(num, np.array(term.den)))
    order = sum(b.size for _, b, _, _ in parts)
    a, at = np.zeros((order, order)), 0
    for block, *_ in parts:
        a[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    b = np.concatenate([np.zeros(0), *(b for _, b, _, _ in parts)])
    c = np.concatenate([np.zeros(0), *(c[0] for _, _, c, _ in parts)])
    return StateSpace(a, b, c, float(sum(d[0] for *_, d in parts)))


def backward(system: StateSpace, h: float) -> tuple[Array, Array, Array, float]:
    """x[k] = a x[k-1] + b e[k], y[k] = c x[k-1] + d e[k]: s replaced by (1 - z^-1)/h."""
    m: Array = np.linalg.inv(np.eye(system.b.size) - h * system.a).astype(np.float64)
    b = m @ system.b * h
    return m, b, system.c @ m, float(system.d + system.c @ b)


def _fill(law: Law, e: int, entry: Entry, system: StateSpace, h: float) -> None:
    on_p = on_d = 1.0
    if isinstance(entry, PID):
        kp, ki, kd, tf = entry.parallel
        on_p, on_d = entry.setpoint_weight, 1.0 if entry.derivative_on == "error" else 0.0
        step = h if entry.sample_time is None else entry.sample_time
        law.ki[e] = ki * step
        law.clamp[e] = entry.anti_windup == "clamp" and ki != 0
        law.track[e] = min(step / entry.tracking_time, 1.0) if entry.anti_windup == "back-calculation" else 0.0
        law.D[e, 2:] = on_p * kp, kp
        if kd and tf == 0:
            law.order[e] = 1
            law.B[e, 0], law.C[e, 0] = (on_d, 1.0), -kd / step
            law.D[e, 2:] += on_d * kd / step, kd / step
            return
    n = system.b.size
    if entry.sample_time is not None:
        a, b, c, d0 = backward(system, entry.sample_time)
        d1 = 0.0
    else:
        joint = np.zeros((n + 1, n + 1))
        joint[:n, :n], joint[:n, n] = system.a * h, system.b * h
        exact = expm(joint)
        a, b, d0 = exact[:n, :n], exact[:n, n], system.d
        c, d1 = system.c @ a, float(system.c @ b)
    law.A[e, :n, :n], law.C[e, :n] = a, c
    law.B[e, :n, 0], law.B[e, :n, 1] = on_d * b, b
    law.D[e] += on_d * d1, d1, on_d * d0, d0


def filtered_setpoint(entry: Entry, r: Array, h: float, start: float) -> Array:
    """The set-point r (N,), sampled at h and held, behind the entry's set-point filter, at rest on `start` before."""
    prefilter = entry.setpoint_filter if isinstance(entry, PID) else None
    if prefilter is None:
        return r
    if entry.sample_time is None:
        return start + sampled_response(prefilter, r - start, h)
    m, b, c, d = backward(state_space(prefilter, "the set-point filter"), entry.sample_time)
    every = _scan_steps(entry, h)
    out: Array = start + np.repeat(recursion(m, b, c, d, r[::every] - start), every)[: r.size]
    return out


def law_setpoints(controller: Controller, law: Law, r: Array, h: float, y0: Array) -> tuple[Array, Array]:
    """(n_e, N) each: what every entry sees of set-points r (N, n_y), at rest on y0 (n_y,) before, as mean over the step
    that it looks at and at its end."""
    r_mean, r_end = np.empty((2, law.i.size, r.shape[0]))
    for e, entry in enumerate(controller.entries.values()):
        own = np.concatenate([[y0[law.j[e]]], r[:, law.j[e]]])
        if isinstance(entry, PID) and entry.setpoint_filter is not None:
            if entry.sample_time is None:
                halves = filtered_setpoint(entry, np.repeat(own, 2), h / 2, own[0])
                # step k is number k + 1 of `own`: its signals at k - 1/2, k and k + 1/2
                before, at, after = halves[1:-1:2], halves[2::2], halves[3::2]
                r_mean[e], r_end[e] = (before + 2 * at + after) / 4, after
                continue
            r_end[e] = filtered_setpoint(entry, own[1:], h, own[0])
        else:
            r_end[e] = own[1:]
        r_mean[e] = r_end[e] if entry.sample_time is not None else (own[:-1] + own[1:]) / 2
    return r_mean, r_end


@compiled
def recursion(a: Array, b: Array, c: Array, d: float, e: Array) -> Array:
    """y[k] = c x + d e[k], x = a x + b e[k] from x = 0."""
    n = b.size
    y = np.empty(e.size)
    x, new = np.zeros(n), np.zeros(n)
    for k in range(e.size):
        out = d * e[k]
        for p in range(n):
            out += c[p] * x[p]
            state = b[p] * e[k]
            for q in range(n):
                state += a[p, q] * x[q]
            new[p] = state
        y[k] = out
        x, new = new, x
    return y


@compiled(forceinline=True)
def entry_output(
    e: int,
    n: int,
    A: Array,
    B: Array,
    C: Array,
    D: Array,
    x: Array,
    spare: Array,
    r_mean: float,
    y_mean: float,
    r_end: float,
    y_end: float,
) -> float:
    """Output of entry e without its integral; advances its n states x[e] in place, with room to work in `spare`."""
    out: float = D[e, 0] * r_mean - D[e, 1] * y_mean + D[e, 2] * r_end - D[e, 3] * y_end
    for p in range(n):
        out += C[e, p] * x[e, p]
        spare[p] = B[e, p, 0] * r_mean - B[e, p, 1] * y_mean
        for q in range(n):
            spare[p] += A[e, p, q] * x[e, q]
    for p in range(n):
        x[e, p] = spare[p]
    return out


@compiled
def rest(law: Law, r: Array, y: Array, u: Array, limits: Array) -> tuple[Array, Array]:
    """States x and integrals I (n_e,) at rest with set-points r and PVs y of each entry (n_e,) and OPs u (n_u,).

    The first entry that writes an input (the first with integral action, if any) carries in I what the
    others do not give. States that integrate start from zero.
    """
    n_e = law.i.size
    x = np.zeros((n_e, law.A.shape[1]))
    integral = np.zeros(n_e)
    carrier = np.full(u.size, -1)
    given = np.zeros(u.size)
    for e in range(n_e):
        i = law.i[e]
        if carrier[i] < 0 or (law.ki[e] != 0 and law.ki[carrier[i]] == 0):
            carrier[i] = e
        n = law.order[e]
        steady = law.B[e, :n, 0] * r[e] - law.B[e, :n, 1] * y[e]
        left = np.eye(n) - law.A[e, :n, :n]
        if np.any(steady != 0.0) and abs(np.linalg.det(left)) > 1e-14:
            x[e, :n] = np.linalg.solve(left, steady)
        given[i] += entry_output(e, n, law.A, law.B, law.C, law.D, x.copy(), np.empty(n), r[e], y[e], r[e], y[e])
    for i in range(u.size):
        if carrier[i] >= 0:
            e = carrier[i]
            integral[e] = u[i] - given[i]
            if law.clamp[e]:
                integral[e] = min(max(integral[e], limits[i, 0]), limits[i, 1])
    return x, integral
