"""Significance levels, thresholds and search ranges of the analysis, stage by stage, each with what set it."""

from __future__ import annotations

# -- data/excitation, bank -------------------------------------------------------------------------------------------

EXCITED = 1e-3
"""Significance of the answer of PV to set-points, for a record to count as excited at all."""
SAME_PROPORTION = 1e-3
"""What is left of the moves of set-points, each scaled to the same size, beside what they have in common, below which
they count as moving in one proportion: rounding."""
FILLED_IN = 0.3
"""Share of a signal that its historian may fill in before the reader is told that the estimate suffers. Half of it
does not show yet in simulated Wood-Berry records, two thirds are a bias (benchmarks/bench_compression.py)."""
BETWEEN = ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))
"""Places from 0 to 1, each with its weight, that have mean and variance of what lies anywhere between (Simpson)."""
MOSTLY_MANUAL = 0.5
"""Share of a record of closed loops in manual from which that is said beside the answer."""
REACHED = 0.01
"""Significance of the answer of a PV or OP whose set-point stands still to what moves elsewhere, to be reached."""
OTHER_TIMES = 199
"""To which the sources are shifted for that: enough for the level above."""
ANSWER_LAGS = 6
"""Lags tried, samples of PV's own past, samples looked at."""
ANSWER_PAST = 10
"""Lags tried, samples of PV's own past, samples looked at."""
ANSWER_SAMPLES = 20_000
"""Lags tried, samples of PV's own past, samples looked at."""
ANSWER_BOUND = 3.0
"""Standard deviations for which a sample counts at most: 99 % of what normal errors tell is kept."""
ANSWER_ROUNDS = 10
"""Of weighing samples by what is left of them, at most."""
ANSWER_SETTLED = 1e-3
"""Change of weights at which they are settled."""
MOST_WORK = 1.2e8
"""Samples times the sum of the squares of the elements of each output: about an hour of one core (16 elements of one
output took 16 s on 2,000 samples, 8 took 5 s)."""

# -- data/setpoints --------------------------------------------------------------------------------------------------

UNEXPLAINED = 1e-3
"""Share of a set-point's moves (squared) that the PVs may leave unexplained if it is computed from them: rounding."""
MOVES_PER_REGRESSOR = 2
"""Moves of a set-point for each regressor, and two more, that it takes to say that it is computed from the PVs."""
SURPRISE = 0.25
"""The largest unexplained move, in root mean squares of all: beyond it someone else moved the set-point, if rarely."""
PREDICTED = 1e-12
"""Share of its moves, unexplained by its own past, below which a set-point is a sine or the like: no PV is needed."""
SETPOINT_LAGS = 10
"""Past samples of every PV, past levels of the set-point, moves looked at."""
SETPOINT_LEVELS = 4
"""Past samples of every PV, past levels of the set-point, moves looked at."""
SETPOINT_MOVES = 20_000
"""Past samples of every PV, past levels of the set-point, moves looked at."""
COINCIDENT = 4.0
"""Ratio of PV's changes (squared) at the moves to those elsewhere, beyond which PV answers within the sample."""
ALONG = 0.5
"""Correlation of PV's changes with those of its set-point, beyond which it does where the set-point always moves."""

# -- data/scan, op_law -----------------------------------------------------------------------------------------------

EXACT_LAW = 5e-4
"""Share of OP's movement that rounding apart is left where OP was written from the recorded samples: a law that also
acts in between leaves little more, as most of what it answers to shows in the next sample."""
LAW_PAST = 4
"""Samples that a law reaches back: two for integral and filtered derivative, two for a set-point filter."""
LAW_SAMPLES = 50_000
"""Samples that are enough to tell."""
LAW_ROUNDED = 1.5
"""Times what rounding would leave if all rounding errors were independent."""
FEWEST_PER_COEFFICIENT = 10
"""Samples for each coefficient, below which nothing can be told."""
LAW_PARTS = 10
"""Parts of the record that are judged on their own: a change of tuning concerns one of them."""

