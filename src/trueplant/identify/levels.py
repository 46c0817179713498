"""All significance levels, thresholds and search ranges of the identification, each with what set it."""

from __future__ import annotations

import numpy as np

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

# The fit of a row
REWEIGHTED = (2, 5, 9)
"""Steps after which the pieces of the data are weighted anew."""
FASTEST_LAG = 0.05
"""Least time constant in samples: shorter ones act within the sample and cannot be told from none."""
MOST_JOINED = 60
"""Segments in one piece: each costs a free response."""
OFF_GRID = 0.05
"""Share of a sample by which a gap may miss whole samples, and what lies beside it still be one piece. Judgement."""
QUIET_SAMPLES = 20
"""A record starts at rest only if the inputs stood still for this many samples."""
LARGEST_FREE_RESPONSE = 3.0
"""Amplitude that a free response may have, in standard deviations of the forced response of its element."""
FREE_RESPONSE_GONE = 40.0
"""Time constants after which nothing is left of a free response, to rounding."""
LOST = 1e-7
"""Directions whose singular value is below this share of the largest are lost in rounding."""
LEVEL_SAMPLES = 5000
"""Prediction errors from which their size is estimated: more of them change nothing."""
NORMAL_MOVE = 0.95
"""Median of |e[k] - e[k - 1]| over the standard deviation of white normal e: 0.6745 sqrt(2)."""
EXACT = 1e-24
"""Cost relative to the energy of the output below which a fit is exact to rounding."""

# Searches: initial guesses, dead times, noise models
STRETCH = 2.0 ** np.linspace(-3, 3, 13)
"""Factors on the time scale of an element that are tried: an eighth to eight times, in steps of the root of two."""
RIDGE = 1e-10
"""Added to normal equations scaled to a unit diagonal, of responses that may be one and the same."""
RIVAL_NEAR = 10.0
"""Difference in -2 log likelihood within which another dead time is worth a fit, and in the Bayesian criterion within
which another noise model may be the right one: beyond, the evidence is very strong (Kass and Raftery 1995)."""
DEAD_TIME_UNSEEN = 0.05
"""Significance from which a dead time that the model does not have is estimated."""
DEAD_TIME_REACH = 25
"""Samples to either side in which other dead times are tried."""
NOT_WHITE = 0.05
"""Significance from which prediction errors do not count as white."""
SPARE_ORDERS = 2
"""Coefficients of the noise model beyond what the Bayesian criterion asks for. It stops short of disturbances that no
autoregression describes exactly, and in closed loop what it leaves out is enough to raise the false alarms of verdicts
from 5 to 10 % (Wood-Berry, 1,000 samples, ARMA(2, 1))."""
UNDERMODELLED = 1e-3
"""Significance from which prediction errors that follow an input are held against the structure."""
BETTER = 1e-9
"""Relative gain of the cost from which another minimum replaces the present one: less is rounding."""
SAMPLES_PER_ORDER = 40
"""For each coefficient of the noise model."""
FEWEST_PER_ORDER = 5
"""Samples for each coefficient, and two more, below which an order is not tried."""
NOISE_FREE = 1e-18
"""Energy of the output error relative to that of the output below which the record has no noise but rounding."""
TRIED_STEPS = 15
"""Of a fit that is one of many starts, before the best of them goes on."""
SECOND_LAGS = (0.2, 0.7, 5.0)
"""Further lags from which searches begin, relative to the lag of their element."""
CANCELLED_LAGS = (0.2, 0.7, 5.0, 25.0)
"""Lags, relative to that of their element, beside leads of the same size, from which the search begins for what a
structure may lack."""
PAIR_DAMPINGS = (0.3, 0.7)
"""Damping ratios from which searches of complex pairs begin."""
RICHER_LAGS = (0.3, 3.0, 10.0, 30.0)
"""Time constants, relative to the lag of an element, of what a structure that is too simple may lack where a valve is
looked for."""
POLISHED_STEPS = 60
"""Of the fit that goes on."""
STRUCTURE_SHARE = 0.2
"""Of the chance of a false alarm over a whole matrix, what is left to the rejection of structures that suffice."""
RICHER_MEANT = 0.5
"""Probability that the parameters of a structure that was asked for and does not suffice are those of the richer one,
in what both have in common, and not of what comes nearest to the plant: even odds."""

