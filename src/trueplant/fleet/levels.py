"""The limits and sizes of an audit, each with its reason."""

from __future__ import annotations

WHOLE_DAYS = 2 * 86_400
"""Seconds from which a window before now ends with a whole day: an audit every night is one a day."""
GRACE = 20.0
"""Seconds that a loop past its deadline has to notice it, before its worker ends itself. The longest call without a
look at Python is the compiling of one function, a few seconds. Judgement."""
AGAIN = 5.0
"""Seconds after which a loop that goes on is told once more that its time is up. Judgement."""
DIED = 75
"""Exit status of a worker that ended itself at the deadline; nobody but a log sees it."""
AHEAD = 4
"""Tasks that are handed out for each worker: enough that none waits, few enough that a client of 10,000 loops stays
small."""
ALLOWED_DEATHS = 1
"""Workers that may die of a loop before it is given up: the first death may have been somebody else's."""
AT_ONCE = 1 << 20
"""Bytes of a file that are read at once for its sum."""
CONNECT = 30.0
"""Seconds that a cluster has to answer, and to have a first worker. Judgement."""
SHOWN_NEW = 200
"""Names that the page lists of what is new; all of them stand in the table. Judgement."""

# -- the demo site: judgement, so that every fault is one that an engineer would want to know of ---------------

DEMO_LEVEL = 50.0
"""Where every loop is run."""
DEMO_MOVES = 8
"""Fewest set-point moves of a loop, however short the site's history."""
DEMO_STEP, DEMO_DRIFT, DEMO_LAG = 1.4, 1.6, 1.6
"""Factor on the gain from the first input that stepped, and at the end of the drift; on the lag of the cascade."""
DEMO_RETUNED = 1.5
"""Factor on the controller's gain, divisor of its reset time."""
DEMO_STICK = 0.25
"""Stick of a valve, as a share of how far OP goes for a usual move."""
DEMO_WANDER = 5.0
"""Lags of the loop that the disturbance is long."""
DEMO_BAND = 2.0
"""Standard deviations of the noise that a compressing historian leaves out."""
DEMO_SLAVE_NOISE = 0.02
"""Standard deviation of the slave's PV."""
DEMO_GAP = 10_000
"""Samples for which a value holds until the next event: PV is stored by exception."""
