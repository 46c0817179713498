"""The thresholds of reading, screening and excitation, each with its reason or the measurement that set it.

"Judgement" says that a number was chosen by hand: the tests of this room show that it works on simulated and public
records, and no measurement says that another would do worse.
"""

from __future__ import annotations

NORMAL_MAD = 1.4826
"""Standard deviation of a normal variable in units of its median absolute deviation."""

# -- reading -------------------------------------------------------------------------------------------------

FEWEST_ROWS = 10
"""Rows with OP and a PV, below which a file is no record. Judgement: a first-order element alone has 3 parameters."""
LARGEST_VALUE = 1e30
"""Larger numbers are error codes of a logger, such as the largest one of 4 bytes, 3.4e38."""
SENTINELS = tuple(
    float(sign * code) for code in (999, 9999, 99999, 999999, 32767, 32768, 65535, 2147483647) for sign in (1, -1)
)
"""Numbers that historians and control systems write where there is no value: nines, and the ends of integers."""
SENTINEL_AWAY = 3.0
"""Ranges of all other values by which such a number lies off them. Judgement: a measurement that happens to be 999
has neighbours."""
SENTINEL_STEP = 0.1
"""Share of the size of all other values by which it lies off them at least: a set-point that was constant at 998 has no
range, and may go to 999. Judgement."""
MOST_CELLS = 200_000_000
"""Cells of a table that is read: 1.6 GB as numbers."""
MOST_SHEET_CELLS = 50_000_000
"""Cells of an Excel sheet that is read: they are laid out as text first, some 100 bytes each."""
MOST_UNPACKED = 2_000_000_000
"""Bytes that a workbook unpacks to."""
STAMP = 1e-6
"""Seconds by which stamps that are kept to the microsecond may miss a moment of a grid, and the share of a step."""
BLOCK = 1 << 18
"""Samples that are looked at at once where that bounds memory."""
MOST_SPANS = 1000
"""Stretches of a finding that are listed: more are for nobody to read."""
HEAD_BYTES = 4096
"""Bytes of a file by which its format and encoding are known."""
BLOCK_BYTES = 1 << 24
"""Bytes of a text file that are cut into cells at once: some ten times as much memory is needed for that."""
START_ROWS = 1000
"""Rows of a table by which is decided what of it will be used."""
MOST_SECONDS_APART = 60
"""In which a workbook that cannot be measured has to be read: a full sheet of an .xls file takes half of it."""
MOST_MEMORY_APART = 4_000_000_000
"""Bytes that it may take meanwhile: four times those of a full sheet."""
SAME_INSTANT = 1e-3
"""Share of a sample by which two stamps of one instant may differ."""
YEARS = (1990, 2100)
"""Between which the moments of a record lie."""
SERIAL_STEP = 0.05
"""Days between samples up to which numbers from 33,000 to 73,000 may be serial days. Judgement: an hour is 0.042."""
ROUND_STEP = 0.01
"""Millionths by which the steps of a count are off whole millionths. Eight bytes leave a hundred-thousandth of it."""
MOST_INTERPOLATED = 50.0
"""Median steps that an irregular record is interpolated over: a grid must not be a hundred times the record."""
MOST_MODES = 40
"""Different values of a mode column: more are those of something else. Judgement: systems know some fifteen modes."""
SHOWN_WORDS = 4
"""Different words of a column that a message shows."""
SNIFFED_LINES = 300
"""Lines from which separator and header are found. Judgement: logger headers have some tens of lines."""
BANNER_LINES = 20
"""Lines below a date or a number in which the header may still follow. Judgement: exports begin with some lines on who
asked for what."""
SAME_WIDTH_SHARE = 0.3
"""Share of the sniffed lines that a separator must cut into cells. Low, because a header may be most of a short
file."""
UTF16_ZEROS = 0.4
"""Share of zero bytes at even or at odd places from which text is taken for UTF-16. It would be 0.5 for plain ASCII;
judgement leaves room for other letters."""
TEXT_ZEROS = 0.05
"""Share of zero bytes at the other places up to which it still is UTF-16. Judgement."""
TEXT_CONTROLS = 0.02
"""Share of control characters from which a file is binary. Judgement: text has none but a stray one."""
RAGGED_SHARE = 0.2
"""Share of lines with another number of fields from which decimal commas are the likely cause. Judgement: a spoilt line
is a single one."""
NEAR_NAME = 0.6
"""Similarity (difflib) from which a name is offered as "did you mean": the library's own default."""
MOSTLY = 0.5
"""Share of a column from which it is of a kind: quality codes in words, good codes, numeric time, backward steps."""
GOOD_OPC = 192
"""Smallest good quality code of OPC Data Access: both upper bits of the byte set."""
LARGEST_OPC = 255
"""Quality codes of OPC are one byte."""
LOST_TIMES = 0.01
"""Share of rows without a time, and of rows out of order, up to which they are left out or sorted in. Judgement: more
is no slip of the logger but another format, or several runs in one file."""
REPEATED_TIMES = 0.25
"""Share of rows with the time of the row before, from which stamps may be too coarse. Judgement: a logger repeats one
now and then, and stamps that were cut to minutes repeat in every second row at least."""
CLOCK_CHANGE = (1800.0, 3700.0)
"""A step back by so many seconds is offered as the autumn change of the clock: one hour (half an hour on Lord Howe
Island), and a sample more."""