# A first model
FIRST_SCALES = (20.0, 200.0, 2000.0)
"""Time constants from which the search begins where nobody said anything: parts of the longest stretch of the record.
Each search looks from an eighth to eight times of it and on from what it finds."""
THERE_ALL_THE_SAME = 0.5
"""Probability that what the record does not show is there: even odds."""
GUESSED_FROM = 5000
"""Prediction errors from which first guesses of time constants are made: enough for those from which samples are
chosen."""
GUESSED_ORDER = 2
"""Order of the noise model meanwhile: noise and offset would else pass for slow elements."""

# Which samples are taken
SAMPLES_PER_LAG = 80
"""More samples than this per lag of the fastest element are left out of long records."""
STRIDES_PER_DEAD_TIME = 4.0
"""Samples that are looked at in the shortest dead time that is found, at least, where others are left out; nor is one
sought nearer."""
ENOUGH_SAMPLES = 1000
"""Samples that are kept in any case."""
SHORTEST_BLOCK = 65_536
"""Samples of a block, at least."""
LAGS_PER_BLOCK = 300
"""Each block has an operating point and an initial state of its own: so many lags long, it loses next to nothing."""
SEARCHED_ERRORS = 20_000
"""Prediction errors among which initial guesses, dead times and noise models are searched."""

