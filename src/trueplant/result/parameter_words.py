"""The field's words for a parameter's name, which its structure may number: tau2, dead_time, zeta_2."""

from __future__ import annotations

import re

_WORDS = {
    "gain": "gain",
    "slope": "slope",
    "tau": "time constant",
    "lead": "lead time",
    "dead_time": "dead time",
    "omega0": "natural frequency",
    "zeta": "damping ratio",
}
_NAME = re.compile(rf"({'|'.join(_WORDS)})_?(\d*)")


def kind_of(name: str) -> str:
    """The name without its number; a name of no structure is returned as it is."""
    found = _NAME.fullmatch(name)
    return found[1] if found else name


def number_of(name: str) -> str:
    """The number in the name, or an empty text."""
    found = _NAME.fullmatch(name)
    return found[2] if found else ""


def change_of(quantity: str, size: str) -> str:
    """``of the lag by 37 %``: a change of a detectable size; empty quantity: it is not known which."""
    if not quantity:
        return f"of {size}"
    return f"of the {quantity} by {size}{' of dead time and lag' if quantity == 'dead time' else ''}"


def word_of(name: str) -> str:
    """``tau2`` is a time constant."""
    return _WORDS.get(kind_of(name), name.replace("_", " "))
