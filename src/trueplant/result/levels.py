"""What the sentences of a result go by."""

USEFUL = 0.3
"""Half of an interval relative to the value, up to which a value stands without it in a headline: beyond, the reader
would take a number for known that is not."""
SHOWN_FIRST = 2
"""Elements of a first model that a headline tells: more are for the table."""