# -- data/law_windows, law_judged, controller_check ------------------------------------------------------------------

CONFIRMED = 0.02
"""A law is not confirmed if it leaves more than this share of OP's own movement (rms)."""
ROUNDING = 1e-6
"""A difference below this share of OP's own movement (rms) is called rounding."""
GAIN_OFF = 0.10
"""A gain of a controller that is off by this has to be found: half of it is the line between right and wrong."""
TIME_OFF = 0.25
"""The same of integral and derivative times."""
BETWEEN_OFF = 1.5
"""Times the declared gain, or that part of it, from which a law is wrong that acts between the samples of its record: a
proportional band taken for a gain, per cent of span for units, are more. Judgement."""
LAW_SURE = 3.0
"""Standard errors by which a gain or time has to be off to be called wrong: once in 400 where nothing is."""
LAW_WINDOWS = 20
"""Windows at least, so that their spread is known to a sixth."""
LAW_TREND_PIECES = 12
"""Of a record, in each of which the integral of the law that is drawn begins anew: a law that is right stays on OP, one
that is not leaves it each time. Judgement."""
LAW_WINDOW = 20
"""Samples of a window at least: several for each part and what it remembers."""
STOOD_STILL = 10.0
"""Times OP's usual move that a law would have moved it by while it stands still, from which it was in manual: a law of
a tenth of the declared gain would have been seen to move it. Judgement."""
SHOWN_BY_HAND = 3
"""Stretches in manual of one OP that a sentence names."""
LAW_BEFORE = 3
"""Windows at least before and after the moment at which a law became another one."""
MOVED_QUANTA = 3.0
"""A PV that moves by less than so many quanta in a window has rounding errors that follow it. With all windows, and
steps of five times the noise, the gain of a simulated loop came out 11 % too small; without these 5 %."""
ROUNDING_LEFT = 0.1
"""Share of the bias taken off for rounding that may be left, as rounding errors are not quite white. Judgement: with
steps of three times the noise the gains of 20 simulated loops were off by 0.6 % on average."""
ROUNDING_DRAWS = 4
"""Simulated roundings of the record: the bias that they stand for is known to a few per cent then."""
STRUCK = 4.5
"""Standard deviations by which a law has to miss a single sample for it to be taken for the historian's error.
Judgement: normal errors do so once in 150,000 samples."""
STRIKING_ROUNDS = 12
"""How often wrong samples are looked for at most: the largest hide the others."""
NEAR_LIMIT = 0.005
"""Distance from a limit, as a share of OP's range, within which OP does not count as free: a historian rounds the limit
too. Judgement."""
WHOLE_SCAN = 1e-3
"""Share of a scan by which it may differ from whole samples."""

# -- data/cascade ----------------------------------------------------------------------------------------------------

FOLLOWS = 0.25
"""Largest |T - 1| that counts as about 1: a slave with a lag of a quarter of the master's 1/w_c."""
T_KNOWN = 0.25
"""Standard error of T beyond which a frequency says nothing of that."""
PLATEAU = 10
"""Samples for which a slave has to stay at a level to count as held there."""
SLAVE_KNOWN = 0.9
"""Share of a stretch in which the slave's set-point has to be recorded for the stretch to be looked at. Judgement."""
AT_LEVEL = 0.02
"""Share of the span of its set-point, noise apart, within which a slave is at a level, or that stands still."""
CLEARLY = 5.0
"""Times that, or the noise, by which a set-point moves clearly. Judgement."""
HELD = 0.02
"""Share of such samples from which it is said."""
STUCK = 0.05
"""Share of samples at which a slave stands still while its set-point moves, from which it is said to stick."""
WORKING = 0.9
"""Share of the power of the slave's set-point below the band's end, where no controller says how fast the master is."""
OWN_SETPOINT = 0.1
"""Share of the slave's set-point that OP may leave unexplained."""