# -- resolution -------------------------------------------------------------------------------------------------

LISTED = 100_000
"""Changes of a signal that are looked at in one go."""

# -- grid and segments ---------------------------------------------------------------------------------------

SHORT_GAP = 3
"""OP and set-point hold their last value over so many missing samples; after more a new segment begins. Judgement: a
logger that drops single rows does not break a record, and a held value is wrong for three samples at most."""
SHORTEST = 10
"""Samples of the shortest segment; shorter ones are left out. Judgement: each costs an initial state of its own."""
EVEN_STEPS = (0.5, 1.5)
"""Steps within these multiples of the median count for the sample time: neither a repeated nor a missing row does."""
JITTER = 0.05
"""Deviation of the steps from whole samples (rms, in samples) up to which the grid is taken as even. Judgement: PV then
is read at most some per cent of a sample off its time."""
JITTER_SAID = 1e-3
"""Jitter (rms, in samples) from which it is said. Judgement: below it the stamps are merely printed."""
ROUNDED_KINDS = 12
"""Different step lengths that rounded stamps of an even clock may show: rounding leaves two, gaps up to SHORT_GAP add
two each. Judgement leaves room."""
ROUNDED_WHOLE = 1e-3
"""How far these lengths may be from whole multiples of the rounding unit, in units of it."""
ROUNDED_DRIFT = 2.01
"""Rounding units by which the summed steps may leave an even clock: one for each end, and rounding."""
ROUNDED_UNIT = 0.9
"""The rounding unit must be below this share of a sample: otherwise every sequence of steps is a rounded even one."""
LONG_STEP = 0.9
"""Quantile of the steps of an irregular record that a gap must exceed (times SHORT_GAP). Judgement."""
NEAR = 1.5
"""Samples between which PV is interpolated on an irregular record. Judgement: one is missing at most."""

# -- what of a record can be used ----------------------------------------------------------------------------

FEWEST_USABLE = 20
"""Usable samples of some PV, below which nothing can be said. Judgement."""
MOST_FILLED_OP = 0.55
"""Share of an OP that its historian may have filled in. A smoothed OP is another input than the plant's, of which the
residuals show nothing: in simulated Wood-Berry records with two thirds filled in, intervals miss a quarter of the gains
and a third of the time constants, with four fifths nearly all of them (benchmarks/bench_compression.py)."""
MOST_FILLED_PV = 0.85
"""Share from which on such a PV is left out. In simulated Wood-Berry records with more than that, a third of the
intervals of dead times miss the truth (benchmarks/bench_compression.py)."""
COMPRESSED = 0.05
"""Share of filled-in samples from which compression is a finding. Judgement: the result bears a note only where much
more is filled in, and the engineer should know before."""
OP_LIMIT = 1e-4
"""Distance from a declared OP limit, as a share of its range, that counts as being at the limit: rounding of 0 to 100 %
printed with two decimals."""
PV_LIMIT = 1e-6
"""The same for the range of a PV, which a sensor reaches exactly."""

