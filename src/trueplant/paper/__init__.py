"""The paper on which this project rests, computed: every equation, table and figure that can be, beside its print.

"Development and application of a model-plant mismatch expression for linear time-invariant systems" (Olivier and
Craig). Numbers in parentheses are its equations. Its industrial record is not public: the splitter's records are
simulated.
"""

from trueplant.paper.compute import Paper, compute
from trueplant.paper.entry import Entry
from trueplant.paper.equations import equations
from trueplant.paper.mill import mill_section
from trueplant.paper.page import render
from trueplant.paper.splitter import splitter_section
from trueplant.paper.tables import records_section

__all__ = ["Entry", "Paper", "compute", "equations", "mill_section", "records_section", "render", "splitter_section"]
