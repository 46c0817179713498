"""The mill loop in time: this project's simulator beside python-control with fifth-order Pade dead times.

Both run the published mill loop (set-point step on each output in turn) on the same grid. The reference is
computed by neither: a trapezoidal method of steps, written out below, at a hundredth of the grid's step. Run with
``python benchmarks/bench_simulator.py``; prints steps per second, largest errors and their ratios.
"""

from __future__ import annotations

import time

import control
import numpy as np
from numba import njit

from trueplant.loop import simulate
from trueplant.plants import mill

H, STEPS, SECOND = 0.01, 12_000, 6_000
"""Step in min, number of steps, and the step at which the second set-point moves."""


@njit
def method_of_steps(h: float, steps: int, second: int) -> np.ndarray:
    """PVs (steps, 2) of the mill under PI, written out term by term; all dead times are whole steps."""
    gain = np.array([-0.58, 4.0, -4.0 * 0.9938, 2.2, 2.83])
    lag = np.array([2.5, 2.0, 2.0, 6.0, 3.5])
    extra = np.array([0.0, 6.0, 6.0, 0.0, 0.0])
    delay = np.rint(np.array([0.68, 0.2, 0.67, 0.6, 0.13]) / h).astype(np.int64)
    row, column = np.array([0, 0, 0, 1, 1]), np.array([0, 1, 1, 0, 1])
    kc, ti = np.array([-2.0, 0.42]), np.array([3.3, 5.2])
    r = np.zeros(2)
    x, z = np.zeros(5), np.zeros(5)
    integral, y, error_before = np.zeros(2), np.zeros((steps, 2)), np.zeros(2)
    right, left = np.zeros((steps, 2)), np.zeros((steps, 2))  # u just after and just before each instant
    for k in range(steps):
        for t in range(5):
            if k > 0:
                a, b = k - 1 - delay[t], k - delay[t]
                start = right[a, column[t]] if a >= 0 else 0.0
                end = left[b, column[t]] if b >= 0 else 0.0
                c = 0.5 * h / lag[t]
                new = (x[t] * (1 - c) + c * gain[t] * (start + end)) / (1 + c)
                if extra[t] > 0:
                    c = 0.5 * h / extra[t]
                    z[t] = (z[t] * (1 - c) + c * (x[t] + new)) / (1 + c)
                x[t] = new
            y[k, row[t]] += z[t] if extra[t] > 0 else x[t]
        for j in range(2):
            if k > 0:
                integral[j] += 0.5 * h * kc[j] / ti[j] * (error_before[j] + r[j] - y[k, j])
            left[k, j] = kc[j] * (r[j] - y[k, j]) + integral[j]
        if k == 0:
            r[0] = 1.0
        if k == second:
            r[1] = 1.0
        for j in range(2):
            right[k, j] = kc[j] * (r[j] - y[k, j]) + integral[j]
            error_before[j] = r[j] - y[k, j]
    return y


def pade_loop(order: int) -> control.StateSpace:
    """The mill's closed loop from set-points to PVs with Pade dead times, in state space."""
    s = control.tf("s")
    second = 4 / ((2 * s + 1) * (6 * s + 1))
    parts = [
        (-0.58 / (2.5 * s + 1), 0.68, 0, 0),
        (second, 0.2, 0, 1),
        (-0.9938 * second, 0.67, 0, 1),
        (2.2 / (6 * s + 1), 0.6, 1, 0),
        (2.83 / (3.5 * s + 1), 0.13, 1, 1),
    ]
    plants = control.append(*(control.ss(g) * control.ss(control.tf(*control.pade(d, order))) for g, d, _, _ in parts))
    spread, gather = np.zeros((5, 2)), np.zeros((2, 5))
    for n, (_, _, i, j) in enumerate(parts):
        spread[n, j] = gather[i, n] = 1.0
    law = control.append(control.ss(-2 * (1 + 1 / (3.3 * s))), control.ss(0.42 * (1 + 1 / (5.2 * s))))
    loop = control.ss(plants.A, plants.B @ spread, gather @ plants.C, gather @ plants.D @ spread) * law
    return control.feedback(loop, control.ss([], [], [], np.eye(2)))


def best_of(runs: int, function) -> tuple[float, np.ndarray]:
    """Shortest wall time of several runs, and the last result."""
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - begin)
    return min(times), result


def main() -> None:
    finer = 100
    reference = method_of_steps(H / finer, STEPS * finer, SECOND * finer)[::finer]
    coarser = method_of_steps(H / finer * 2, STEPS * finer // 2, SECOND * finer // 2)[:: finer // 2]
    doubt = np.max(np.abs(reference - coarser)) / 3

    case = mill()
    r = np.zeros((STEPS, 2))
    r[:, 0], r[SECOND:, 1] = 1.0, 1.0
    simulate(case.model, case.controller, r, H)
    own_time, own = best_of(5, lambda: simulate(case.model, case.controller, r, H).y)

    loop = pade_loop(5)
    grid = np.arange(STEPS) * H
    peer_time, peer = best_of(3, lambda: control.forced_response(loop, grid, r.T).outputs.T)

    own_error, peer_error = (float(np.max(np.abs(y - reference))) for y in (own, peer))
    print(f"mill loop, {STEPS} steps of {H} min; reference good to {doubt:.1e}")
    print(f"trueplant              {STEPS / own_time:12,.0f} steps/s   largest error {own_error:.2e}")
    print(f"python-control, Pade 5 {STEPS / peer_time:12,.0f} steps/s   largest error {peer_error:.2e}")
    print(f"speed ratio {peer_time / own_time:.0f}, error ratio {own_error / peer_error:.5f}")


if __name__ == "__main__":
    main()
