"""Ball mill grinding circuit, 2 by 2."""

from __future__ import annotations

from trueplant.errors import UsageError
from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix, tf
from trueplant.plants.case import Case

RECYCLE_FACTOR = {"printed": 1.1014, "eq37": 1.0137}
"""Factor of the second delayed term of the perturbed g12: as printed in (34), and as (37) implies."""


def mill(variant: str = "printed") -> Case:
    """Ball mill grinding circuit: model (21)-(25), PI controllers (26), perturbed plant (33)-(36).

    In print, (34) and (37) contradict each other: (37)'s -0.0066 needs the factor 1.0137 in (34) where 1.1014
    stands. `variant` is "printed" for 1.1014 or "eq37" for 1.0137. With 1.1014 the loop needs some 200 min to
    settle. Nominal values and limits are Table 1 of the reference, the weights its (31) and (32).

    The mismatch of the last element is ``-0.0809/(s + 0.2857)`` without its dead time, as (37) prints:

    >>> case = mill("eq37")
    >>> mismatch = (case.plant - case.model).dc_gain
    >>> bool(abs(mismatch[1, 1] + 0.0809 / 0.2857) < 2e-4), bool(abs(mismatch[0, 1] + 0.0066 / 0.0833) < 1e-3)
    (True, True)

    Raises UsageError for another variant.
    """
    if variant not in RECYCLE_FACTOR:
        raise UsageError(f'the mill has the variants "printed" and "eq37", not {variant!r}')
    factor = RECYCLE_FACTOR[variant]
    model = [
        ["-0.58 exp(-0.68 s)/(2.5 s + 1)", "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"],
        ["2.2 exp(-0.6 s)/(6 s + 1)", "2.83 exp(-0.13 s)/(3.5 s + 1)"],
    ]
    plant = [
        ["-0.464 exp(-0.68 s)/(2 s + 1)", f"4 (1 - {factor} exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"],
        ["2.2 exp(-0.6 s)/(6.6 s + 1)", "2.547 exp(-0.13 s)/(3.5 s + 1)"],
    ]
    return Case(
        name="mill",
        reference="Development and application of a model-plant mismatch expression for linear time-invariant "
        "systems, section 3",
        model=TransferMatrix.of(model, "min"),
        plant=TransferMatrix.of(plant, "min"),
        controller=Controller.diagonal([PID(Kc=-2.0, Ti=3.3), PID(Kc=0.42, Ti=5.2)]),
        time_unit="min",
        outputs=(("particle_size", "%"), ("circulating_load", "t/h")),
        inputs=(("ore_feed", "t/h"), ("dilution_water", "m3/h")),
        output_nominal=(70.0, 150.0),
        input_nominal=(65.0, 45.0),
        output_limits=((68.0, 72.0), (140.0, 170.0)),
        input_limits=((60.0, 70.0), (40.0, 50.0)),
        uncertainty=tf("(0.21 s + 0.1)/(0.1 s + 1)"),
        performance=tf("(0.45 s + 0.05)/s"),
    )
