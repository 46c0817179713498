"""Requests that wait: a newer one of the same kind from the same page takes the place of an older one."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

Request = dict[str, Any]


class Mailbox:
    """What a process has been asked and has not begun. The kinds named first are taken first."""

    def __init__(self, order: Sequence[str]) -> None:
        self._order = tuple(order)
        self._waiting: dict[tuple[str, str], Request] = {}
        self._changed = threading.Condition()
        self._closed = False

    def put(self, request: Request) -> Request | None:
        """Leave a request with its "kind" and "page"; the older one that it overtakes comes back."""
        key = (request["kind"], request.get("page", ""))
        with self._changed:
            overtaken = self._waiting.pop(key, None)
            self._waiting[key] = request
            self._changed.notify()
        return overtaken

    def take(self) -> Request | None:
        """The most urgent, of those the oldest; waits for one. None when the box is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                return None
            key = min(self._waiting, key=lambda key: self._rank(key[0]))
            return self._waiting.pop(key)

    def has(self, kind: str, page: str) -> bool:
        """Does such a request wait? What is being answered is then out of date."""
        with self._changed:
            return (kind, page) in self._waiting

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _rank(self, kind: str) -> int:
        return self._order.index(kind) if kind in self._order else len(self._order)
