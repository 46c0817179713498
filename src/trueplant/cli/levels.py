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
AGAIN = 0.02
"""Seconds after which an interruption comes again that Python could not raise where it came: longer than what C code
calls back takes, and no time for who pressed Ctrl-C."""
