"""Sizes and ranges of the report, each with its reason."""

from __future__ import annotations

MOST_POINTS = 3000
"""Points of a trace: more than a screen is wide, few enough for a page that opens at once."""
ALL_POINTS = 200_000
"""Points of all traces of a page together, for the same reason."""
MOST_ROWS = 60
"""Rows of a table that are shown open."""
MOST_PERCENT = 300.0
"""Widest scale on which changes are drawn; larger ones become arrowheads."""
MOST_LINEAR = 8.0
"""Highest mu that is drawn on a linear axis; beyond it the axis is logarithmic."""
MOST_CELLS = 40
"""Elements that are shown as a matrix on the sheet for the shift: more do not fit beside the rest on one page."""
MOST_LINES = 6
"""Lines of each list on that sheet, for the same reason."""
ARITHMETIC = 1e-6
"""Of what a difference is measured against: below, the number says how computers add up, and 0 says what it means."""
UNSEEN = 1e-4
"""Of the range of what is drawn: a tenth of a pixel."""
CELL_POINTS = 60
"""Of a step response in the matrix: a cell is some 160 pixels wide."""
AT_REST, BEYOND_REST = 0.02, 1.25
"""Of its range within which a step response has come to rest, and times that until then that are drawn."""
CELL_WIDTH, CELL_HEIGHT, CELL_EDGE, CELL_TEXT = 160.0, 84.0, 3.0, 12.0
"""Of such a drawing, and of the line below it that says how long it lasts, in its own units."""
STILL_WIDTH, STILL_HEIGHT = 900.0, 110.0
"""Of a trend that is drawn without a script, in its own units."""
STILL_POINTS, STILL_PANELS = 600, 24
"""Samples a line, and signals: such a page stays below 0.3 MB."""
