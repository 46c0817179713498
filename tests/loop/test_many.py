"""A bank of plants runs each of them as `simulate` does."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.loop import PID, Controller, Step, simulate
from trueplant.loop.many import Bank
from trueplant.lti import TransferMatrix, tf

PLANTS = [
    TransferMatrix.of([[tf(f"{gain} exp(-2 s)/(10 s + 1)"), tf("0.3/(4 s + 1)")], [0.0, tf(f"{gain}/s")]], "min")
    for gain in (0.5, 1.0, 2.0)
]
LAWS = {
    "scanned": PID(Kc=1.0, Ti=8.0, Td=0.5, sample_time=0.4, limits=(0, 60), anti_windup="clamp"),
    "continuous": PID(Kc=1.0, Ti=8.0, Td=0.5, setpoint_filter=tf("1/(2 s + 1)"), limits=(0, 60)),
}


@pytest.mark.parametrize("law", LAWS)
def test_each_plant_is_simulated_as_alone(law: str) -> None:
    controller = Controller({(0, 0): LAWS[law], (1, 1): PID(Kc=0.1, Ti=30.0)}, 2, 2)
    y0, u0 = np.array([20.0, 5.0]), np.array([50.0, 10.0])
    r, load = np.tile(y0, (300, 1)), np.zeros((300, 2))
    r[50:, 0] += 8.0
    load[:, 1] = 0.5
    y, u = Bank.of(PLANTS, 0.2).run(controller, r, load, y0=y0, u0=u0, limits=controller.limits)
    assert u[:, :, 0].max() == 60.0
    for k, plant in enumerate(PLANTS):
        alone = simulate(plant, controller, r, 0.2, input_disturbance=[Step(0.0, (0.0, 0.5))], y0=y0, u0=u0)
        np.testing.assert_allclose(y[k], alone.y, rtol=0, atol=1e-9)
        np.testing.assert_allclose(u[k], alone.u, rtol=0, atol=1e-9)


def test_what_runs_away_does_not_stop_the_others() -> None:
    wild = Controller({(0, 0): PID(Kc=-900.0, Ti=0.1), (1, 1): PID(Kc=-900.0, Ti=0.1)}, 2, 2)
    still = np.ones((4000, 2))
    wide = np.tile([-np.inf, np.inf], (2, 1))
    y, _ = Bank.of(PLANTS, 0.2).run(wild, still, 0 * still, y0=np.zeros(2), u0=np.zeros(2), limits=wide)
    assert not np.isfinite(y).all() and np.isfinite(y[:, 0]).all()
