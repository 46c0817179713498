"""The limits of formulas and the tolerances of transfer functions, each with its reason.

"Judgement" says that a number was chosen by hand.
"""

from __future__ import annotations

import numpy as np

# -- formulas as text ----------------------------------------------------------------------------------------

LONGEST_FORMULA = 2000
"""Characters of a formula. Judgement: what is longer is another file, and parsing takes time that a server lends
out."""
DEEPEST_NESTING = 40
"""Parentheses within each other: the parser is recursive, and Python's stack is not."""
HIGHEST_POWER = 20
"""Of s or a bracket, and ..."""
HIGHEST_ORDER = 60
"""... order of one fraction: the coefficients of higher ones lose all digits in double precision."""
MOST_TERMS = 100
"""Products of a sum that are multiplied out, and dead times that differ."""

# -- equal up to rounding ------------------------------------------------------------------------------------

ROUNDING = 1e-12
"""What is below this share of the size that it would have if nothing cancelled is rounding, and becomes an exact zero:
some thousand times double precision, for the products before it."""
SAME_FACTOR = 1e-9
"""Two factors whose roots agree to this are one factor."""
SAME_DEAD_TIME = 1e-12
"""Relative difference of dead times that are one."""
SCATTER = (np.inf, 1e-1, 1e-2, 1e-3, 1e-5, 1e-7, 0.0)
"""A root of multiplicity m comes back scattered by about eps^(1/m); these are the circles tried, widest first: all
roots the same one, and so on down to all different."""
MULTIPLIED_OUT = 1e-13
"""Share of a coefficient's natural scale by which the product of the roots may miss it."""
WHOLE_SAMPLE = 1e-9
"""A dead time this close to whole samples (relative to one) is taken as whole samples: decimal fractions such as
0.3/0.1."""

LEAST_LAG = 1e-9
"""Time constant that stands for one of 0, in time units: to rounding the element answers a held input at once."""

MOST_DRAW_ROUNDS = 500
"""Times that as many plants are drawn as were asked for, before it is said that almost none can be. Judgement."""

# -- measured step responses ---------------------------------------------------------------------------------

UNSETTLED = 0.05
"""Change from one tenth of a step response to the next, relative to its largest value, from which it has not come to
rest: a ramp changes by a tenth, a first-order response cut off after three time constants by 0.02."""
END_SCATTER = 2.0
"""Of that change in units of the scatter of the coefficients there: below it may be noise. Noise of step tests is
slow, so that means over a tenth scatter hardly less than single coefficients."""
REST = 1e-5
"""Share of its mode to which the slowest pole of a discrete model falls before its step response is cut off."""
AT_ONE = 1e-9
"""Distance of a discrete pole from |z| = 1 within which it integrates: rounding of what was sampled."""
LEAST_COEFFICIENTS, MOST_COEFFICIENTS = 20, 20_000
"""Of the step response of a discrete model, beside what its poles ask for, and in all: thousands of samples to settle
are a sample time far too short for the plant, and every one of them is fitted."""
