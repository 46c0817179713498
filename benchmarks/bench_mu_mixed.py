"""mu with real parameters: how close the bounds are, how often none is found from below, and the time.

200 matrices a structure with normal elements (seed 0), complex ones and real ones; the peer is this project's complex
mu of the same matrices with every real number made complex. Run with ``python benchmarks/bench_mu_mixed.py``; prints
quantiles of lower/upper over the matrices with an upper bound above 0, shares of those where no perturbation was
found, of those proved to have none, and times.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from trueplant.robust import Full, Real, Repeated, mu

STRUCTURES = {
    "real + 1x1": (Real(), Full(1)),
    "real twice + 2x2": (Real(2), Full(2)),
    "2 real + 2x2": (Real(), Real(), Full(2)),
    "4 real + 2x2": (*[Real()] * 4, Full(2)),
    "4 real + 2 complex + 2x2": (*[Real()] * 4, Full(1), Full(1), Full(2)),
    "real 3 times, complex twice, 2x3": (Real(3), Repeated(2), Full(2, 3)),
    "2 real": (Real(), Real()),
    "4 real": (Real(),) * 4,
    "6 real": (Real(),) * 6,
}
COUNT = 200


def timed(M: np.ndarray, blocks: Any) -> tuple[float, Any]:
    begin = time.perf_counter()
    result = mu(M, blocks)
    return time.perf_counter() - begin, result


def main() -> None:
    print(f"{'structure':34s} {'M':8s} lower/upper: least    5 %   half  not found  none there   mixed  complex")
    for name, blocks in STRUCTURES.items():
        rng = np.random.default_rng(0)
        shape = COUNT, sum(b.columns for b in blocks), sum(b.rows for b in blocks)
        for kind in ("complex", "real"):
            M = rng.normal(size=shape) + (1j * rng.normal(size=shape) if kind == "complex" else 0)
            own_time, own = timed(M, blocks)
            cover_time, cover = timed(M, [Repeated(b.size) if isinstance(b, Real) else b for b in blocks])
            assert np.all(own.upper <= cover.upper * (1 + 1e-9))
            there = own.upper > 0
            ratio = own.lower[there] / own.upper[there]
            least, low, half = np.quantile(ratio, [0, 0.05, 0.5])
            print(
                f"{name:34s} {kind:8s} {least:18.3f} {low:6.3f} {half:6.3f} {np.mean(own.lower[there] == 0):9.1%} "
                f"{np.mean(~there):10.1%} {own_time:7.2f} s {cover_time:6.2f} s"
            )


if __name__ == "__main__":
    main()
