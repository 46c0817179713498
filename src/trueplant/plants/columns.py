"""Distillation and fractionation columns."""

from __future__ import annotations

import numpy as np

from trueplant.loop import PID, Controller, Linear
from trueplant.lti import TransferFunction, TransferMatrix, tf
from trueplant.plants.case import Case


def splitter() -> Case:
    """Polymer hydrotreater splitter column: PID (38) with Table 2, plant (40), model (41).

    The reference prints Kc = 1 for the top temperature, whose plant gain is negative; with the signs of
    u = Q (r - y) that loop is unstable. The controller is therefore direct acting here. The plant record that the
    reference identifies is not public: data from this case are simulated.

    >>> case = splitter()
    >>> from trueplant.loop import unstable_poles
    >>> unstable_poles(case.model, case.controller), unstable_poles(case.plant, case.controller)
    (0, 0)

    The plant's gains are 25 % above the model's (the model's 20 % below the plant's):

    >>> [round(float(x), 2) for x in case.plant.dc_gain[0] / case.model.dc_gain[0]]
    [1.25, 1.25]
    """
    return Case(
        name="splitter",
        reference="Development and application of a model-plant mismatch expression for linear time-invariant "
        "systems, section 4",
        model=TransferMatrix.of(
            [["-0.464/(12 s + 1)", "3.2 exp(-3 s)/(18 s + 1)"], ["0", "3.8 exp(-0.5 s)/(2.8 s + 1)"]], "min"
        ),
        plant=TransferMatrix.of(
            [["-0.58/(10 s + 1)", "4 exp(-3 s)/(15 s + 1)"], ["0", "3.8 exp(-0.5 s)/(2.8 s + 1)"]], "min"
        ),
        controller=Controller.diagonal([PID(Kc=1.0, Ti=8.0, Td=0.5, alpha=0.1, action="direct"), PID(Kc=0.5, Ti=2.0)]),
        time_unit="min",
        outputs=(("top_temperature", "degC"), ("vaporisation", "%")),
        inputs=(("reflux", "%"), ("fuel_gas", "%")),
    )


def wood_berry() -> Case:
    """Wood and Berry's methanol-water column under the PI settings of Luyben's BLT rule.

    Wood, R. K. and Berry, M. W. (1973), Chem. Eng. Sci. 28, 1707-1717; Luyben, W. L. (1986), Ind. Eng. Chem. Process
    Des. Dev. 25, 654-660. The disturbance is the feed flow.

    The first relative gain is 2.01:

    >>> import numpy as np
    >>> gain = wood_berry().model.dc_gain
    >>> print(round(float((gain * np.linalg.inv(gain).T)[0, 0]), 2))
    2.01
    """
    return Case(
        name="wood_berry",
        reference="Wood and Berry (1973), Chem. Eng. Sci. 28, 1707; PI: Luyben (1986), Ind. Eng. Chem. Process Des. "
        "Dev. 25, 654",
        model=TransferMatrix.of(
            [
                ["12.8 exp(-s)/(16.7 s + 1)", "-18.9 exp(-3 s)/(21 s + 1)"],
                ["6.6 exp(-7 s)/(10.9 s + 1)", "-19.4 exp(-3 s)/(14.4 s + 1)"],
            ],
            "min",
        ),
        plant=None,
        controller=Controller.diagonal([PID(Kc=0.375, Ti=8.29), PID(Kc=-0.0754, Ti=23.6)]),
        time_unit="min",
        outputs=(("distillate_methanol", "%"), ("bottoms_methanol", "%")),
        inputs=(("reflux", "lb/min"), ("steam", "lb/min")),
        disturbance=TransferMatrix.of([["3.8 exp(-8.1 s)/(14.9 s + 1)"], ["4.9 exp(-3.4 s)/(13.2 s + 1)"]], "min"),
    )


def wardle_wood() -> Case:
    """Wardle and Wood's column under the PI settings of Luyben's BLT rule.

    Wardle, A. P. and Wood, R. M. (1969), I. Chem. E. Symp. Ser. 32, 6:68-6:81; settings from Luyben, W. L. (1986),
    Ind. Eng. Chem. Process Des. Dev. 25, 654-660.

    The first relative gain is 2.69:

    >>> from trueplant.robust import rga
    >>> print(round(float(rga(wardle_wood().model.dc_gain)[0, 0]), 2))
    2.69
    """
    return Case(
        name="wardle_wood",
        reference="Wardle and Wood (1969), I. Chem. E. Symp. Ser. 32, 6:68; PI: Luyben (1986), Ind. Eng. Chem. Process "
        "Des. Dev. 25, 654",
        model=TransferMatrix.of(
            [
                ["0.126 exp(-6 s)/(60 s + 1)", "-0.101 exp(-12 s)/((48 s + 1)(45 s + 1))"],
                ["0.094 exp(-8 s)/(38 s + 1)", "-0.12 exp(-8 s)/(35 s + 1)"],
            ],
            "min",
        ),
        plant=None,
        controller=Controller.diagonal([PID(Kc=27.4, Ti=41.4), PID(Kc=-13.3, Ti=52.9)]),
        time_unit="min",
        outputs=(("top_composition", ""), ("bottom_composition", "")),
        inputs=(("reflux", ""), ("vapour_boilup", "")),
    )


