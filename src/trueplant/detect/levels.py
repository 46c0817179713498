"""All significance levels, thresholds and search ranges of the detection of changes, each with what set it."""

from __future__ import annotations

import numpy as np

# What a verdict is worth
POWER = 0.8
"""Share of records in which a change of just the detectable size is found: the usual one in planning experiments."""
WORTH_KNOWING = 0.3
"""Change of gain, lag, or dead time relative to dead time plus lag, that "unchanged" has to exclude: a loop with the
usual margins (gain margin above 2) bears it."""
DEGENERATE = 1e-12
"""Share of the largest variance below which that of a direction is rounding."""
SMALLEST_VARIANCE = 1e-300
"""That is divided by."""

# The instant of a change
FIRST_PASS = 60
"""Instants looked at in the first pass over a record."""
CLOSER_PASS = 40
"""Instants looked at in each closer pass."""
CHANGE_ROUNDS = 4
"""Rounds in which the instant, the parameters and the noise model are estimated in turn, at most."""
CHANGE_LARGEST_ORDER = 15
"""Order of the noise model, at most: the errors are filtered at every instant that is tried. Of the autoregression of
sizes of errors, from which the variance of their mean is: bursts of some ten samples are within its reach."""
BESIDE = 10
"""Prediction errors on each side of the instant, at least."""
CHANGE_SETTLED = 1e-3
"""Relative change of the parameters at which the rounds end."""

# Windows of a long record
DRAWS = 2000
"""Simulated series without a change, from which the significance of a step at an unknown instant is read."""
PARTS = 4
"""Instants tried in each window, so that a step within one is found too."""
CLEAR = 2.0
"""Difference of the Bayesian criterion (in -2 log likelihood) from which step and drift are told apart."""
SCATTERED = 1e-2
"""Significance from which windows scatter by more than their covariances say."""
DRIFT_SHOWS = 5
"""Windows that a drift needs: with fewer, a step within the middle one looks the same."""
FEWEST_WINDOWS = 6
"""Windows from which their scatter can be estimated."""

# The published detectors
MOST_LAGS = 100
"""Lags that detectors look at: finely sampled records are decimated to that."""
SHIFTS = 199
"""Circular shifts of the errors from which a threshold is read."""
MOST_STEPS = 20
"""Lags that enter a stepwise regression, at most."""
STEPWISE_LARGEST_ORDER = 10
"""Order of the autoregression that whitens the error before the regression."""
WINDOW_ORDER = 3
"""Order of the ARX model of a window: past PVs, and past OPs after the model's dead time."""
SAMPLES_PER_LAG = 8
"""Samples per lag of the fastest element, to which records are decimated."""
WINDOWS = 12
"""Windows in the part of the record that stands for the loop as it was; the part that is judged has as long ones."""
HORIZONS = np.array([0.5, 1.0, 2.0])
"""Where the step response of a window's model is read, in lags of the element."""
COLLINEAR = 1e-6
"""Share of its power below which a regressor has nothing of its own left."""

# Grades
GRADE_A, GRADE_B = 0.10, 0.25
"""Half-width of the widest interval of an element, relative to the parameter: A is good enough to tune on, B to tune
with the margins of usual rules."""