# Covariance, intervals and what is left unanswered
FEWEST_FREEDOM = 8.0
"""Degrees of freedom: with fewer the noise is not known at all, and the t quantile says nothing sensible."""
MEMORIES = np.linspace(0.0, 1.0, 5)
"""Memories of the noise that are weighed: from that of an autoregression to that of a random walk. Twice as many move
nine of ten standard errors by less than 4 %."""
REMEMBERS = 0.5
"""Probability, before the record is looked at, that noise remembers longer than an autoregression: as likely as not."""
INITIAL_STATE_BIAS = 0.5
"""Bias in standard errors for each operating point and initial state, over the root of the number of samples.

0.20 to 0.54 in simulated records of Wood-Berry and the mill that lost 8 of every 60 or 10 of every 120 samples.
"""
RECORDED_DIGITS = 1e-6
"""Relative standard error below which no estimate from recorded numbers is taken for true."""
PROFILE_FURTHEST = 12
"""Standard errors within which the end of a profile interval is looked for; beyond, it counts as unbounded."""
PROFILE_PLACES = 6
"""Places on each side at which a profile with several valleys is looked at beyond its first end."""
PROFILED = 0.2
"""Relative standard error from which an interval is taken from the profile likelihood."""
FEWEST_SAMPLES = 2.5
"""Lag and dead time together must span this many samples to be told from each other and from none."""
NO_GAIN = 0.05
"""Significance at which the gains of an element, tested jointly, have to differ from zero for it to have dynamics."""
NO_INFORMATION = 1e30
"""A standard error above this says that the data held no information at all."""
BETWEEN_RUNS = 0.1
"""Standard deviation of the relative spread between runs of one plant, before they are looked at: what repeated step
tests of one rig differ by."""
RUN_SPREADS = np.concatenate([[0.0], np.geomspace(2e-3, 1.0, 14)])
"""Spreads over which the average is taken: 61 % from one to the next."""
RUNS_DISAGREE = 0.05
"""Significance from which it is said that experiments disagree."""
TOO_UNCERTAIN = 0.5
"""Standard error relative to the parameter from which it counts as not known: the sign begins to be open."""
HOPELESS_ERROR = 1e3
"""Relative standard error from which a profile of the likelihood is not worth its fits."""
BACKLASHES = np.geomspace(0.002, 0.5, 58)
"""Widths of backlash that are tried, relative to the range of OP: 10 % from one to the next."""
STICK_BANDS = np.geomspace(0.002, 0.5, 280)
"""Bands of stick-slip that are tried: 2 % from one to the next, as wide as its likelihood is."""
BEYOND_ENDS = np.geomspace(0.001, 0.9, 18)
"""Parts of what OP does in all, from either side of its range on, that an end of its valve may cut off: half as much
again from one to the next, as its likelihood is smooth."""
VALVE = 1e-4
"""Significance from which a valve is taken not to follow OP, over the bands and inputs tried."""
STICKS = 0.25
"""Odds, before the record is looked at, that a valve sticks or has backlash: one in five. Audits of mills found more
(Bialkowski 1993: some 30 % of the loops vary because of their valves)."""
HOLD = 0.01
"""Significance from which the likelihoods of two ways of a measured disturbance to run between its samples differ
beyond chance: the wrong one is then taken in at most 0.5 % of records."""
VALVE_FACTORS = np.concatenate([np.geomspace(0.5, 0.99, 36), [1.0], np.geomspace(1.01, 2.0, 36)])
"""By which a width that was found is varied again, the plant fitted behind it: 2 % from one to the next."""
VALVES_PLACED = 18
"""Valves of a kind that the plant is fitted behind, of those that promise more than chance would."""
VALVE_ROUNDS = 8
"""Such variations in turn, at most; each begins where the one before ended."""
PRIOR_SPREAD = 1.0
"""Standard deviation of the prior about the model, of natural logarithms: a factor of e. A parameter whose likelihood
has a standard error of 10 % moves by 1 % of its change."""
LARGEST_EXPONENT = 200.0
"""Of the factor that the prior puts on the squares: a bound that keeps numbers finite."""
SMALLEST = 1e-12
"""Of a time constant in a logarithm."""
PROFILED_STEPS = 40
"""Steps of the fit at each point of a profile, at most: one that stops early makes the interval too narrow."""
MINIMA_STARTS, MINIMA_SPREAD, MINIMA_SEED = 16, 0.5, 1
"""Places from which other minima are looked for, and the standard deviation of their logarithms about fit and model:
two of three within a factor of 1.6."""
MINIMA_ALIKE = 8
"""Starts that end in one minimum, after which less than half a further one is expected: by Boender and Rinnooy Kan
(1987) w minima in n descents leave w (n - 1)/(n - w - 2) - w, which is 0.4 for 1 in 8 and 0.5 for 1 in 7."""
MINIMA_POLISHED = 4
"""Minima found in a part of a long record that are looked at in the whole, at most."""
TRIED_SETTLED = 1e-2
"""Gain in -2 log likelihood at which such a fit ends: 1e-4 takes nearly twice as long, and moves the ends by less than
a tenth of a standard error where the profile is not flat."""
PROFILE_TOLERANCE = 0.01
"""Of the root of the deviance at an end of a profile interval."""
NOISE_SHIFT_ERRORS, NOISE_SHIFT_SHARE = 3.0, 3.0
"""A parameter depends on the noise model if another order moves it by more than three standard errors and by more than
a third of its size."""

USUAL_ORDER, LARGEST_ORDER = 30, 240
"""Of the autoregressive noise model, at most; the larger where the Bayesian criterion asks for all of the usual ones. A
random walk that flows into a vessel takes them: PV integrates it, and below the measurement's noise that shows late."""

WRITTEN_OUT = 40
"""Coefficients of the noise model up to which derivatives are written out. Beyond, normal equations come from
correlations: the same numbers, from where on they are the cheaper ones."""

