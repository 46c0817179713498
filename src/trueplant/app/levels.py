"""Limits and sizes of the app, each with its reason."""

from __future__ import annotations

HOST = "127.0.0.1"
"""The app listens on this machine alone; who wants it for a team puts a reverse proxy before it."""
PORT = 8722
"""Of no well-known service; a fixed one, so that a bookmark stays right."""

TOKEN_BYTES = 32
"""Of the start token, a session and its CSRF token: 256 random bits are not guessed."""
SESSION_IDLE = 12 * 3600.0
"""Seconds without a request after which a session ends: a shift."""
SESSION_LONGEST = 7 * 24 * 3600.0
"""Seconds after which it ends in any case."""
SESSIONS = 64
"""At once; the oldest goes. A team behind a proxy has fewer people than that."""
PROXY_KEY = 32
"""Letters of a reverse proxy's key at least: 128 random bits as hexadecimal digits."""
LINK_EVERY = 10.0
"""Seconds between new links on the terminal, so that nobody can flood it."""

BODY = 4 * 2**20
"""Bytes of a request: the longest is a project file with thousands of exclusions, below 1 MB."""
UPLOAD = 8 * 2**30
"""Bytes of a data file that is uploaded: ten years of sixty tags once a minute are 3 GB as CSV."""
UPLOADS = ("/api/start/upload",)
"""Where that holds; such a handler reads `request.stream()` and writes as it comes."""

PROJECT_BYTES = 16 * 2**20
"""A TOML file longer than this is no project file; it is not looked into."""
DEEPEST = 3
"""Folders below the one that was opened in which projects and data are looked for."""
MOST_FILES = 2000
"""Listed at most, so that a home folder that is opened by mistake answers at once."""
UNDO = 200
"""Steps back for each project, of some kB each."""

WARM_AFTER = 2.0
"""Seconds after the start until the program is loaded for the first analysis: the first page comes before it."""
ENDS_WITHIN = 3
"""Seconds that open requests are given when the app is told to end."""
KILLED_WITHIN = 5.0
"""Seconds that a killed process is waited for."""
HEARTBEAT = 10.0
"""Seconds between signs of life on a stream of events, by which a closed page is noticed."""
KEPT_JOBS = 50
"""Analyses that are remembered, finished ones included."""
NICE = 5
"""Steps that an analysis stands back behind the app, so that pages answer while it runs on all cores."""

# -- screens ---------------------------------------------------------------------------------------------------------

WHATIF_LONGEST = 120.0
"""Seconds after which a what-if is given up: the first one of a large loop, on a busy machine, takes some ten."""
SMALL_MOVE = 3.0
"""Times the noise of PV: smaller moves do not show by eye, and it takes many of them. Judgement; whether moves can be
told from chance is what `check` asks of all loops together."""
LOOKED_EVERY = 0.1
"""Seconds between looks at whether the check is done."""
QUARTER = 900.0
"""Seconds: the clock changes at whole quarters of an hour only."""
CLOCK = 500_000
"""Samples by which the interval and what counts as a gap are told for drawing: all ten million take 0.8 s."""
BLOCK = 128
"""Samples of a trend of which the extremes are kept. Judgement: 1/64 of the memory of a signal, and a view of 2,000
stretches is made from raw samples as long as it holds less than some 500,000, which takes 2 ms."""
BLOCKS = 2
"""Of these that a stretch must have at least to be made from them: its ends are then off by less than a quarter."""
UNSEEN = 1e-5
"""Share of the range of a signal that is less than a pixel, also of a part of it."""
HEAD = 10_000
"""Rows by which most columns are known to hold no modes."""
