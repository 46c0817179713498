"""How much is asked of a historian at once, how long and how often, each with its reason."""

from __future__ import annotations

SCHEMA = 1
"""Of the JSON file beside a snapshot. Another one is read again."""
SLICE = 86400.0
"""Seconds of history that are asked for at once, and again after the connection was lost. Judgement: a day of twenty
tags every second is 1.7 million events, some 60 MB, and a year 365 requests."""
LEADS = (600.0, 86400.0)
"""Seconds before the window in which the last set-point, OP and mode are looked for, the second where the first has
none: those that nobody moves are not stored. Judgement: an OP in automatic moves within minutes, and most others are
written once a day at least."""
ATTEMPTS = 6
"""Times that a slice is asked for before a source that has answered before counts as one that does not."""
PAUSE = 0.5
"""Seconds before the second attempt, doubled with each further one, 15 s in all: what restarts takes some
seconds."""
LONGEST_PAUSE = 30.0
"""Seconds that a server may make us wait (Retry-After). Judgement: who says more is asked again later by a person."""
SHOWN = 200
"""Characters of a foreign message that are shown."""
NODE_VALUES = 100_000
"""Values times nodes in one OPC UA request: some servers refuse or stall on more."""
MOST_PAGES = 1_000_000
"""Pages of one tag in a slice, after which a source that always has one more page is given up."""
OPCUA_PAGE = 5000
"""Values of one node in a page; most servers allow 10,000."""
PI_PAGE = 50_000
"""Events of one tag in a page; above 150,000 the PI Web API refuses (its default limit), and without it gives 1,000."""
WATCHDOG = 120.0
"""Seconds between two looks of asyncua at whether the connection lives. Its own 1 s drops it while a side is busy."""
SQLITE_STEPS = 10_000
"""Steps of SQLite between two looks at the clock: a millisecond or so."""
SQLITE_MARGIN = 86400.0
"""Seconds by which an SQLite query is given a wider window than is kept: stamps are compared as text there, and
"2026-10-08T05:00" comes after "2026-10-08 06:00"."""
ROWS = 100_000
"""Rows that are taken from a database cursor at once."""
UNIX = (1e11, 1e14, 1e17)
"""Where a count since 1970 turns from seconds to ms, us and ns: seconds reach 1e11 in the year 5138, and milliseconds
passed it in 1973."""
