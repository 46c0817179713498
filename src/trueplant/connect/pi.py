"""PI Web API: recorded values over HTTPS."""

from __future__ import annotations

import base64
import email.utils
import http.client
import json
import ssl
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode, urlsplit

from trueplant.connect import levels
from trueplant.connect.events import times
from trueplant.connect.settings import Settings, host_of, missing_extra
from trueplant.connect.source import Lost, Quality, TagInfo, Window
from trueplant.errors import DataError, ProjectError, SourceError
from trueplant.files import contents

if TYPE_CHECKING:
    import polars as pl

_FIELDS = "WebId;EngineeringUnits;Zero;Span;Step;PointType"
_ITEM = "Items.Timestamp;Items.Value;Items.Good;Items.Questionable;Items.Errors"


class PiWebApi:
    """One connection that is kept. The server's certificate is always verified, and redirections are not followed."""

    def __init__(self, settings: Settings) -> None:
        table = settings.table
        self._settings = settings
        parts = urlsplit(table.url or "")
        self.server, self._base = host_of(table.url or ""), parts.path.rstrip("/")
        context = ssl.create_default_context()
        if table.ca is not None:
            authority = contents(settings.path("ca"), ProjectError)
            try:
                context.load_verify_locations(cadata=authority.decode("ascii"))
            except (ssl.SSLError, UnicodeDecodeError):
                raise ProjectError(f"data.source.ca: {settings.path('ca')} holds no certificate in PEM form") from None
        self._connection = http.client.HTTPSConnection(
            parts.hostname or "", parts.port, timeout=table.timeout, context=context
        )
        self._ids: dict[str, str] = {}
        self._credentials = self._authorised()

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        return [self._info(tag) for tag in tags]

    def _info(self, tag: str) -> TagInfo:
        point = self._get(
            "/points", {"path": f"\\\\{self._settings.table.server}\\{tag}", "selectedFields": _FIELDS}, tag
        )
        self._ids[tag] = str(point["WebId"])
        zero, span = point.get("Zero"), point.get("Span")
        both = isinstance(zero, (int, float)) and isinstance(span, (int, float))
        step = point.get("Step")
        return TagInfo(
            tag,
            unit=point.get("EngineeringUnits") or None,
            span=(float(zero), float(zero) + float(span)) if both else None,  # type: ignore[arg-type]
            step=step if isinstance(step, bool) else None,
        )

    def read(self, tags: Sequence[str], window: Window) -> Iterator[pl.DataFrame]:
        for tag in tags:
            if tag not in self._ids:  # the connection was lost since they were described
                self._info(tag)
            yield from self._pages(tag, window)

    def _pages(self, tag: str, window: Window) -> Iterator[pl.DataFrame]:
        """Each begins with the last stamp of the one before, as that may hold more events."""
        page = self._settings.table.page or levels.PI_PAGE
        start, end = _stamp(window.start), _stamp(window.end)
        for _ in range(levels.MOST_PAGES):
            asked = {"startTime": start, "endTime": end, "boundaryType": "Inside", "maxCount": str(page)}
            body = self._get(f"/streams/{quote(self._ids[tag])}/recorded", asked | {"selectedFields": _ITEM}, tag)
            items = body.get("Items")
            if not isinstance(items, list):
                raise SourceError(f"{self.server} gives no list of values of {tag}: check data.source.url")
            if items:
                yield self._page(tag, items)
            if len(items) < page:
                return
            last = str(items[-1].get("Timestamp"))
            if last == str(items[0].get("Timestamp")):
                raise SourceError(
                    f"{self.server} has {page} or more events of {tag} at {last}: set data.source.page to "
                    "more than that"
                )
            start = last
        raise SourceError(f"{self.server} has always one more page of {tag}: take a shorter window")

    def _page(self, tag: str, items: list[dict[str, Any]]) -> pl.DataFrame:
        import polars as pl

        stamps, _ = times(pl.Series([str(item.get("Timestamp")) for item in items]), self.server, "UTC")
        numbers = [_number(item.get("Value")) for item in items]
        words = [_word(item, number) for item, number in zip(items, numbers, strict=True)]
        return pl.DataFrame(
            {
                "tag": pl.Series([tag]).new_from_index(0, len(items)),
                "time": stamps,
                "value": pl.Series(numbers, dtype=pl.Float64),
                "quality": pl.Series(words, dtype=pl.String),
            }
        )

    def close(self) -> None:
        self._connection.close()

    # -- HTTP ----------------------------------------------------------------------------------------------------

    def _get(self, path: str, query: dict[str, str], tag: str) -> dict[str, Any]:
        """The JSON object at a path. A server that is busy is asked again when it says."""
        target = f"{self._base}{path}?{urlencode(query)}"
        for attempt in range(levels.ATTEMPTS):
            status, headers, content = self._ask(target)
            if status in (429, 503):
                wanted = _pause(headers.get("Retry-After", ""))
                time.sleep(min(max(wanted, levels.PAUSE * 2**attempt), levels.LONGEST_PAUSE))
                continue
            if status in (408, 500, 502, 504):
                raise Lost(f"HTTP {status}")
            if status != 200:
                raise self._refused(status, content, tag)
            try:
                body = json.loads(content)
            except ValueError:
                body = None
            if not isinstance(body, dict):
                raise SourceError(f"{self.server} answers with something else than JSON: check data.source.url")
            return body
        raise SourceError(f"{self.server} stays busy (HTTP {status}); nothing was written: try again later")

    def _ask(self, target: str) -> tuple[int, http.client.HTTPMessage, bytes]:
        headers = {"Accept": "application/json", "User-Agent": "trueplant"} | self._credentials()
        try:
            self._connection.request("GET", target, headers=headers)
            answer = self._connection.getresponse()
            return answer.status, answer.headers, answer.read()
        except ssl.SSLCertVerificationError as error:
            raise SourceError(
                f"the certificate of {self.server} is not trusted ({error.verify_message}): name that of its "
                "authority as data.source.ca"
            ) from None
        except (OSError, http.client.HTTPException) as error:
            self._connection.close()
            raise Lost(f"{type(error).__name__} {self._settings.clean(error)}") from None

    def _refused(self, status: int, content: bytes, tag: str) -> Exception:
        if status == 404:
            return DataError(
                f"{self.server} has no tag {tag!r}: correct the tag, data.source.tag or data.source.server"
            )
        if status in (401, 403):
            return SourceError(
                f"{self.server} refuses (HTTP {status}): check data.source.auth, the user and the password or token"
            )
        try:
            said = json.loads(content).get("Errors") or json.loads(content).get("Message")
        except (ValueError, AttributeError):
            said = None
        text = self._settings.clean("; ".join(map(str, said)) if isinstance(said, list) else said or "no reason given")
        return SourceError(f"{self.server} refuses (HTTP {status}, {text}): check data.source.url and data.source.page")

    def _authorised(self) -> Any:
        """A function that gives the header for one request."""
        table = self._settings.table
        if table.auth == "bearer":
            token = self._settings.token()
            return lambda: {"Authorization": f"Bearer {token}"}
        if table.auth == "basic":
            pair = base64.b64encode(f"{table.user}:{self._settings.password()}".encode()).decode("ascii")
            self._settings.hide(pair)
            return lambda: {"Authorization": f"Basic {pair}"}
        try:
            import spnego
        except ImportError:
            raise missing_extra("pi with Kerberos", "pyspnego[kerberos]") from None
        host = urlsplit(table.url or "").hostname

        def negotiated() -> dict[str, str]:
            ticket = spnego.client(hostname=host, service="http", protocol="kerberos").step()
            return {"Authorization": f"Negotiate {base64.b64encode(ticket or b'').decode('ascii')}"}

        return negotiated


def _stamp(moment: datetime) -> str:
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _number(value: Any) -> float | None:
    """A number, or that of a digital state; None for text, and for states in which a system tells of itself."""
    if isinstance(value, dict):
        return None if value.get("IsSystem", True) else _number(value.get("Value"))
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return None
    return float(value) if isinstance(value, (int, float)) else None


def _word(item: dict[str, Any], number: float | None) -> str:
    if number is None or item.get("Errors") or not item.get("Good", False):
        return str(Quality.BAD)
    return str(Quality.UNCERTAIN if item.get("Questionable") else Quality.GOOD)


def _pause(text: str) -> float:
    """Seconds of a Retry-After: a number, or a date."""
    if text.strip().isdigit():
        return float(text)
    try:
        return (email.utils.parsedate_to_datetime(text) - datetime.now(UTC)).total_seconds()
    except (TypeError, ValueError):
        return 0.0