# -- data/nonparametric ----------------------------------------------------------------------------------------------

COHERENCE_LISTED = 100
"""Frequencies kept of a coherence, spread evenly over the logarithm: in result.json, and to be drawn."""
COHERENCE_DRAWN = 400
"""Frequencies kept of a coherence, spread evenly over the logarithm: in result.json, and to be drawn."""

# -- data/band -------------------------------------------------------------------------------------------------------

OUTSIDE_BAND = 0.01
"""Of a plant outside the band, over the whole matrix."""

# -- data/timing -----------------------------------------------------------------------------------------------------

OFF_GRID = 0.05
"""Share of a sample by which PV's updates have to miss whole samples for it to be stale at times. Judgement."""

# -- data/tables -----------------------------------------------------------------------------------------------------

MOST_SPANS = 20
"""Stretches that a finding lists."""

# -- plant/on_grid ---------------------------------------------------------------------------------------------------

CORRECTIONS = 12
"""Times that PV is corrected for what its grid does, at most. Each leaves up to six tenths of what was left before."""
CORRECTED = 0.1
"""Standard errors by which a correction moves a parameter no more where it is the last one."""

# -- plant/disturbance -----------------------------------------------------------------------------------------------

MISDESCRIBED = 1e-3
"""Whiteness of the prediction errors below which a declared disturbance does not describe the record."""

# -- plant/causes ----------------------------------------------------------------------------------------------------

CAUSES = 0.2
"""Part of the chance of a false alarm that a verdict may have, 1 - confidence, which all causes with a test of their
own share alike over the whole study: as much as structures get."""
FEWEST_ERRORS = 200
"""Prediction errors of a stretch below which its disturbance is not compared."""
WORTH_SAYING_AT_LIMIT = 0.02
"""Share of the samples with OP at a limit that is worth saying."""

# -- plant/notes -----------------------------------------------------------------------------------------------------
TIME_UNIT = 2.0
"""All elements answer by a factor faster or slower than the model that is within this one of 60 or 3,600: the unit."""

# -- plant/elements --------------------------------------------------------------------------------------------------

FREQUENCIES = 200
"""Frequencies at which importance and Bode plots are evaluated."""

# -- methods/agreement -----------------------------------------------------------------------------------------------

HOPELESS = 0.5
"""Relative standard error of a gain beyond which a method has nothing to say of the element."""
MOST_NAMED = 4
"""Parameters that a disagreement names."""

# -- methods/paper_forms ---------------------------------------------------------------------------------------------

LARGEST_SEGMENT = 200_000
"""Longer segments are left to the fit."""
MOST_AT_LIMIT = 0.05
"""Share of a record with OP at a limit beyond which the loop does not count as linear."""

# -- loops/robustness ------------------------------------------------------------------------------------------------

STABILITY_DRAWS = 500
"""Plants drawn for the share that today's controller keeps stable: its standard error is at most 2.2 points."""
HIGHEST_MS = 2.0
"""Ms above which a loop is said to be close to instability."""

# -- loops/settled ---------------------------------------------------------------------------------------------------

REFUTED_SHARE = 0.95
"""Share of the plants drawn from an estimate on which a loop that settled has to run away for that to refute it:
one-sided 5 %, where the loop is at the border of stability in truth."""
RUNS_AWAY = 10.0
"""Growth over a record that would be seen; a loop that grows by less may pass for one that settled."""

# -- loops/targets ---------------------------------------------------------------------------------------------------

SPEED = 2.0
"""How many times today's crossover a proposal may have, where the project does not say."""

# -- loops/metrics ---------------------------------------------------------------------------------------------------

NOISE_STEPS = 4000
"""Simulation steps in which noise acts on a loop; the first fifth is left out."""
REPLAY_STEPS = 400_000
"""Longest replay of a record's disturbance, in simulation steps: what bounds the time."""
FINE_STEP = 0.1
"""Largest product of simulation step and crossover for continuous controllers."""
MU_DRAWS = 100
"""Drawn plants on which mu is computed: it is the dearest of the measures."""
MU_POINTS = 40
"""Frequencies of that."""

