"""One loop of a lag with dead time under PI, and a model of it that is off."""

from __future__ import annotations

import numpy as np

from trueplant.identify import Spec
from trueplant.loop import PID, Controller
from trueplant.lti import Structure, TransferMatrix

FOPDT = Structure.parse("fopdt")
TRUTH = np.array([2.0, 10.0, 4.6])
PLANT = TransferMatrix(((FOPDT.transfer(TRUTH),),), "min")
LAW = Controller.diagonal([PID(Kc=0.4, Ti=10.0, sample_time=1.0)])
OFF = np.array([1.7, 12.0, 4.0])
MODEL = TransferMatrix(((FOPDT.transfer(OFF),),), "min")
SPEC = Spec(0, FOPDT, tuple(OFF))
