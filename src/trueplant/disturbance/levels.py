"""All significance levels, thresholds and search ranges of the recovery of disturbances, each with what set it."""

from __future__ import annotations

# The fit of plant and disturbance
ITERATIONS = 40
"""Steps of the fit for a given disturbance, at most."""
FIT_ROUNDS = 3
"""Rounds in which the noise is estimated for the plant and the plant for the noise."""
RESIDUAL_LAGS = 25
"""Lags of the test on the prediction errors."""
NOISE_PARAMETERS = 3
"""Of the background: the sizes of white noise and of a first order, and its time constant."""
STEADY = 1e-13
"""Relative change of the covariance from one sample to the next below which the filter's gains are constant."""
FEWEST_SAMPLES = 20
"""Measured samples of an output below which its disturbance is not estimated."""

# Noise and jumps
MOST_JUMPS = 12
"""Jumps of a declared step in one signal, at most: more are better described by its random walk."""
FALSE_JUMP = 0.01
"""Chance that a jump is found in a signal that has none."""
LEAST_SCALE = 1e-3
"""Least size of a declared disturbance, relative to the declared one."""
JUMP_ROUNDS = 4
"""Rounds in which noise and jumps are found in turn, at most."""
QUIET_STEP = 0.1
"""Size of the random walk, relative to the declared one, with which jumps are first looked for."""
WHITE_RANGE, BACKGROUND_RANGE = (1e-4, 1e4), (1e-3, 1e5)
"""Search ranges of white noise and background, relative to the typical move from one sample to the next."""
SIMPLEX_TOLERANCE = 0.1
"""Tolerance of the search for the sizes of the noise: of their logarithms, and of -2 log likelihood."""
