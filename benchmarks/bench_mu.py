"""Bounds of mu over frequency: this project's batch beside one search a frequency.

400 frequencies of the mill's N with the weights (31) and (32), perturbation of two numbers and one 2 by 2 matrix. The
peer is slycot's ab13md, called once a frequency, where slycot is installed; otherwise scipy.optimize minimises
sigma_max(D M D^-1) at each frequency. Both give an upper bound; trueplant's time includes the lower one. Run with
``python benchmarks/bench_mu.py``; prints times, their ratio and how far the bounds are apart.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.optimize import minimize

from trueplant.plants import mill
from trueplant.robust import Full, diagonal, gain_and_dead_time_weight, generalised_plant, mu, performance_weight

try:
    from slycot import ab13md
except ImportError:
    ab13md = None

BLOCKS = (*diagonal(2), Full(2))


def slicot(N: np.ndarray) -> np.ndarray:
    """Upper bounds by AB13MD."""
    sizes, kinds = np.array([1, 1, 2]), np.array([2, 2, 2])
    return np.array([ab13md(matrix, sizes, kinds)[0] for matrix in N])


def searched(N: np.ndarray) -> np.ndarray:
    """Upper bounds by a general minimiser."""

    def largest(x: np.ndarray, matrix: np.ndarray) -> float:
        d = np.exp([x[0], x[1], 0.0, 0.0])
        return float(np.linalg.norm(d[:, None] * matrix / d, ord=2))

    options = {"xatol": 1e-6, "fatol": 1e-9}
    return np.array(
        [minimize(largest, np.zeros(2), args=(matrix,), method="Nelder-Mead", options=options).fun for matrix in N]
    )


def best_of(runs: int, function) -> tuple[float, Any]:
    """Shortest wall time of several runs, and the last result."""
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - begin)
    return min(times), result


def main() -> None:
    case = mill()
    weights = gain_and_dead_time_weight(0.1, 0.2), performance_weight(0.05, 1 / 0.45)
    s = 1j * np.geomspace(1e-4, 1e2, 400)
    N = generalised_plant(case.model, case.controller, *weights, s)
    own_time, own = best_of(5, lambda: mu(N, BLOCKS))
    name, peer = ("slycot ab13md", slicot) if ab13md else ("scipy Nelder-Mead", searched)
    peer_time, bound = best_of(2, lambda: peer(N))
    gap = np.max(1 - own.lower / own.upper)
    print(f"mu of the mill's N at {len(s)} frequencies; largest {own.upper.max():.4f}")
    print(f"trueplant          {1e3 * own_time:8.1f} ms   both bounds, largest relative gap {gap:.1e}")
    print(f"{name:18s} {1e3 * peer_time:8.1f} ms   upper bound")
    above, below = np.max(own.upper / bound) - 1, np.max(bound / own.upper) - 1
    print(f"speed ratio {peer_time / own_time:.1f}")
    print(f"upper bounds: trueplant's above the peer's by at most {above:.1e}, the peer's by at most {below:.1e}")


if __name__ == "__main__":
    main()
