"""All significance levels, thresholds and search ranges of the identification, each with what set it."""

from __future__ import annotations

# The descent (`descent`)
SETTLED = 1e-4
"""Gain in -2 log likelihood, done and expected, at which a fit ends: a hundredth of a standard error."""
NEGLIGIBLE = 1e-6
"""Gain in -2 log likelihood for which no step is tried."""
ROUNDING = 1e-14
"""Relative rise of a cost that is taken for rounding."""
FIRST_DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-9, 1e8
"""Marquardt's damping, relative to the diagonal of the information."""
MOST_DAMPINGS = 12
"""Tried in one step, each larger than the one before: the last ones hardly move at all."""
LARGEST_RATIO = 3.0
"""By which a positive parameter may change in one step: time constants keep their order of magnitude meanwhile."""
