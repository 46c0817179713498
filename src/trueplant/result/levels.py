"""What the sentences of a result go by."""

USEFUL = 0.3
"""Half of an interval relative to the value, up to which a value stands without it in a headline: beyond, the reader
would take a number for known that is not."""
SAFE_SHARE = 0.95
"""Of the plants that a record leaves possible that today's controllers have to keep stable to be called so."""
WORTH_SAYING = 0.1
"""Of the largest change of an element, below which another is not worth a word: beyond chance, but small."""
SHOWN_FIRST = 2
"""Elements of a first model that a headline tells: more are for the table."""

TOLD = 0.8
"""Part of its interval below which a plan has to bring a parameter for the sentence to speak of it. Judgement."""
