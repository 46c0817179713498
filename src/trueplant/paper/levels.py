"""The tolerances with which the paper's numbers are compared, each with its reason."""

from __future__ import annotations

EQUATIONS = 1e-10
"""Relative error of an equation evaluated from both sides: rounding of the solves between."""
WEIGHTS = 1e-12
"""Relative difference of transfer functions that are the same formula."""
TRANSFORMS = 1e-3
"""Relative error of a frequency response computed from a simulated record: the record is sampled."""
CHANGED = 0.1
"""Relative change of a gain that the paper calls one. Its own perturbations are 10 %."""
TRANSFER_ERROR = 0.01
"""Relative error of an error transfer function fitted to a record without noise: its order is that of the truth, its
sampling is not."""
SETTLED = 25
"""Samples until the inverse of the coloured noise model has forgotten its start: 0.818^25 is 0.7 %."""
OFF_GRID = 1e-4
"""Min. At a dead time of whole samples the response has one derivative on either side: this is the later one."""
OFTEN = 3
"""Notes of a table in which a clause stands, from which it is said once above the table. Judgement."""
LONG_CLAUSE = 15
"""Characters from which that is worth a letter. Judgement."""
