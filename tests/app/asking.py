"""Requests to the app without a server, byte by byte as a browser or an attacker would send them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.applications import Starlette

from trueplant.app.folder import Folder
from trueplant.app.gate import Doorkeeper
from trueplant.app.server import create_app

PORT = 8722
OWN = f"http://127.0.0.1:{PORT}"


@dataclass
class Answer:
    """What came back."""

    status: int = 0
    headers: dict[str, str] = field(default_factory=dict)
    content: bytes = b""

    @property
    def text(self) -> str:
        return self.content.decode("utf-8", "replace")

    def json(self) -> Any:
        return json.loads(self.content)


@dataclass
class Visitor:
    """A browser in front of the app."""

    app: Starlette
    keeper: Doorkeeper
    cookie: str = ""
    csrf: str = ""

    @classmethod
    def outside(cls, folder: Path, **options: Any) -> Visitor:
        keeper = Doorkeeper(PORT, **options)
        return cls(create_app(Folder(folder), keeper, warm=False), keeper)

    @classmethod
    def inside(cls, folder: Path, **options: Any) -> Visitor:
        """One that came by the link."""
        visitor = cls.outside(folder, **options)
        visitor.enter()
        return visitor

    def enter(self) -> Answer:
        link = self.keeper.link()
        answer = self.ask("GET", link.removeprefix(self.keeper.start))
        self.cookie = answer.headers["set-cookie"].split(";")[0]
        self.csrf = next(iter(self.keeper.sessions.values())).csrf
        return answer

    def headers(self, method: str) -> dict[str, str]:
        """Those of a request from the app's own pages."""
        own = {"host": f"127.0.0.1:{PORT}", "cookie": self.cookie, "sec-fetch-site": "same-origin"}
        if method not in ("GET", "HEAD"):
            own |= {"origin": OWN, "x-csrf-token": self.csrf, "content-type": "application/json"}
        return {name: value for name, value in own.items() if value}

    def ask(
        self,
        method: str,
        path: str,
        body: bytes | Iterable[bytes] = b"",
        change: Mapping[str, str | None] | None = None,
    ) -> Answer:
        """One request; `change` sets headers, or takes away those that are None. A body in parts has no length."""
        headers = self.headers(method)
        for name, value in (change or {}).items():
            headers.pop(name, None)
            if value is not None:
                headers[name] = value
        parts = [body] if isinstance(body, bytes) else body
        if isinstance(body, bytes) and body:
            headers.setdefault("content-length", str(len(body)))
        asked = _asked(self.app, method, path, headers, iter(parts))
        with ThreadPoolExecutor(1) as apart:  # a browser of other tests has an event loop in this thread
            return apart.submit(asyncio.run, asked).result()

    def post(self, path: str, data: Any) -> Answer:
        return self.ask("POST", path, json.dumps(data).encode())


async def _asked(app: Starlette, method: str, path: str, headers: Mapping[str, str], parts: Any) -> Answer:
    path, _, query = path.partition("?")
    scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": query.encode(),
        "headers": [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()],
        "client": ("127.0.0.1", 50000),
        "server": ("127.0.0.1", PORT),
    }
    answer = Answer()
    waiting = next(parts, b"")

    async def receive() -> dict[str, Any]:
        nonlocal waiting
        if waiting is None:
            await asyncio.sleep(0.01)
            return {"type": "http.disconnect"}
        sent, waiting = waiting, next(parts, None)
        return {"type": "http.request", "body": sent, "more_body": waiting is not None}

    async def send(message: Any) -> None:
        if message["type"] == "http.response.start":
            answer.status = message["status"]
            answer.headers = {name.decode().lower(): value.decode() for name, value in message["headers"]}
        elif message["type"] == "http.response.body":
            answer.content += message.get("body", b"")

    await app(scope, receive, send)
    return answer
