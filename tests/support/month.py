"""A simulated month of a PI loop in which all moves are known: with a stretch in manual and one at a limit (seeded).

The loop is stepped sample by sample here, so that manual and limits are what a controller makes of them.
"""

from __future__ import annotations

import numpy as np

from support.simulated import Array, coloured

MONTH = 43_200
"""Minutes."""
SMALL, LARGE, MIDDLE = (6_000, 6_360), (17_000, 17_720), (38_000, 38_720)
"""First and last move of the stretches that are usable: by 0.5, 2 and 1 degC, every hour."""
MANUAL, LIMIT = (12_000, 12_720), (25_000, 25_720)
"""The same of those that are not: by 2 degC."""
SIZES = {SMALL: 0.5, LARGE: 2.0, MIDDLE: 1.0, MANUAL: 2.0, LIMIT: 2.0}


def loop(sp: Array, load: Array, automatic: Array, v: Array) -> tuple[Array, Array]:
    """PV and OP (N,) of 2 exp(-3 s)/(20 s + 1), 1 min, under PI (Kc 1, Ti 20 min), OP within 0 and 100 %.

    About 100 degC at 50 %; load and noise v (N,) add to PV; in manual (`automatic` 0) OP stays.
    """
    a = np.exp(-1 / 20)
    y, u = np.zeros(sp.size), np.zeros(sp.size)
    x, integral, last = 0.0, 0.0, 0.0
    for k in range(sp.size):
        y[k] = x + load[k] + v[k]
        error = sp[k] - 100 - y[k]
        wanted = last if not automatic[k] else error + integral + error / 20
        u[k] = min(max(wanted, -50.0), 50.0)
        if automatic[k] and u[k] == wanted:
            integral += error / 20
        if not automatic[k]:
            integral = u[k] - error  # no bump when the loop is closed again
        last = u[k]
        x = a * x + (1 - a) * 2 * (u[k - 3] if k >= 3 else 0.0)
    return y + 100, u + 50


def month(seed: int = 1, std: float = 0.1, only: tuple[tuple[int, int], ...] = tuple(SIZES)) -> dict[str, Array]:
    """Columns t (min), sp, pv, op and mode (1 or 0) with the named stretches of moves alone."""
    n = MONTH
    sp, load, automatic = np.full(n, 100.0), np.zeros(n), np.ones(n)
    for first, last in only:
        k = np.arange(first, last)
        sp[first:last] += SIZES[first, last] * ((k - first) // 60 % 2 == 0)
    automatic[MANUAL[0] - 600 : MANUAL[1] + 600] = 0
    load[LIMIT[0] - 1000 : LIMIT[1] + 1000] = -150
    v = coloured(np.random.default_rng(seed), n, 1, [1, -0.8], [1], std)[:, 0]
    pv, op = loop(sp, load, automatic, v)
    return {"t": np.arange(n, dtype=float), "sp": sp, "pv": pv, "op": op, "mode": automatic}
