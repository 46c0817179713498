"""The thresholds, search ranges and precisions of margins and of structured singular values, each with its reason.

"Judgement" says that a number was chosen by hand. What the searches miss is seen in their results: every mu comes with
a lower and an upper bound (benchmarks/bench_mu.py compares both, and the time, with slycot).
"""

from __future__ import annotations

# -- frequencies that are looked at --------------------------------------------------------------------------

PER_DECADE = 60
"""Points of a grid of frequencies. Judgement: steps are halved where the response turns faster."""
SLOWEST, FASTEST = 1e-5, 1e3
"""The grid goes from so many times the slowest to so many times the fastest rate: crossings far from all rates need
gains that far from 1."""
LIGHT_DAMPING = 0.3
"""Ratio of real to imaginary part below which a pole or zero makes a resonance that a grid could miss."""
LEAST_DAMPING = 1e-5
"""Damping that an undamped one is taken to have for the grid."""
AROUND_RESONANCE = (0.01, 30.0)
"""Points are set between these multiples of its decay rate from it, on both sides."""
TURN = 0.3
"""Largest change of log L and of log (1 + L) over one step of a followed response, and of the angle by dead time."""
FLOOR = 1e-3
"""Size of L below which it need not be followed: S and T are 1 and 0 there to a thousandth."""
MOST_FOLLOWED = 20_000
"""Points at most: a loop that turns on and on without dying out never ends."""
MU_PER_DECADE, MU_TURN, MU_FLOOR, MU_MOST = 12, 0.5, 0.1, 1500
"""The same for mu, which costs far more a point and is sharpened between them afterwards."""
REST = 1e-9
"""Of the slowest rate: the frequency that stands for the limit omega -> 0."""
GROWS_AT_REST = 5.0
"""Growth of a bound over the two decades before it from which the limit is infinite: an integrator grows by 100."""
BESIDE_POLE = 1e-9
"""Relative distance at which a response is taken where a system has an undamped pole."""

# -- peaks and crossings -------------------------------------------------------------------------------------

PEAK_PLACE = 1e-7
"""Relative precision of the frequency of a peak; its value is then right to the square of that."""
PEAK_VALUE = 1e-6
"""Relative precision of a peak of mu."""
RIVALS = 50
"""Local maxima on the grid that are sharpened. Judgement: the highest is among them."""
MU_RIVALS = 5
"""The same for mu, which costs more."""
RIVAL_SHARE = 0.8
"""Share of the largest value on the grid below which a local maximum of mu cannot become the highest. Judgement."""
REAL_CROSSING = 1e-5
"""Imaginary part, relative to the real one, with which a response counts as crossing the real axis: at an undamped pole
the imaginary part changes sign as well, through infinity."""

# -- mu: upper bound -----------------------------------------------------------------------------------------

SMALLEST_GAP = 1e-9
"""Distance of the logarithm of the bound from its least value at which the search ends."""
LONGEST_LOG = 150.0
"""Of a scaling: reducible matrices reach their bound only in the limit of infinite scalings."""
SWEEPS = 6
"""Sweeps of Osborne's balancing before the search. Judgement: it only has to come near."""
BALANCING_FLOOR = 80.0
"""Logarithm below the largest element to which zeros are lifted, so that blocks without way back are scaled away."""
FIRST_BARRIER, BARRIER_GROWTH = 10.0, 30.0
"""Weight of the objective against the barrier at the start (times the size), and its growth. Judgement, by time."""
MOST_NEWTON, NEWTON_DECREMENT = 12, 0.1
"""Newton steps at one weight, and the decrement at which they end: there the next weight does the rest."""
LONGEST_STEP = 2.0
"""Change of the logarithm of a scaling (squared) in one step: by e."""
MOST_HALVINGS = 10
"""Of a step that does not lower the barrier; afterwards that matrix keeps its scaling."""
NO_SLOPE = 1e-6
"""Slope of log sigma at which a simple singular value is at its minimum."""

# -- mu: upper bound with real parameters ---------------------------------------------------------------------

