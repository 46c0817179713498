"""The limits, thresholds and search ranges of tuning, each with its reason or the measurement that set it.

"Judgement" says that a number was chosen by hand. benchmarks/bench_retuning.py measures what comes of them together:
how often the proposed settings hold on the true plant, and what they give up.
"""

from __future__ import annotations

import numpy as np

# -- what is promised ----------------------------------------------------------------------------------------

PEAK = 1.59
"""Largest peak of |S| and |T|: that of the SIMC rule at its own closed-loop time for a first order with dead time
(Skogestad, J. Process Control 13, 2003, table 1)."""
SHARE, CONFIDENCE = 0.95, 0.95
"""Share of the plants that a record leaves possible for which settings hold, and with which confidence: usual."""
DRAWS = 600
"""Plants drawn, half to choose and half to prove: at 95 % and 95 % the proof then allows 8 of 300 to fail."""
ALPHA = 0.1
"""Derivative filter time over derivative time, where nothing else is known: what most vendors set."""

# -- grids of frequencies ------------------------------------------------------------------------------------

PER_DECADE = 400
"""Points of a plant's own grid. Judgement: max_ki is refined where limits bind."""
SLOWEST, FASTEST = 1e-3, 50.0
"""From so many times the slowest rate to so many times the fastest: the phase is settled there."""
LIGHT_DAMPING = 0.3
"""Ratio of real to imaginary part below which a pole or zero makes a resonance that a grid could miss."""
AROUND_RESONANCE = (0.05, 20.0)
"""Points are set between these multiples of its decay rate from it, on both sides."""
OPTIMAL_PER_DECADE = 150
"""For the limits in the search for a least error, which is run some hundred times."""
DRAWN_PER_DECADE = 45
"""For many drawn plants: it must follow the phase of det(I + G Q). Judgement; tests compare the count with the exact
one."""
DRAWN_TOP = 40.0
"""That grid ends at this multiple of the highest crossover that is looked at: the loop gain is small there."""
DRAWN_BELOW_RESET, DRAWN_BELOW = 1e-3, 1e-2
"""It begins at so much of the slowest reset rate, and again below: integrators rule there, and their number is read
from the slope."""
EVERY_RESONANCE = 10
"""Of the plant's own grid each tenth point is added, for resonances."""
UNCERTAIN_PER_DECADE = 80
"""For one uncertain element."""
UNCERTAIN_BELOW, UNCERTAIN_ABOVE = 300.0, 20.0
"""It goes so far below the lowest and above the highest ultimate frequency of the extreme plants."""
SHARPEST = 0.005
"""Relative damping below which that grid is made no denser. Judgement: memory."""

# -- the largest integral gain -------------------------------------------------------------------------------

KP_POINTS, KP_ZOOMS, DRAWN_ZOOMS = 41, 6, 3
"""Points of kp tried at once, and how often the grid zooms in by 20: to 1e-8, for drawn plants to 1e-4."""
TD_RANGE, TD_POINTS = (0.01, 1.0), 13
"""Derivative times tried, in the ultimate period. Ziegler and Nichols take an eighth."""
TD_PRECISION = 1e-4
"""Relative precision of the derivative time."""
NEAR_LIMIT, AROUND_NEAR, NEAR_POINTS = 1.02, (0.98, 1.02), 4000
"""Where a peak is within 2 % of its limit the frequencies, and 2 % around them, are refined to so many points: kp is
far more sensitive to the grid than ki. Judgement."""

# -- integral errors and step responses ----------------------------------------------------------------------

OPTIMAL_STEPS = 3000
"""Of a simulation in the search for a least error. Judgement: it is run for every trial."""
OPTIMAL_SPAN = 10.0
"""Its length in integral time plus four dead times: the error is over by then."""
LOWER_GAIN, LOWEST_GAIN = 0.3, 6.0
"""Steps in the logarithm by which SIMC's gain is lowered until it holds the limits, and how far."""
RESPONSE_STEPS = 4000
"""Least number of steps of a step response."""
MOST_RESPONSE_STEPS = 64 * RESPONSE_STEPS
"""And most: then the loop does not settle."""
RESPONSE_SPAN = 10.0
"""Length of a step response in the slowest time of the loop, before it is doubled."""
DEAD_TIME_STEPS, CROSSOVER_STEP = 10, 0.05
"""Steps in a dead time, and rad of crossover in a step: the loop is simulated with an OP held over each."""
SETTLED = 1e-3
"""Of the peak error: what still counts as moving at the end of a simulation."""
SETTLING_BAND = 0.02
"""Of the step: within which PV has settled, the usual 2 %."""

# -- several loops -------------------------------------------------------------------------------------------

DETUNING = (0.2, 200.0)
"""Range of the factor of the BLT rule: published cases need 1 to 10."""
DETUNING_POINTS = 120
"""Factors tried before the root is sharpened. Judgement."""
ROUNDS = 3
"""Times that the loops are tuned one after the other. Judgement."""
SLOWDOWNS = np.concatenate([np.arange(0.4, 0.8, 0.05), np.arange(0.8, 1.0001, 0.01)])
"""Factors on kp that are proved, from the slowest on. Judgement: settings that need more are better not trusted."""
SLOWEST_START = 2.0**-12
"""Factor on today's gains at which the search for a stable start ends."""
SLOW_START = 10.0
"""A loop without a usable controller starts with a tenth of the gain 1 at its crossover, and with ten times its
time."""
ONE_ELEMENT_SLOWDOWNS = np.linspace(0.6, 1.0, 81)
"""The same factors for one uncertain element, whose proof costs less."""
MOST_DRAW_ROUNDS = 1000
"""Times that draws are repeated until enough are plants: with one in a thousand there is nothing to tune for."""

