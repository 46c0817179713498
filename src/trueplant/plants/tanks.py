"""The quadruple-tank laboratory process."""

from __future__ import annotations

from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix
from trueplant.plants.case import Case


def quadruple_tank() -> Case:
    """Four coupled tanks in the setting that is minimum phase, with the PI controllers published for it.

    Johansson, K. H. (2000), The quadruple-tank process, IEEE Trans. Control Syst. Technol. 8, 456-465.

    The first relative gain is 1.4 (there 1.40 from the flow ratios 0.70 and 0.60). The zeros of the printed, rounded
    elements, for which 7.28 (23 s + 1)(30 s + 1) = 2.1, lie at -0.0595 and -0.0173 (there -0.060 and -0.018):

    >>> import numpy as np
    >>> from trueplant.robust import rga
    >>> model = quadruple_tank().model
    >>> print(round(float(rga(model.dc_gain)[0, 0]), 1))
    1.4
    >>> zeros = np.sort(np.roots(7.28 * np.polymul([23, 1], [30, 1]) - [0, 0, 2.1]))
    >>> print(np.round(zeros, 4))
    [-0.0595 -0.0173]
    >>> bool(np.all(np.abs(np.linalg.det(model(zeros))) < 1e-12 * np.abs(np.linalg.det(model(0.5 * zeros)))))
    True
    """
    return Case(
        name="quadruple_tank",
        reference="Johansson (2000), The quadruple-tank process, IEEE Trans. Control Syst. Technol. 8, 456",
        model=TransferMatrix.of(
            [["2.6/(62 s + 1)", "1.5/((23 s + 1)(62 s + 1))"], ["1.4/((30 s + 1)(90 s + 1))", "2.8/(90 s + 1)"]], "s"
        ),
        plant=None,
        controller=Controller.diagonal([PID(Kc=3.0, Ti=30.0), PID(Kc=2.7, Ti=40.0)]),
        time_unit="s",
        outputs=(("level_1", "V"), ("level_2", "V")),
        inputs=(("pump_1", "V"), ("pump_2", "V")),
    )