# -- limits of OP that nobody declared -----------------------------------------------------------------------

PLATEAU_VALUES = 20
"""Different values of OP, below which it is switched and not limited. Judgement."""
PLATEAU_SAMPLES = 5
"""Samples of a run at the extreme value, and times the usual run, from which it is a plateau; also the samples of all
plateaus together. Judgement."""
PLATEAU_SHARE = 0.01
"""Share of the record that the plateaus must make up. Judgement."""
PLATEAU_ERROR = 0.02
"""Standard deviation of the control error on the plateau, as a share of its usual one, from which the controller would
have moved OP. Judgement."""

# -- one PV: held, quantised ---------------------------------------------------------------------------------

FEWEST_UPDATES = 20
"""Changes of a PV from which its updates, its quantum and its stops can be judged. Judgement."""
SHORTEST_UPDATE = 0.02
"""Quantile of the intervals between changes that stands for the shortest: a few are split by a change of quantum."""
HELD_SAMPLES = 2
"""Samples between changes from which a PV may be held: with less it changes at nearly every sample."""
SINGLE_UPDATES = 1.7
"""Intervals up to this multiple of the shortest are one update long, and give the mean; two updates are twice as
long."""
FEW_UPDATES = 3.3
"""Intervals up to this multiple of the mean are checked to be whole multiples; longer ones fit by chance."""
WHOLE_UPDATE = 0.3
"""Distance from a whole multiple, in updates, that counts as one: chance reaches it with a probability of 0.6."""
HELD_SHARE = 0.9
"""Share of the intervals that must be whole multiples. Judgement: far above the 0.6 of chance."""
SETTLED_MOVE = 1e-9
"""Change of a PV relative to its size that is rounding: a settled simulation is not quantised by it."""
SMALLEST_MOVES = 0.05
"""Quantile of the moves that stands for the smallest, so that single odd ones do not. Judgement."""
SAME_QUANTUM = 1.3
"""Moves up to this multiple of the smallest are one quantum, and two quanta are twice as long."""
QUANTUM_ROUNDS = 3
"""Least-squares corrections of the quantum, each with the multiples that the one before has found. Judgement."""
MOST_QUANTA = 10
"""Moves of up to so many quanta are used: with larger ones an error of the quantum grows into half of it."""
FEWEST_QUANTA = 10
"""Moves needed for it. Judgement."""
QUANTUM_MOVES = 1_000_000
"""Moves, spread evenly over longer records, that are looked at: more tell no more."""
WHOLE_QUANTUM, WHOLE_QUANTUM_SHARE = 0.12, 0.95
"""So many of the moves must lie so near to whole quanta: chance reaches the distance with a probability of 0.24."""
DISTINCT_MOVES = 0.5
"""Share of different moves from which the signal is not quantised: quanta make moves repeat. Judgement."""

# -- one PV: spikes ------------------------------------------------------------------------------------------

SPIKE_UPDATES = 9
"""Updates needed: three on each side of three."""
SPIKE_SCALE = 4.5
"""Spikes exceed this many standard deviations of the changes between updates, on both sides: normal noise does so once
in 150,000 samples on one side, and hardly ever on both."""
SPIKE_QUANTA = 3.5
"""And this many quanta: rounding alone makes jumps of one, and of two in a moving signal. Judgement."""
SPIKE_SAMPLES = 3
"""Longest spike in samples. Judgement: what lasts longer may be the plant."""
SPIKE_HELD = 1.5
"""Longest spike of a held PV in updates: one, whose length varies."""
SPIKE_SMOOTH = 2.0
"""A spike must be larger than its neighbours' own differences by this factor: a smooth peak is not. Judgement."""