# -- loops/retuning --------------------------------------------------------------------------------------------------

LIMIT_MS = 1.59
"""Limits where the project states none: Ms of SIMC's tight settings, share of plants, mu."""
LIMIT_SHARE = 0.95
"""Limits where the project states none: Ms of SIMC's tight settings, share of plants, mu."""
LIMIT_MU = 1.0
"""Limits where the project states none: Ms of SIMC's tight settings, share of plants, mu."""
JUDGING_DRAWS = 1000
"""Plants drawn to judge proposals: the standard error of a share of 95 % is 0.7 percentage points."""
BAND_DRAWS = 60
"""Of these, drawn as the band of the responses."""
RESPONSE_POINTS = 300
"""Times of a response that is drawn."""

# -- loops/whatif ----------------------------------------------------------------------------------------------------

TRIED_PLANTS = 100
"""Drawn plants of a what-if's curves, of those that judge: they are to follow a slider (benchmarks: some 20 ms)."""
TRIED_STEPS = (400, 3000)
"""Least and most simulation steps of such a curve: smooth on a screen, and what bounds the time."""
TRIED_SPAN = 2.0
"""Times the median settling time of what is compared: most of it is seen whole, and the fast ones not as a line."""
SAME_CROSSOVER = 0.01
"""By how much a crossover read off a grid may exceed the highest allowed."""
TRIED_SLOWER = 10.0
"""How many times today's integral time, or its inverse, the grid of frequencies serves."""
MOVED_POINTS = 1200
"""Times of a plan's excursion that are drawn: its moves are corners, which are to stay such."""
FAR_OFF = 1e12
"""Stands for a signal that has run away, so that quantiles over plants exist."""

# -- loops/recommendation --------------------------------------------------------------------------------------------

MORE_OVERSHOOT = 0.05
"""Of the step: by how much more a set-point step may overshoot where sound settings for an unchanged plant are given
up. Judgement; with it and the tenth of the settling time benchmarks/bench_settings.py says how often they are kept."""
MORE_PEAK = 0.05
"""By how much Ms may rise there: a little less load error for less margin is another choice, not a better one.
Judgement, as above."""
WORTH_MARGIN = 0.5
"""Below this part of today's load error a loop there was sluggish, and may pay with margin. Judgement."""
WORTH_A_CHANGE = 0.9
"""A proposal has to bring the error of a load step below this part of today's to be worth a change, and
may raise it by no more than a tenth in another loop; where a smaller mu is all there is, mu."""

# -- experiment/moves ------------------------------------------------------------------------------------------------

MOVE_RATIO = (1 + 5**0.5) / 2
"""Loops that are moved at once change at intervals in this ratio, so that their moves never fall into step."""
PLAN_LENGTHS = 200
"""Lengths of a plan at which its information is looked at."""

# -- experiment/known ------------------------------------------------------------------------------------------------

SHORTEST_SLOWEST = 10
"""Samples that the slowest element counts as taking at least."""
USUAL_DAMPING = 0.7
"""Of a pair of which nothing is known."""
GAIN_STEPS = 10
"""Steps in which such a gain is looked for: it is a linear problem."""

# -- experiment/open_questions ---------------------------------------------------------------------------------------

MATTERS = 0.10
"""Change of the loops' answers to their set-points, as a share of what PV moves, below which it does not matter that an
element is open: what the precision that is wanted of a gain amounts to in a loop that follows its set-point."""
MATTERS_SURE = 2.0
"""Standard errors of an element's response that count as what is open of it."""
HARDLY_KNOWN = 0.5
"""The same, above which moves cannot be planned with any certainty: a first test comes before. Judgement."""
FIRST_PRECISION = 0.3
"""The same, that a first test is to reach: with it the second can be planned. Judgement."""
MATTERS_POINTS = 60
"""Frequencies at which that is looked at."""

