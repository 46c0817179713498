"""The thresholds and sizes of tracking, each with its reason or the measurement that set it.

"Judgement" says that a number was chosen by hand; benchmarks/bench_track.py measures false alarms, detection and the
coverage of intervals that come of all of them together.
"""

from __future__ import annotations

# -- what is asked of a window -------------------------------------------------------------------------------

PRECISION = 0.1
"""Relative standard error of gains, time constants and dead times (of these relative to lag and dead time). Judgement:
a change by half between two windows is then three and a half standard errors."""
LARGEST_PRECISION = 0.5
"""More cannot be asked for: an interval would contain 0."""
FEWEST_ERRORS = 200
"""Prediction errors in a window: with fewer the noise model is not worth its name. Judgement."""
SETTLED = 5.0
"""Lags after which a move no longer counts as excitation: e^-5 is below 1 %."""
LEAST_SETTLINGS = 3.0
"""Settling times in a window: in less its unknown initial state costs more than SHORTFALL allows for."""
SHORTFALL = 1.1
"""Unknown initial states cost a window that much of its standard errors on top of those that the information
predicts."""
LONGEST = 0.25
"""Share of the record at which a window ends though it knows the plant less well than was asked for. Judgement: a
history has four windows at least."""
MOST = 80
"""Windows of one output: where there would be more, they are longer and more precise than was asked for. Judgement: of
more nobody reads the figure, and each is a fit."""
CLOSER = 0.95
"""Factor on the precision, beyond the square root of the number of windows, with which they are planned again."""
BESIDE_CHANGE = 0.5
"""Share of FEWEST_ERRORS from which the rest beside a change is a window all the same: it says what the change was."""
IDLE = 2.0
"""Settling times from which a stretch without moves is shown as one that cannot be estimated."""

# -- planning them -------------------------------------------------------------------------------------------

PILOT = 4000
"""Prediction errors of the first estimate, from which the windows are planned. Judgement."""
PILOT_GROWTH = 4
"""Factor on its length where a gain is not identifiable yet."""
LAST_STRETCH = 1.5
"""A rest shorter than half a stretch is put to the one before when the one with most moves is looked for."""
BLOCKS_PER_SETTLING, SHORTEST_BLOCK = 10, 16
"""Blocks of the information in a settling time, and the prediction errors of the shortest one."""
CHUNK = 20_000
"""Prediction errors looked at together: what bounds the memory."""
WARM = 2.0
"""Settling times before each chunk from which its responses start."""
NO_INFORMATION = 1e-12
"""Eigenvalues of the scaled information below this are none: a parameter without any gets a very large standard
error."""

# -- changes -------------------------------------------------------------------------------------------------

ANSWERED = 0.8
"""A parameter takes part in the history of its element if so many windows answer it. Judgement."""
MOST_CHANGES = 20
"""Steps looked for. Judgement: a record with more of them is better cut by hand."""
AROUND = 2
"""Windows on each side of a step that date it: more would bring in other changes, fewer leave the parameters open."""
LEAST_TO_SHAPE = 3
"""Full estimates that tell a step from a drift."""
UNDATED = 5.0
"""In this part of a settling time (a fifth) at both ends of the dated stretch no step is looked for: PV has not
answered yet."""

# -- usable stretches of a long history --------------------------------------------------------------------------

AUTOMATIC = 0.5
"""Share of a settling time after a move in which OP has to be free for the move to count: a kick of the controller may
touch a limit for some samples, and loops that are put to manual at once show nothing. Judgement."""
FIRST_SETTLED = 100
"""Samples taken for the settling time until a first estimate knows it, where the model has no lag."""
FEWEST_AROUND = FEWEST_ERRORS / 4
"""Prediction errors before and after the moves of a stretch where the plant settles in fewer: a stretch then has about
as many as a window."""
JOINED = 3.0
"""Settling times without a move after which a stretch ends: what lies between is idle, and the disturbance moves on."""
LONGEST_FOUND = 60.0
"""Settling times of the longest stretch; longer ones are divided, so that the best part of a history can be taken.
Judgement: thirty moves told apart are enough for one analysis."""
MOST_FOUND = 20
"""Stretches that are ranked: of more nobody reads the table, and an analysis gains little by them. Judgement."""
MOST_CANDIDATES = 2000
"""Stretches that are weighed against each other; of more, those with most moves."""
