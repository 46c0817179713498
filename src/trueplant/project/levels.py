"""Limits of project files and of the simulations that they ask for, each with its reason."""

from __future__ import annotations

MOST_SAMPLES = 50_000_000
"""Of a simulated record: one signal of it fills 0.4 GB of memory. More is a slip in duration or sample_time."""

TIMES = (1e-9, 1e9)
"""Time constants and dead times of a model, in its time unit: a nanosecond, and thirty years. Judgement."""

GAINS = (1e-30, 1e30)
"""Gains of a model: beyond, the squares of what a plant does are no numbers."""

STEPS_PER_TIME_CONSTANT = 20
"""Steps of the simulator in the shortest time constant, where a continuous controller acts between the samples."""

MOST_STEPS = 1000
"""Of the simulator in one sample of the record; more means a sample time 50 times the shortest time constant."""

WHOLE_NUMBER = 1e-6
"""A scan is so many steps if their ratio is this close to a whole number: 0.1 and 0.3 are not exact in binary."""

DECIMALS = 9
"""Of the numbers in a simulated record: what lies beyond is rounding and makes files long."""

ALIKE = 0.5
"""Least likeness (difflib's ratio) of an unknown key to the one offered instead: `ps` for `sp` has just this."""

SHOWN_COLUMNS = 20
"""Column names in an error message; exports have hundreds."""

SHOWN_CHARACTERS = 60
"""Of a wrong value in an error message: half a line of a terminal."""

FEWEST_COEFFICIENTS = 8
"""Of a step response: twice the parameters of a second-order element with dead time."""

EVEN = 1e-3
"""Of a sample: unevenness of the times of coefficients that is rounding of what was written."""

SETTLED_TIMES = 7
"""Longest time constants after which a step response is cut off: a thousandth of its gain is left."""

COEFFICIENTS = 60
"""Of a step response, at least, where nobody says their sample time: what model predictive controllers usually keep."""

MOST_COEFFICIENTS = 1000
"""Of a step response, where nobody says their sample time: more are for no controller to take. Judgement."""

CLOSE_CONVERSION = 0.02
"""Difference of the step responses, as a share of the gain, from which coefficients are taken closer together if that
is possible, and a shorter sample time is named if not. Judgement: what a good step test leaves open."""

FINE = 50
"""Parts of a sample at which a step response is compared with straight lines between its coefficients: it may begin
with a corner between them."""

WORST_CONVERSION = 0.2
"""Difference of the step responses, as a share of the gain, from which a transfer function does not stand for a
measured step response. Judgement: below the 30 % that are worth knowing by default, above the scatter of coefficients
from a step test."""

# -- exclusions ----------------------------------------------------------------------------------------------

NO_ENTRY = 0.1
"""Share of a usable stretch that may be idle beside it without an entry of its own. Judgement: no analysis is hurt by
it, and a second look, which finds the ends of a stretch a little elsewhere, leaves the file as it is."""
