"""A server that keeps to what the public documentation of the PI Web API says of points and recorded values, over TLS.

It was never compared with the real one.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

import numpy as np
import polars as pl

LARGEST = 150_000
"""maxCount above this is refused, and without one there are 1,000."""
DEFAULT = 1000


class PiServer:
    """Serves events at https://127.0.0.1:PORT/piwebapi. `before` is called with the number of each request.

    It may return a status (and headers) to answer with instead, or raise ConnectionError to hang up.
    """

    def __init__(self, events: pl.DataFrame, context: Any, authorization: str | None = None) -> None:
        self.items = {str(key[0]): _items(own.sort("time")) for key, own in events.group_by("tag")}
        self.stamps = {tag: np.array([item["Timestamp"] for item in items]) for tag, items in self.items.items()}
        self.requests: list[str] = []
        self.before: Callable[[int], tuple[int, dict[str, str]] | None] = lambda number: None
        self.authorization = authorization
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            wbufsize = -1  # head and body in one packet: two would wait for each other

            def do_GET(self) -> None:
                outer.requests.append(self.path)
                try:
                    instead = outer.before(len(outer.requests))
                except ConnectionError:
                    self.close_connection = True
                    self.connection.close()
                    return
                if instead is not None:
                    self.reply(instead[0], {"Message": "busy"}, instead[1])
                elif outer.authorization and self.headers.get("Authorization") != outer.authorization:
                    self.reply(401, {"Message": f"not you: {self.headers.get('Authorization')}"}, {})
                else:
                    self.reply(*outer.answer(self.path), {})

            def reply(self, status: int, body: Any, headers: dict[str, str]) -> None:
                content = json.dumps(body).encode()
                self.send_response(status)
                for name, value in {"Content-Length": str(len(content)), **headers}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: Any) -> None:
                """Quiet."""

        class Quiet(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_: Any) -> None:
                """A client that hangs up is none of our errors."""

        self.http = Quiet(("127.0.0.1", 0), Handler)
        self.http.socket = context.wrap_socket(self.http.socket, server_side=True)
        self.port = self.http.server_address[1]
        self.thread = threading.Thread(target=self.http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        self.thread.start()

    def answer(self, target: str) -> tuple[int, Any]:
        path, query = urlsplit(target).path, {key: one[0] for key, one in parse_qs(urlsplit(target).query).items()}
        if path == "/piwebapi/points":
            tag = query["path"].rpartition("\\")[2]
            if query["path"] != f"\\\\PISRV\\{tag}" or tag not in self.items:
                return 404, {"Errors": [f"PI Point {tag} not found"]}
            unit = {"EngineeringUnits": "degC", "Zero": 0.0, "Span": 400.0, "Step": tag.startswith("sp")}
            return 200, {"WebId": f"F1{tag}", "PointType": "Float64", **unit}
        parts = path.split("/")
        if parts[1:3] != ["piwebapi", "streams"] or parts[4:] != ["recorded"]:
            return 404, {"Errors": ["no such resource"]}
        most = int(query.get("maxCount", DEFAULT))
        if most > LARGEST:
            return 400, {"Errors": [f"The maximum count of {most} is above {LARGEST}"]}
        tag = unquote(parts[3]).removeprefix("F1")
        stamps = self.stamps[tag]
        first, last = (
            np.searchsorted(stamps, query["startTime"]),
            np.searchsorted(stamps, query["endTime"], side="right"),
        )
        return 200, {"Items": self.items[tag][first : min(first + most, last)], "Links": {}}

    def close(self) -> None:
        self.http.shutdown()
        self.http.server_close()


def _items(own: pl.DataFrame) -> list[dict[str, Any]]:
    stamps = own["time"].dt.strftime("%Y-%m-%dT%H:%M:%S.%6fZ").to_list()
    words = own["quality"].to_list() if "quality" in own.columns else ["good"] * own.height
    return [_item(*row) for row in zip(stamps, own["value"].to_list(), words, strict=True)]


def _item(stamp: str, value: float | None, word: str) -> dict[str, Any]:
    item = {"Timestamp": stamp, "Value": value, "Good": word != "bad", "Questionable": word == "uncertain"}
    if word == "bad":
        item["Value"] = {"Name": "I/O Timeout", "Value": 246, "IsSystem": True}
    return item | {"Substituted": False, "Annotated": False, "UnitsAbbreviation": ""}


def slowly(seconds: float) -> Callable[[int], None]:
    return lambda number: time.sleep(seconds)
