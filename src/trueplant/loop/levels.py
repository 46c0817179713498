"""The thresholds of the stability count and of simulation, each with its reason.

"Judgement" says that a number was chosen by hand; the tests compare counts with those of rational loops and with
simulations that settle or run away.
"""

from __future__ import annotations

# -- the line along which det(I + G Q) is followed -----------------------------------------------------------

LEFT_OF_AXIS = 1.0137e-7
"""Distance of the line from the imaginary axis, in the slowest rate of the loop: tiny against all rates, so that only
integrators lie between; an odd number, so that no pole of a round number lies on it."""
LEFT_WHEN_SAMPLED = 1e-10
"""Its least value in units of 1/scan: e^(-sigma h) must differ from 1 in double precision."""
MOST_POINTS = 400_000
"""Points on the line from which the question is given up. Judgement: only loops need as many that are at their limit of
stability."""
FIRST_POINTS = 600
"""Points that the line begins with, on a logarithmic grid. Judgement: steps are halved where it takes more."""
LARGEST_CHANGE = 0.6
"""Distance of the eigenvalues of one step's change from 1: below 1 no determinant can turn by half a circle unseen."""
DEAD_TIME_TURN = 1.0
"""Angle (rad) by which the dead time may turn in one step, for the same reason ..."""
QUIET_LOOP = 0.5
"""... unless |I + G Q| differs from I by less than this, summed over both ends: then it cannot encircle 0."""
UNDECIDED = 0.05
"""Distance of the count from a whole number from which it is not answered. Judgement: far above rounding, far below
1."""

# -- multiplicity of unstable open-loop poles ----------------------------------------------------------------

SAME_POLE = 1e-4
"""Relative distance up to which poles count as one cluster: a triple root is scattered by eps^(1/3) = 6e-6."""
OTHER_POLE = 1e-3
"""Relative distance from which a pole is another one, outside the circle of integration."""
CIRCLE = 0.4
"""Radius of that circle in the distance of the nearest other pole: below a half."""
CIRCLE_POINTS = 64
"""Points on it: what is outside decays with 0.4^64 there."""
MOST_MULTIPLE = 8
"""Highest multiplicity that is looked for. Judgement: matrices of integrators of that size are not met."""
NO_POLE = 1e-6
"""Laurent coefficients below this share of the largest response on the circle are rounding."""

# -- high frequency ------------------------------------------------------------------------------------------

FAR = (1e8, 1e9)
"""Frequencies, in the fastest rate, between which the gain must not grow: there a proper loop is constant."""
GROWING, GROWING_FROM = 2.0, 1e-3
"""Growth between them (an improper loop grows by ten), beyond a size that rounding does not reach."""
ILL_POSED = 1e-6
"""|det(I + D)| relative to the size of the feedthrough D from which the loop is taken as algebraically singular."""
SMALL_LOOP = 0.5
"""Largest eigenvalue of the loop beyond the top frequency, with which I + L cannot turn round 0."""
LEVELS_OUT = 0.5
"""Share of the value ten times lower in frequency from which the loop gain no longer falls: a lag divides it by ten."""
BELOW_ONE = 0.99
"""A gain that levels out below this never reaches 1; above it a loop behind a dead time has infinitely many poles."""

# -- simulation ----------------------------------------------------------------------------------------------

WHOLE_SCAN = 1e-6
"""Steps by which a scan may differ from whole steps: decimal fractions such as 0.1."""
DECAYED = 1e-6
"""Part of its start that a stationary disturbance still bears when its record begins: far below what is measured."""
