"""All significance levels, thresholds and search ranges of the detection of changes, each with what set it."""

from __future__ import annotations

import numpy as np

# The instant of a change
FIRST_PASS = 60
"""Instants looked at in the first pass over a record."""
CLOSER_PASS = 40
"""Instants looked at in each closer pass."""
CHANGE_ROUNDS = 4
"""Of re-estimating parameters and noise at the best instant."""
CHANGE_LARGEST_ORDER = 15
"""Of the noise model: it is fitted at every instant that is looked at."""
BESIDE = 10
"""Sampled errors that each side of the instant keeps at least."""
CHANGE_SETTLED = 1e-3
"""Relative change of the parameters at which the rounds end."""

# Windows of a long record
DRAWS = 2000
"""Simulated series without a change: they tell a significance of 0.005 to a third of itself."""
PARTS = 4
"""Instants tried in each window, so that a step within one is found too."""
CLEAR = 2.0
"""Difference of the Bayesian criterion (in units of -2 log likelihood) from which the two count as told apart."""
SCATTERED = 1e-2
"""Significance from which windows count as scattering beyond their covariances."""
DRIFT_SHOWS = 5
"""Windows from which a drift can be called one: with fewer, a step within the middle one looks the same."""
FEWEST_WINDOWS = 6
"""Windows from which their scatter can be judged."""

# A sticking valve
BANDS = np.array([0.04, 0.08, 0.12, 0.18, 0.25, 0.35, 0.5])
"""Tried, relative to OP's range from its 1st to its 99th percentile."""
STICTION_LONGEST = 10_000
"""Longer records are left out: each band costs a fit."""
STICTION_ITERATIONS = 3
"""Of the fit for each band, which begins at the fit without one."""
STICTION = 1e-3
"""Significance from which a valve is said to stick: bands are tried in the valve of every input."""

# The published detectors
MOST_LAGS = 100
"""Lags looked at; finely sampled records are thinned out to that."""
SHIFTS = 199
"""Circular shifts that a threshold rests on."""
MOST_STEPS = 20
"""Lags that enter the regression, at most."""
STEPWISE_LARGEST_ORDER = 10
"""Of the autoregression that whitens the error."""
WINDOW_ORDER = 3
"""Of the ARX model of a window: past PVs, and past OPs after the model's dead time."""
SAMPLES_PER_LAG = 8
"""Samples per lag of the fastest element, beyond which records are thinned out."""
WINDOWS = 12
"""In the part that shows how the loop was, and about as long ones in the part that is judged."""
HORIZONS = np.array([0.5, 1.0, 2.0])
"""In lags of the element: where the step response of a window's model is read."""
COLLINEAR = 1e-6
"""Share of its power below which a regressor has nothing of its own left."""

# Grades
GRADE_A, GRADE_B = 0.10, 0.25
"""Half-width of the widest interval of an element, relative to the parameter: A is good enough to tune on, B to tune
with the margins of usual rules."""
