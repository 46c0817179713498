"""Control systems by name, and how each shows the settings of a PID.

All of these reckon gains in per cent of span. After their makers' manuals: DeltaV Books Online (PID function block:
GAIN, RESET and RATE in seconds, ALPHA 0.125, standard or series form); Rockwell 1756-RM006 (PIDE: error in per cent of
span, minutes, dependent or independent gains); Honeywell TDC 3000 and Experion (K, T1 and T2 in minutes, interactive or
not);
Foxboro I/A (PBAND, INT and DERIV in minutes, interacting); Yokogawa CENTUM (PB, TI and TD in seconds).
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass

from trueplant.errors import LoopError


@dataclass(frozen=True)
class Vendor:
    """How one system shows a PID; fields as in `forms.Notation`."""

    name: str
    form: str
    gain: str
    time_unit: str
    alpha: float | None = None
    """Of the derivative's filter, where the system fixes or presets it."""

    @property
    def derivative_filter(self) -> str:
        return "time" if self.form == "parallel" else "ratio"


VENDORS = (
    Vendor("Emerson DeltaV", "ideal", "gain", "s", 0.125),
    Vendor("Emerson DeltaV series", "series", "gain", "s", 0.125),
    Vendor("Foxboro I/A", "series", "proportional band", "min"),
    Vendor("Honeywell Experion", "series", "gain", "min"),
    Vendor("Honeywell Experion non-interactive", "ideal", "gain", "min"),
    Vendor("Honeywell TDC 3000", "series", "gain", "min"),
    Vendor("Rockwell PIDE", "ideal", "gain", "min"),
    Vendor("Rockwell PIDE independent", "parallel", "gain", "min"),
    Vendor("Yokogawa CENTUM", "ideal", "proportional band", "s"),
)
"""By name, alphabetically."""


def vendor_of(name: str) -> Vendor:
    """The system of that name, or the plain one of those that have all of its words. Raises LoopError with the list."""
    words = _words(name)
    having = {vendor.name: _words(vendor.name) for vendor in VENDORS if words and words <= _words(vendor.name)}
    plain = [one for one, own in having.items() if all(own <= other for other in having.values())]
    if plain:
        return next(vendor for vendor in VENDORS if vendor.name == plain[0])
    names = [vendor.name for vendor in VENDORS]
    near = difflib.get_close_matches(name.casefold(), [one.casefold() for one in names], n=1, cutoff=0.4)
    hint = f"; did you mean {names[[one.casefold() for one in names].index(near[0])]!r}?" if near else ""
    which = "may be one of several" if having else "is no system that is known"
    raise LoopError(f"{name!r} {which}: there are {', '.join(names)}{'' if having else hint}")


def _words(name: str) -> frozenset[str]:
    return frozenset(re.findall(r"[a-z0-9]+", name.casefold().replace("non-interactive", "noninteractive")))