# -- experiment/stand ------------------------------------------------------------------------------------------------

PLANS_TRIED_ON = 60
"""Plants drawn, each with a disturbance of its own, on none of which a plan may leave the limits: of as many more at
most 1 in 60 would. On the true plant 5 % are allowed (benchmarks/bench_plans.py)."""
DRAWN_AT_MOST = 5
"""Times as many plants are drawn at most, as those on which today's loop would run away do not count."""
FEWEST_TRIED_ON = 10
"""Plants on which today's loop is stable, below which nothing is planned. Judgement."""
DRAWN_SPREAD = 0.5
"""Largest standard deviation of a drawn parameter relative to itself: of what is known worse, nothing is known."""
SHOWN_WIDENED = 1.0
"""Part of the range that a record shows of PV or OP which counts as allowed beyond it to each side, where no limits are
declared. A record mostly ends at one end of its range, and moves go as far to both sides. Judgement."""
LATELY = (3.0, 10.0)
"""Lags and dead times of the slowest element, at the end of the records, in which OP is averaged at least and at most:
long enough for its noise to be small, and short enough to be today."""
WANDERS = 1.0
"""Lags and dead times of the slowest element in which PV and OP are averaged to see how their rest wanders."""
PERCENT = (0.0, 100.0)
"""Where a signal in per cent can be, unless the record says otherwise."""
WELL_AFTER = 2
"""Lags and dead times of the slowest element after a move that are not averaged, where the record goes on so long."""
LARGER_DISTURBANCE = 1.4
"""Times what the noise model says: short records take a part of the noise for the plant. Without it, PV or OP left the
limits in 10 to 20 % of the runs of some plans in part 1 of benchmarks/bench_plans.py."""
SLOW_NOISE = 0.05
"""Time constant of a noise model, over the length of its record, beyond which it is taken for a drift without end: the
record cannot tell them apart. Judgement."""
BURN_IN = 500
"""Samples after which simulated noise has forgotten its start."""

# -- experiment/plans ------------------------------------------------------------------------------------------------

MOVE_INTERVALS = (0.5, 1.0, 2.0, 4.0)
"""Times from one move to the next that are tried, in lags and dead time of the slowest element."""
SHIFT = 8.0
"""Hours of the longest test, where the project does not say."""
LONGEST_PLAN = 150.0
"""Longest plan that is tried out, in lags and dead time of the slowest element."""
LONGEST_FORETOLD = 100.0
"""How many times longer than what was tried out a test is foretold to take, before it is said that none would do."""
SETTLING = 5.0
"""Lags and dead times of the slowest element after the last move in which the limits are looked at as well."""
LOWEST_OF_SLOWEST = 0.01
"""The lowest frequency looked at, over the reciprocal of lag and dead time of the slowest element: all is at rest."""
LARGER_MOVES = 2.0
"""A plan may move a set-point by so many times what the record saw; the first of two no further than that."""
PLAN_SAMPLES = 100_000
"""Of a plan that is tried out."""
LEAST_ROOM = 0.02
"""Share of the moves wished for below which the limits leave no room for any."""
SPAN_PART = 0.05
"""Part of its instrument's span that a signal is moved by which has not moved in the record."""
SIZED_TWICE = 6
"""How often a plan is made smaller, and therefore longer, until it keeps the limits on all plants drawn."""

# -- curves ----------------------------------------------------------------------------------------------------------

STEP_POINTS = 200
"""Times of a step response that is drawn."""
STEP_DRAWS = 200
"""Plants drawn for its band."""
STEP_NEGLIGIBLE = 0.01
"""Of a declared step response, as a share of its largest value, by which it may leave the band before it is said: in
the dead time the band has no width, and coefficients are rounded."""
SHOWN_SPANS = 3
"""Stretches outside of the band that a note names."""
GRADED_WHITE = 1e-3
"""p-value of the whiteness test below which an estimate does not get a grade that retuning may rest on."""