# Tests
RESIDUAL_LAGS = 25
"""Lags of the tests on prediction errors, at the stride of the estimate."""
BARTLETT = 1.1447
"""Of the lags that Bartlett's weights ask for (Andrews 1991, Econometrica 59, 817)."""
MOST_CORRELATED = 0.97
"""From one score to the next, as far as is believed (Andrews and Monahan 1992, Econometrica 60, 953)."""
UNEVEN = 0.01
"""Significance of heteroscedastic or coloured prediction errors from which that is said."""
SEARCHED_FREEDOM = 5
"""Degrees of freedom that the search for lag and dead time adds to those of the parameters.

Mean of the statistic over 120 simulated Wood-Berry records without the element: 8.0 with 3 parameters.
"""
WORSE = 0.01
"""Chance, over all outputs and experiments of a plant, that an estimate that is right is taken to predict worse than
the model."""
MISSING_ELEMENT = 1e-3
"""Chance, over a whole matrix that is complete, that an element is added to it."""
MISSING_TRIED = 0.05
"""The same chance that one is tried: where the others have taken on what it does, it gains less to first order than in
the end."""
MISSING_LAGS_APART = 4.0
"""From one lag to the next at which an element that the model lacks is looked for, from one sample on."""
MISSING_DEAD_TIMES = (0.0, 0.5, 2.0)
"""Dead times over the lag at which it is looked for. A grid of first orders this coarse correlates with any other."""
SLOW_SPANS = 3.0
"""Spans of a slow lag that the record has to hold, or it says nothing of it."""
SAMPLES_PER_PARAMETER = 4
"""Without so many, a part of the data (one experiment, the first two thirds) is not fitted alone."""

# Several outputs and several windows
SHARED_LAGS = 8
"""Past prediction errors of another output, at the stride of the estimate, that are looked at."""
ERRORS_PER_LAG = 10
"""Instants that two outputs have to have in common for each of these. Judgement."""
SHARED_DISTURBANCE = 1e-2
"""Significance, over all pairs of outputs, from which one is taken to predict the errors of another."""
SHARED_FACTOR = 3.0
"""Factor on the standard errors of an output whose prediction errors another output predicts, where no joint noise
model is found: in simulated cases of this kind (Wood-Berry under its own feed disturbance) the bias was up to four
standard errors."""
JOINT_LARGEST_ORDER = 40
"""Order of the vector autoregression, at most: each order has n_y^2 coefficients."""
LARGEST_JACOBIAN = 60_000_000
"""Entries of the Jacobian of a joint fit, at most (480 MB): larger problems are fitted output by output."""
JOINT_ITERATIONS = 40
"""Steps of the joint fit, at most; it begins at the fits of single outputs."""
JOINT_LAGS = 20
"""Lags beyond the order over which joint prediction errors are tested."""
ONE_STEP_ROUNDS = 8
"""Gauss-Newton steps to the common estimate of windows, which begin near it."""
ONE_STEP_SETTLED = 0.01
"""Step at which the common estimate counts as found, in its standard errors."""
WINDOW_FLOOR = 1e-12
"""Least eigenvalue of a window's scaled information: short windows may not determine some directions."""