# -- the least mu --------------------------------------------------------------------------------------------

MU_POPULATION, MU_GENERATIONS, MU_SPREAD = 64, 60, 1e-3
"""Candidates, rounds of the evolution, and the relative spread at which it ends. On the mill the least mu of
three seeds is the same to 0.01 %."""
MU_SIMPLEX, MU_DESCENT = (0.2, 0.05), 250
"""Steps of the logarithms with which each descent begins, and its most trials."""
MU_POINTS_PER_DECADE = 12
"""Frequencies of the search; what is found is judged by `robust_performance`, which sharpens peaks."""
NEAR_LEAST_MU, MU_PENALTY = 1.05, 1e3
"""mu may rise by 5 % for larger integral gains; log units of slowness that a rise of 100 % beyond that costs."""
AROUND_STARTS = 10.0
"""The search goes so far beyond the gains and times that are known. Judgement."""
NOT_ALLOWED, LOWEST_LOG_GAIN = 1e6, -50.0
"""Value of candidates that are unstable or beyond the crossover, and the gain (log) below which it stops falling."""
LEAST_TD = 1e-2
"""Of the integral time: where the search begins for a PID whose derivative is off."""

# -- proposals -----------------------------------------------------------------------------------------------

USUAL_PEAK = 2.0
"""Sensitivity peak below which a detuned set of loops is left as it is (Astrom and Hagglund 2006, section 4.6)."""
SAME_SPEED = 0.995
"""A slowing down by less than this is not worth a word."""
WORTH_TUNING = 1.1
"""A loop whose integral gain would rise by less than this factor is left as it is, if it holds the limits. Judgement:
less is not seen in operation."""
COMMON_SLOWDOWNS = np.geomspace(1.0, 0.02, 40)
"""Factors by which loops that disturb each other are slowed down together."""
SLOWEST_CROSSOVER = 1e-6
"""Factor at which the search for a law within the crossover begins."""
UNSEEN = 0.5
"""Dead time times crossover of the SIMC rule at its own closed-loop time."""
LIKE_TODAY, LIKE_TODAY_POINTS = (0.05, 3.0), 200
"""Frequencies, in the crossover, over which a loop is made like the one that the model had: where S is neither 0 nor
1."""
NARROWEST_FILTER, WIDEST_FILTER = 0.01, 1.0
"""Range of the filter ratio that is taken over from a parallel form."""
PHASE_MARGIN = 60.0
"""Degrees, of loop shaping: usual."""
DAMPING = 0.7
"""Relative damping of placed poles: usual."""
PLACED = 0.5
"""Frequency of placed poles times effective dead time: the crossover of the SIMC rule."""

# -- reduction -----------------------------------------------------------------------------------------------

HALF_RULE_ROUNDS = 50
"""Repetitions of the half rule for its own dead time; it settles in a few."""
NEARER_LAG = 1.6
"""A smaller lag takes part against a lead when it is nearer than this ratio (Skogestad 2003, rule T3)."""
FASTER_LEAD = 5.0
"""Dead times above which a lead is slow (the same, rules T1a and T2)."""

# -- controllers by optimal control --------------------------------------------------------------------------

WEIGHT_CORNER, WEIGHT_PEAK, LOAD_WEIGHT = 0.1, 1.5, 0.1
"""The weights at the head of `state_space`: corner of the slow ones as a part of the bandwidth, largest |S|, and the
share of a disturbance at the input. Judgement: the bandwidth does the rest."""
HANKEL_KEPT, MOST_STATES = 1e-4, 8
"""Hankel singular values below this part of the largest are left out of a controller, and its most states. Judgement:
an engineer has to enter it."""
BANDWIDTHS = np.geomspace(2.0, 0.02, 28)
"""Bandwidths tried, in the crossovers, fastest first."""
SINGULAR_GAINS = 1e10
"""Condition number of the gains at rest from which no controller can hold all outputs."""
PADE_ORDER = 2
"""Of the plant that is designed on; the controller is judged with the exact dead time."""

# -- tolerances ----------------------------------------------------------------------------------------------

UNSTABLE = 1e-9
"""Real part of a pole, relative to its size, from which the plant is unstable and not integrating."""
ROUNDING = 1e-9
"""By which a limit may be passed in proofs: rounding of the response."""
DOUBLE_ROOT = 1e-12
"""Rounding that a double root of the series form may leave in its discriminant, relative to the product of the
roots."""

# -- D-K iteration -------------------------------------------------------------------------------------------

DK_ROUNDS, D_ORDER = 4, 4
"""Designs, and corners of each fitted D. On the textbook's column mu falls from 1.179 to 1.036, 1.030 and 1.026; with
two corners it stays near 1.06."""
SLOWEST_WEIGHT = 0.1
"""Of the lowest frequency: poles of weights that are slower are taken there, since the Riccati equations lose all
digits over an integrator."""
NEGLIGIBLE_STATE = 1e-9
"""Hankel value of a state of the design's plant, relative to the largest, below which it is rounding."""
REDUCED_MU = 1.01
"""By how much mu may rise when states are left out of the controller. Judgement."""
LARGE_PEAK = 1e6
"""From which slycot looks for the least peak."""
ABOVE_LEAST_PEAK = (1.002, 1.01, 1.03)
"""Times the least peak for which controllers are made as well; the best of them is kept. Judgement."""
FIT_SHIFTS = (-0.5, 0.0, 0.5)
"""Of the logarithms of zeros and poles apart from each other at the start of the fit of D. Judgement."""