ANSWER_SAMPLES = 10
"""Within which PV follows a set-point that is moved and put back within as few samples as a spike has. Judgement: a
loop that takes longer shows no excursion as short as that."""
ANSWER_SHARE = 0.5
"""Of such an excursion of PV that the set-point's was at least. Judgement."""

# -- one PV: frozen ------------------------------------------------------------------------------------------

FROZEN_SAMPLES = 10
"""Shortest stop that may be a frozen sensor, in samples. Judgement."""
FROZEN_TIMES, FROZEN_USUAL = 10, 0.95
"""And so many times this quantile of the lengths of stops. Judgement: ten times what this PV does otherwise."""
FROZEN_AROUND = 20
"""Changes before a stop (after it, at the start of a record) that tell whether it can be a rest. Judgement."""
FROZEN_BEFORE = 5
"""Changes needed before it for that, and the last ones looked at."""
FROZEN_TURNS = 0.25
"""Share of changes of direction from which PV was noisy: white noise turns in two thirds of its steps, a smooth signal
hardly ever."""
FROZEN_NOISE = 1e-6
"""Size of these changes, as a share of PV's range, from which they are noise and not rounding."""
FROZEN_MOVING = 1e-4
"""Size of each of the last changes, as a share of PV's range, from which PV was moving when it stopped. Judgement."""
FROZEN_QUANTA = 2
"""And in the smallest changes of that PV, so that a signal that slows down over its last quanta is at rest."""
FROZEN_OP = 0.05
"""Share of its range that OP moves meanwhile: a plant in which nothing moves has a right to rest. Judgement."""

# -- one PV: outliers ----------------------------------------------------------------------------------------

OUTLIER_QUANTILES = (0.05, 0.95)
"""Between them lie the usual values. Judgement."""
OUTLIER_RANGES = 5
"""Distance from them, in their range, from which a value is far from all others: 18 standard deviations from the mean
of normal data."""
OUTLIER_SHARE = 0.02
"""Share of samples from which it is no outlier but another operating point. Judgement."""

# -- straight lines drawn by a historian ---------------------------------------------------------------------

ON_LINE = 2.5
"""Resolutions by which rounding alone takes a sample off its line, at most: half of one at each of the three points
that make a second difference (1/2 + 2 1/2 + 1/2 = 2), and rounding of the time."""
CORNER = 7.5
"""Resolutions from which lines meet in a corner. A smooth signal bends less, a noisy one seldom as little as a line.
Judgement: three times ON_LINE."""
FLAT = 3.0
"""Resolutions a sample that do not count as a rise: nothing can be said of what stands still."""
SLOPES = 20
"""Different slopes that there have to be: ramps of an operator, rate limits and integrators at rest have a few."""
ABOVE_CHANCE = 2
"""Samples on lines must be so many times what chance would put there. Judgement."""

# -- excitation ----------------------------------------------------------------------------------------------

SAME_PROPORTION = 0.02
"""Singular value of the scaled moves, relative to the largest, below which a direction counts as missing. Judgement: an
estimate in that direction has 50 times the standard error of the others."""
WELCH_WINDOWS = 8
"""Windows of the averaged spectral matrix, at least twice the number of signals: its condition number needs more
averages than signals. Judgement."""
LONGEST_WINDOW = 1 << 18
"""Samples of a window, however long the record: finer frequencies tell no more, and memory stays bounded."""

# -- transforms -----------------------------------------------------------------------------------------------

SERIES_BELOW = 1.0
"""Size of s h below which the moments of a step are taken from their power series: the recursion loses digits there,
and 18 terms of the series give all of them."""

# -- moves ---------------------------------------------------------------------------------------------------

ALWAYS_MOVING = 0.2
"""Share of samples at which a set-point changes, from which on it is said to change all the time: no operator moves it
at every fifth sample, while one that is computed changes at nearly all. Judgement."""
