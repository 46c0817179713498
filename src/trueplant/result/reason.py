"""Why something was refused or limited."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reason:
    """Why something was refused or limited."""

    code: str
    message: str
    where: str = ""
