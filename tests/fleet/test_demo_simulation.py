"""The loops of the demo site are what their models say: beside the differential equations, solved numerically."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trueplant.fleet.demo.simulate import Loop, simulate


@pytest.mark.parametrize("slave", [0.0, 1.5])
def test_a_loop_follows_its_differential_equation(slave: float) -> None:
    samples, gain, lag, dead_time = 60, 2.2, 12.0, 3
    whole = np.full((samples, 1), True)
    loop = Loop(
        h=1.0,
        gain=np.full((samples, 1, 1), gain),
        lag=np.full((1, 1), lag),
        dead_time=np.full((1, 1), float(dead_time)),
        Kc=np.array([0.7]),
        Ti=np.array([12.0]),
        stick=np.zeros(1),
        slave=slave,
    )
    y, u, _ = simulate(loop, np.ones((samples, 1)), whole, np.zeros((samples, 1)))
    state, expected = np.zeros(2), [0.0]  # of the slave and of the loop
    for k in range(samples - 1):
        given = u[k - dead_time, 0] if k >= dead_time else 0.0

        def slope(_: float, x: np.ndarray, given: float = given) -> list[float]:
            flow = x[0] if slave else given
            return [(given - x[0]) / (slave or 1.0), (gain * flow - x[1]) / lag]

        state = solve_ivp(slope, (0, 1), state, rtol=1e-10, atol=1e-12).y[:, -1]
        expected.append(state[1])
    np.testing.assert_allclose(y[:, 0], expected, atol=1e-9)
