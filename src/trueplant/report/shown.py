"""Parts of a result as the templates show them: in the words of result.json."""

from __future__ import annotations

from typing import Any

from trueplant.result.codec import plain


def as_shown(value: object) -> Any:
    """Classes as dicts, which the templates walk through whatever they hold."""
    return plain(value)