MIXED_GAP = 1e-7
"""Distance of the squared bound from its least value, relative to itself, at which the search ends."""
MIXED_FLOOR = 1e-12
"""The same relative to the bound of complex mu: what is smaller is lost in rounding."""
ABOVE_ROUNDING = 100.0
"""Times the rounding of an eigenvalue that the search keeps away from it: G may grow far beyond M. Judgement."""
LEAST_CURVATURE = 1e-10
"""Of the barrier, relative to the largest: D and G can grow together without any change."""

# -- mu: lower bound -----------------------------------------------------------------------------------------

TIGHT = 1e-7
"""Relative distance from the upper bound at which the search for a lower one ends."""
FIRST_CLIMB, SECOND_CLIMB, RANDOM_CLIMB = 6, 40, 80
"""Steps of the power iteration from the largest singular vector, from the mixture of two, and from random ones."""
RANDOM_STARTS = 6
"""From random vectors, where the first two attempts do not reach the upper bound. Judgement."""
RANDOM_WEIGHT = 0.7
"""Factor from one singular vector to the next in a random start: the larger ones are more likely. Judgement."""

# -- mu: lower bound with real parameters ---------------------------------------------------------------------

MIXED_STARTS = 16
"""Corners of the box of parameters from which the search starts: all of four parameters. Judgement."""
REAL_CORNERS = 128
"""Corners at which real eigenvalues are looked at, which costs far less: all of seven parameters. Judgement."""
MIXED_TIGHT = 1e-5
"""Relative distance from the upper bound at which the search ends, and gain of one start that is worth another."""
PATIENCE = 8
"""Starts in a row without a gain after which a matrix is left alone. Judgement, by time."""
MIXED_STEPS, REAL_STEPS = 30, 40
"""Linear programmes of one search, with complex blocks and without. Judgement, by time."""
FIRST_TRUST, LEAST_TRUST = 0.5, 1e-7
"""Trust region of the parameters relative to their box, at the start and where the search ends."""
OFF_AXIS = 10.0
"""Price of the part of an eigenvalue beside the real axis, which the search wants at zero. Judgement."""
POLISHING = 6
"""Newton steps that put the eigenvalue onto the real axis in the end."""
ON_THE_AXIS = 1e-10
"""Part beside the axis of an eigenvalue that is worth a check."""
ROOT = 1e-6
"""Imaginary part, relative to the real one, with which the root of a polynomial counts as real: two roots that meet are
right to half the digits. What it lets in is checked afterwards."""
HALVINGS = 40
"""Of the interval in which the dual of a linear programme is solved."""
PROVED = 1e-12
"""Smallest singular value of I - M Delta, relative to the largest or 1, that counts as zero: rounding, so Delta is a
perturbation that the loop does not survive."""
SINGULAR = 1e-13
"""Singular value below which a matrix is not inverted, relative to the largest or 1."""
NO_BOUND = 1e6
"""Size of a perturbation, in units of the smallest possible one, that stands for none."""

TINY = 1e-150
"""Norm below which a vector is 0: its square is still a number."""

# -- skewed mu -----------------------------------------------------------------------------------------------

WORST_GAIN = 1e-7
"""Precision of the logarithm of the worst gain."""
SECANT = (0.02, 0.98)
"""A secant stays between these shares of the interval, so that it always shrinks."""

# -- weights and perturbed plants ----------------------------------------------------------------------------

STANDARD_DEVIATIONS = 0.01
"""Step of the differences along the axes of the ellipsoid, in standard deviations: the weight is of first order."""
CONFIDENCE = 0.95
"""Of the ellipsoid: usual."""
CORNER_QUANTILES = (0.1, 0.35, 0.65, 0.9)
"""Quantiles of the logarithms of the frequencies from which the corners of a covering weight are searched. Judgement:
the search is local, and has several minima."""
WIDEST_ARC = 3.0
"""Angle by which an uncertain dead time may turn before a complex number stands for it: at pi the tangent of its half
is infinite. Judgement."""
REAL_ANGLE = 1e-6
"""Angle below which a value is real: at rest rounding alone would ask for an all-pass of endless lag."""
