"""All significance levels, thresholds and search ranges of the recovery of disturbances, each with what set it."""

from __future__ import annotations

# The fit of plant and disturbance
ITERATIONS = 40
"""Steps of the fit for a given disturbance, at most."""
FIT_ROUNDS = 3
"""Of estimating the noise for the plant and the plant for the noise."""
RESIDUAL_LAGS = 25
"""Lags of the test on the prediction errors."""
NOISE_PARAMETERS = 3
"""Of the background: white noise, a first order and its time constant."""
STEADY = 1e-13
"""Relative change of the covariance from one sample to the next below which gains are kept."""
FEWEST_SAMPLES = 20
"""Measured samples of an output below which nothing is said of its disturbance."""

# Noise and jumps
MOST_JUMPS = 12
"""Of a declared step in one signal: more are better described by its random walk."""
FALSE_JUMP = 0.01
"""Chance that a jump is found in a signal that has none."""
LEAST_SCALE = 1e-3
"""Of a declared disturbance: below a thousandth of its size it is not there."""
JUMP_ROUNDS = 4
"""In which noise and jumps are found in turn, at most."""
QUIET_STEP = 0.1
"""Share of the declared std of a step with which jumps are looked for."""
WHITE_RANGE, BACKGROUND_RANGE = (1e-4, 1e4), (1e-3, 1e5)
"""Search ranges of white noise and background, relative to the typical move from one sample to the next."""
SIMPLEX_TOLERANCE = 0.1
"""Of the search for the sizes of the noise: their logarithms, and -2 log likelihood."""