# The estimators of the literature
VARX_LAGS = (4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Lags of a vector ARX model; the largest number that the record affords is used."""
VARX_SPAN = 2.0
"""The lags of a black box span so many times the slowest lag of a plant, and its dead time, or it is not tested."""
SAMPLES_PER_COEFFICIENT = 8
"""Rows of data for each coefficient of an output that a vector ARX model needs."""
VARX_TESTED = 12
"""Frequencies at which a model is compared with the response of the black box."""
VARX_RESOLVED = 1e-8
"""Share of the largest variance below which a direction of the response is not a measurement of its own."""
SUBSPACE_LARGEST_ORDER = 40
"""Order of a state-space model by subspace identification, at most."""
SUBSPACE_INSIDE = 0.4
"""Least p-value over the elements from which a reduced response counts as the one that it reduces: at the edge of its
error (0.05) the reduction would double that error at low frequencies."""
PAPER_LARGEST_ORDER = 5
"""Poles of the paper's error model, at most: higher orders fit noise."""
PAPER_FILTERS = 6
"""Cut-off frequencies of the paper's filter that are tried."""
PAPER_POINTS = 60
"""Frequencies at which the plant is reduced to its structures."""
PAPER_FASTEST = 2.0
"""Highest frequency of that reduction, relative to the model's fastest pole."""

# Instrumental variables
ORDERS = ((1, 0, 0), (2, 0, 0), (2, 1, 0), (3, 1, 0), (3, 2, 0), (4, 1, 0), (1, 0, 1), (2, 0, 1))
"""(poles, zeros, integrators) that are tried for an element."""
ORDER_WHITENING = 8
"""Order of the autoregressive noise model that all candidates share, so that their criteria compare."""
ORDER_CLEAR = 10.0
"""Difference in the Bayesian criterion that counts as clear (Kass and Raftery 1995: very strong)."""
CLSRIVC_ROUNDS = 30
"""Rounds in which loop and plant are simulated and estimated in turn, at most."""
LAG_GROWTH = 1.25
"""Factor from each block of set-point lags to the next."""
SETPOINT_MEMORY = 0.2
"""Share of a record over which inputs are projected on past set-points."""
FILTER_CUTOFFS = 6
"""Cut-off frequencies of state-variable filters that are tried."""
DEAD_TIME_GRID = 60
"""Dead times tried for an element."""
DEAD_TIME_COARSE = 6
"""The filter is chosen at each sixth dead time of that grid; the best one serves for the rest."""
SCAN_ROUNDS = 4
"""Iterations at each dead time of the grid: enough to rank them."""
MINIMA_KEPT = 4
"""Minima over dead time from which the whole iteration is made."""
HOPELESS = 3.0
"""A minimum over dead time whose cost is so many times the best one is left out."""
FORGOTTEN = 1e-2
"""Share of the initial state of a filter that counts as forgotten."""
ARMA_ORDERS = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2), (3, 0), (3, 1), (3, 2), (4, 0), (6, 0), (8, 0))
"""Orders (p, q) of ARMA noise models from which one is chosen."""
LONGEST_AR = 60
"""Order of an autoregression of output errors, at most."""
NOISE_ROUNDS = 20
"""Rounds in which plant and noise model are estimated in turn, at most."""
NOISE_SETTLED = 0.03
"""Steps, in standard errors, that no longer matter when plant and noise model take turns."""
NEIGHBOUR_INTERVALS = (-2, -1, 1, 2)
"""Sample intervals beside that of a dead time in which a lower minimum is looked for."""
INSTRUMENT_SETTLED = 1e-3
"""Step of the instrumental-variable iteration at which it ends, in standard errors."""
PSEUDOLINEAR_ROUNDS = 12
"""Rounds of pseudo-linear regression, which converge from far away; Gauss-Newton steps follow."""
LONGEST_DEAD_TIME = 0.1
"""Longest dead time that is searched where none is declared, as a share of the record."""
ARX_LAGS = (8, 16, 32, 64)
"""Lags of the long ARX model that gives initial guesses."""
ARX_MOST_SAMPLES = 6000
"""Samples of that model: longer records are decimated, as an initial guess need not be efficient."""
ARX_HORIZON = 4
"""Its step responses are followed for that many times its lags."""
LOAD_STEP = 0.05
"""Chance over a whole record that a load is taken along that is none, were the noise model known."""
LOAD_ROUNDS = 4
"""Loads and noise model in turn, at most."""
SAMPLES_PER_LOAD = 100
"""Prediction errors for each load, at least."""
LOAD_TOLD = 0.05
"""Share of what a load moves that has to look unlike plant and operating point: where less is left, much of that is
rounding."""

SPIKE = 0.01
"""Chance over a whole record that a sample is taken for a spike that is none, were the noise model known; and the odds
at which it is taken for a disturbance instead."""
SPIKE_SAMPLES = 3
"""In a row that a spike may last."""
SPIKE_AROUND = 20
"""Prediction errors to either side whose size a spike has to exceed."""
SPIKE_ROUNDS = 8
"""Spikes and noise model in turn, at most."""
