"""All significance levels, thresholds and search ranges of the mismatch from responses, each with what set it."""

from __future__ import annotations

# The local polynomial method
WINDOW_DOF = 8
"""Degrees of freedom that a window leaves for the noise, at least."""
COLOURS = (0.0, 1.0, 2.0)
"""Powers of 1/w with which the noise's amplitude may fall: white, a walk, a walk through an integrator."""
LARGEST_CONDITION = 1e7
"""Of the regressors of a window, scaled: above it the reference signals cannot be told apart."""
ABSENT_REFERENCE = 1e-10
"""Of a reference signal's strongest window: in a window with less it is not there."""
MOST_MISSING = 0.1
"""Share of missing PV samples up to which straight lines replace them."""
FIRST_ORDER = 0.15
"""Relative noise of the loop's response up to which errors are carried to first order."""
NEIGHBOURS = 4
"""Lines to each side over which the noise on the loop's response is averaged."""
SPEAKS = 0.5
"""Relative standard error below which a frequency says something of an element."""
SAME_ELEMENT = 0.05
"""Significance from which an element is not the one that its response was taken about."""
BAND_NEGLIGIBLE = 0.01
"""Systematic error of local polynomials, relative to an element's response, that is never held against a plant."""
WORST_CONDITION = 1e8
"""Above this condition number of the excitation matrix its inverse is rounding, not data."""
SAME_MODE = 0.05
"""Relative distance of poles within which their free responses are one."""

# Averages over periods
FEWEST_PERIODS = 3
"""Periods of a stretch: one for the transient, two to tell their spread."""
SHORTEST_PERIOD = 3
"""Samples of a period: one line below half the sampling rate."""
SAME = 1e-6
"""Difference of two samples, relative to a signal's range, within which they count as equal."""
COVERED = 0.5
"""Share of the time in which set-points move that has to belong to repetitions."""
MINIMA = 60
"""Lags that are examined as periods, the likeliest first."""
DIFFERS = 0.01
"""Significance, over all signals together, at which a period differs from those after it."""
TRANSIENT_NEGLIGIBLE = 1e-3
"""Difference of a period, relative to the response, that is no transient."""
EXCITED = 1e-6
"""Strength relative to the strongest line below which lines, and directions within a line, are rounding."""

# Coherence
AVERAGES = 4
"""Windows for each set-point before overlap, and as many more."""
SHORTEST_WINDOW = 16
"""Samples of a window, at least."""
HANN_OVERLAP = 1 / 36
"""Squared correlation of Hann windows that overlap by half."""
ABSENT_POWER = 1e-14
"""Power relative to that of the strongest set-point below which a direction is rounding."""
UNRELATED = 0.05
"""Share of unrelated signals whose coherence exceeds the level that is given."""

# From the response to parameters
FIT_ROUNDS = 6
"""Rounds in which the estimate becomes the next model, at most."""
BEYOND_CORNER = 3.0
"""Times the corner frequency of the model's slowest element: where noise hides all below, gains read from the rest were
wrong by many standard errors (joint form, simulated Wood-Berry, AR(2) disturbance)."""
LEAST_DOF = 4
"""Complex degrees of freedom of the noise at a line from which its size is known well enough to weight with."""
SETTLED = 0.05
"""Largest change of a parameter between rounds, in standard errors, at which they end."""
GUESSES = 3
"""Minima of the grid from which the fit is refined."""
SCALES = 14
"""Time scales on the grid of initial guesses."""
DEAD_TIMES = (30, 150)
"""Fewest and most dead times on that grid, which reaches to 1/w of the lowest frequency where it can."""
CLEAR_RESPONSE, LOUD = 3.0, 0.1
"""Standard errors from which a response is clear; share of the largest weighted response from which a frequency counts
for the range of the grid."""

# From measured step responses to parameters
STEP_LOWEST, STEP_HIGHEST = 0.3, 0.9
"""Range of the frequencies that the search begins with: over the length of the response, and as a share of half the
sampling rate."""
STEP_FREQUENCIES = 60
"""How many, evenly on a logarithmic axis."""
STEP_SEARCH = 300
"""Evaluations of a search, at most."""
STEP_ROUNDING = 1e-4
"""Errors of a step response, relative to its largest value, that no structure is asked to explain: coefficients are
written with four digits or so."""
STEP_RETURNS = 0.02
"""Last value of a step response, relative to its largest, below which it has returned, as an impulse response does that
is taken for a step response. Judgement: inverse responses and overshoots fifty times the gain are not known."""
STEP_CORRELATION = 0.95
"""Of neighbouring errors of coefficients, at most: what is left of a misfit looks like a walk, whose size over the
whole response nobody knows."""
STEP_CORRELATIONS = 39
"""How many correlations up to that one are weighed."""
STEP_USELESS = 2
"""Numbers of parameters in succession that did not help, after which no more are tried: a lead is often of use only
beside a second lag."""
