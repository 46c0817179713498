"""Sizes and ranges of the report, each with its reason."""

from __future__ import annotations

MOST_POINTS = 4000
"""Points of a trace: more than a screen is wide, few enough for a page that opens at once."""
ALL_POINTS = 200_000
"""Points of all traces of a page together, for the same reason."""
MOST_ROWS = 60
"""Rows of a table that are shown open."""
MOST_PERCENT = 300.0
"""Widest scale on which changes are drawn; larger ones become arrowheads."""
