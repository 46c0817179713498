"""All of the paper, in order."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from trueplant.paper.entry import Entry
from trueplant.paper.equations import equations
from trueplant.paper.mill import Mill, mill_section
from trueplant.paper.splitter import splitter_section
from trueplant.paper.tables import SEEDS, Splitter, records_section
from trueplant.threads import one_thread


@dataclass(frozen=True, eq=False)
class Paper:
    """What was computed, section by section."""

    equations: list[Entry]
    mill: Mill
    splitter: list[Entry]
    records: Splitter
    seeds: int

    @cached_property
    def entries(self) -> list[Entry]:
        """All entries in the order of the paper."""
        return [*self.equations, *self.mill.entries, *self.splitter, *self.records.entries]

    def to_json(self) -> str:
        """paper.json as text: a list of {id, what, printed, computed, agrees, note}."""
        rows = [entry.to_dict() for entry in self.entries]
        return json.dumps(rows, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


@one_thread()
def compute(seeds: int = SEEDS, progress: Callable[[str], None] = lambda what: None) -> Paper:
    """Compute the paper; `seeds` simulated records of the splitter for each kind of noise. About a minute."""
    progress("equations (1) to (20)")
    first = equations()
    progress("the mill: (37), Figures 4 to 8")
    second = mill_section()
    progress("the splitter: stability, margins, error model, Table 4")
    third = splitter_section()
    return Paper(first, second, third, records_section(seeds, progress), seeds)
