"""Layout of the terminal: sizes in characters, and how much of a long list is shown."""

PIPE_WIDTH = 140
"""Of tables in a pipe or file, where nobody tells the width."""
INDENT = 2
"""Of the rows below a title."""
GAP = 3
"""Between columns."""
WORST = 20
"""Loops of an audit that a terminal shows; the page has all."""
WHOLE, SMALL, SMALL_DAYS = 10, 4, 10
"""Loops of each kind of the demo site; with --small, and the days of their history then."""