def skogestad_distillation() -> Case:
    """Skogestad and Postlethwaite's high-purity distillation column in the LV configuration, inverse-based controller.

    Skogestad, S. and Postlethwaite, I. (2005), Multivariable Feedback Control, 2nd ed., Wiley: the simplified model of
    sections 3.7.2 and 8.11, all signals scaled. The controller is 0.7/s G^-1 there; its integral is 1/(s + 1e-5) here,
    so that it has a value at rest.

    Condition number 141.7 and first relative gain 35.1: nearly singular, and so not robust against input errors. At
    the 61 frequencies of the reference robust performance is 5.7726, although nominal performance is 0.5:

    >>> import numpy as np
    >>> from trueplant.robust import Full, diagonal, generalised_plant, mu, rga
    >>> case = skogestad_distillation()
    >>> gain = case.model.dc_gain
    >>> print(round(float(np.linalg.cond(gain)), 1), round(float(rga(gain)[0, 0]), 1))
    141.7 35.1
    >>> s = 1j * np.logspace(-3, 3, 61)
    >>> N = generalised_plant(case.model, case.controller, case.uncertainty, case.performance, s)
    >>> print(round(float(mu(N, (*diagonal(2), Full(2))).upper.max()), 4))
    5.7726
    >>> print(round(float(np.linalg.norm(N[:, 2:, 2:], 2, (1, 2)).max()), 3))
    0.5
    """
    gain = np.array([[87.8, -86.4], [108.2, -109.6]])
    inverse = 0.7 * np.linalg.inv(gain)
    laws = {
        (i, j): Linear(TransferFunction.rational(inverse[i, j] * np.array([75.0, 1.0]), [1.0, 1e-5]))
        for i in range(2)
        for j in range(2)
    }
    return Case(
        name="skogestad_distillation",
        reference="Skogestad and Postlethwaite (2005), Multivariable Feedback Control, 2nd ed., 3.7.2 and 8.11",
        model=TransferMatrix.of([[f"{k}/(75 s + 1)" for k in row] for row in gain], "min"),
        plant=None,
        controller=Controller(laws, 2, 2),
        time_unit="min",
        outputs=(("top_composition", ""), ("bottom_composition", "")),
        inputs=(("reflux", ""), ("boilup", "")),
        uncertainty=tf("(s + 0.2)/(0.5 s + 1)"),
        performance=tf("0.5 (10 s + 1)/(10 s + 1e-5)"),
    )


def shell_3x3() -> Case:
    """Shell's heavy oil fractionator: end points of top and side draw and bottoms reflux temperature.

    Prett, D. M. and Morari, M. (1987), The Shell Process Control Workshop, Butterworths: outputs y1, y2, y7 and
    inputs u1, u2, u3. The last element has no dead time. The PI controllers are this project's own: the SIMC
    rule for each diagonal element (tauc equal to its dead time, 20 min for the last), gains divided and integral
    times multiplied by 1.5; the largest singular value of the sensitivity then peaks at 2.0.

    The relative gains leave the diagonal as the only pairing without a negative one:

    >>> import numpy as np
    >>> gain = shell_3x3().model.dc_gain
    >>> print(np.round(gain * np.linalg.inv(gain).T, 2))
    [[ 2.08 -0.73 -0.35]
     [ 3.42  0.93 -3.36]
     [-4.5   0.79  4.71]]
    """
    return Case(
        name="shell_3x3",
        reference="Prett and Morari (1987), The Shell Process Control Workshop; PI of this project's own design",
        model=TransferMatrix.of(
            [
                ["4.05 exp(-27 s)/(50 s + 1)", "1.77 exp(-28 s)/(60 s + 1)", "5.88 exp(-27 s)/(50 s + 1)"],
                ["5.39 exp(-18 s)/(50 s + 1)", "5.72 exp(-14 s)/(60 s + 1)", "6.90 exp(-15 s)/(40 s + 1)"],
                ["4.38 exp(-20 s)/(33 s + 1)", "4.42 exp(-22 s)/(44 s + 1)", "7.20/(19 s + 1)"],
            ],
            "min",
        ),
        plant=None,
        controller=Controller.diagonal([PID(Kc=0.15, Ti=75.0), PID(Kc=0.25, Ti=90.0), PID(Kc=0.09, Ti=28.0)]),
        time_unit="min",
        outputs=(("top_end_point", ""), ("side_end_point", ""), ("bottoms_reflux_temperature", "")),
        inputs=(("top_draw", ""), ("side_draw", ""), ("bottoms_reflux_duty", "")),
        input_limits=((-0.5, 0.5),) * 3,
    )
