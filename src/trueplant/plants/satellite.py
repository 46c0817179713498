"""The spinning satellite: one loop at a time is as robust as can be, both together are not."""

from __future__ import annotations

from trueplant.loop import Controller, Linear
from trueplant.lti import TransferMatrix, tf
from trueplant.plants.case import Case


def spinning_satellite() -> Case:
    """Angular velocities of a spinning satellite under the controller Q = I.

    Doyle, J. C. (1986), lecture notes of the Honeywell/ONR workshop on advances in multivariable control, as given in
    Skogestad, S. and Postlethwaite, I. (2005), Multivariable Feedback Control, 2nd ed., section 3.7.1, with a = 10.

    Open-loop poles at +-10j, no transmission zeros. Each loop by itself is 1/s: infinite gain margin, 90 degrees. For
    errors of both inputs at once mu is 10.05, so that 10 % is enough to make it unstable:

    >>> import numpy as np
    >>> from trueplant.loop import complementary, unstable_poles
    >>> from trueplant.robust import diagonal, mu
    >>> case = spinning_satellite()
    >>> print(np.abs(case.model[0, 0].poles), unstable_poles(case.model, case.controller))
    [10. 10.] 0
    >>> print(np.round(mu(complementary(case.model, case.controller, [1e-6j]), diagonal(2)).upper, 2))
    [10.05]
    """
    return Case(
        name="spinning_satellite",
        reference="Doyle (1986); Skogestad and Postlethwaite (2005), Multivariable Feedback Control, 2nd ed., section "
        "3.7.1",
        model=TransferMatrix.of(
            [
                ["(s - 100)/(s^2 + 100)", "10 (s + 1)/(s^2 + 100)"],
                ["-10 (s + 1)/(s^2 + 100)", "(s - 100)/(s^2 + 100)"],
            ],
            "s",
        ),
        plant=None,
        controller=Controller.diagonal([Linear(tf("1")), Linear(tf("1"))]),
        time_unit="s",
        outputs=(("velocity_x", ""), ("velocity_y", "")),
        inputs=(("torque_x", ""), ("torque_y", "")),
    )
