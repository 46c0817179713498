"""OPC UA: raw history of nodes, page by page."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Coroutine, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from trueplant.connect import levels
from trueplant.connect.settings import Settings, host_of, missing_extra
from trueplant.connect.source import Lost, Quality, TagInfo, Window
from trueplant.errors import DataError, ProjectError, SourceError
from trueplant.files import contents

if TYPE_CHECKING:
    import polars as pl

T = TypeVar("T")
_PASSING = (
    *("BadConnectionClosed", "BadConnectionRejected", "BadCommunicationError", "BadNoCommunication", "BadTimeout"),
    *("BadSecureChannelClosed", "BadSecureChannelIdInvalid", "BadSessionClosed", "BadSessionIdInvalid", "BadShutdown"),
    *("BadServerHalted", "BadTcpServerTooBusy", "BadTooManyOperations", "BadResourceUnavailable", "BadRequestTimeout"),
    *("BadContinuationPointInvalid", "BadNoContinuationPoints", "BadServerNotConnected", "BadTooManySessions"),
)
"""Status codes after which another attempt may help."""
_NONE_THERE = ("GoodNoData", "BadNoData", "BadBoundNotFound", "BadNoDataAvailable")
"""Those that say that the window is empty."""


class OpcUa:
    """A session with a server, on an event loop of its own that runs while something is asked."""

    def __init__(self, settings: Settings) -> None:
        try:
            from asyncua import Client, ua
        except ImportError:
            raise missing_extra("opcua", "asyncua", "opcua") from None
        _quiet()
        self._settings, self._ua = settings, ua
        url = settings.table.url or ""
        self.server = host_of(url)
        self._client = Client(url, timeout=settings.table.timeout, watchdog_intervall=levels.WATCHDOG)
        self._runner = asyncio.Runner()
        self._runner.get_loop().set_exception_handler(lambda *_: None)  # what matters is raised where it is awaited
        try:
            self._run(self._connect())
        except BaseException:
            self._runner.close()
            raise

    async def _connect(self) -> None:
        table, client = self._settings.table, self._client
        if table.security not in (None, "none"):
            await self._secure()
        if table.user is not None:
            client.set_user(table.user)
            client.set_password(self._settings.password() or "")
        await client.connect()

    async def _secure(self) -> None:
        """Signed, or signed and encrypted. The name in our certificate is what servers know us by."""
        from asyncua.crypto import security_policies
        from cryptography import x509

        table, settings = self._settings.table, self._settings
        certificate, key = (contents(settings.path(name), ProjectError) for name in ("certificate", "private_key"))
        try:
            pem = certificate.startswith(b"-----")
            own = x509.load_pem_x509_certificate(certificate) if pem else x509.load_der_x509_certificate(certificate)
        except ValueError:
            raise ProjectError(
                f"data.source.certificate: {settings.path('certificate')} holds no certificate"
            ) from None
        with contextlib.suppress(x509.ExtensionNotFound, IndexError):
            names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            self._client.application_uri = names.get_values_for_type(x509.UniformResourceIdentifier)[0]
        trusted = settings.path("server_certificate") if table.server_certificate else None
        if trusted is not None:
            contents(trusted, ProjectError)
        mode = {"sign": "Sign", "sign and encrypt": "SignAndEncrypt"}[table.security or ""]
        await self._client.set_security(
            getattr(security_policies, f"SecurityPolicy{table.policy}"),
            settings.path("certificate"),
            settings.path("private_key") if key else "",
            server_certificate=None if trusted is None else str(trusted),
            mode=getattr(self._ua.MessageSecurityMode, mode),
        )

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        return [self._run(self._info(tag)) for tag in tags]

    async def _info(self, tag: str) -> TagInfo:
        node = self._client.get_node(self._id(tag))
        try:
            await node.read_browse_name()
        except self._ua.UaStatusCodeError as error:
            if _name(error) in ("BadNodeIdUnknown", "BadNodeIdInvalid"):
                raise DataError(f"{self.server} has no node {tag!r}: correct the tag or data.source.tag") from None
            raise
        unit, span = None, None
        for own in await node.get_properties():
            name = (await own.read_browse_name()).Name
            if name == "EngineeringUnits":
                unit = getattr((await own.read_value()).DisplayName, "Text", None)
            elif name == "EURange":
                value = await own.read_value()
                span = (float(value.Low), float(value.High))
        return TagInfo(tag, unit=unit, span=span)

    def _id(self, tag: str) -> Any:
        try:
            return self._ua.NodeId.from_string(tag)
        except (self._ua.UaError, ValueError):
            raise ProjectError(
                f'data.source.tag: {tag!r} is no node: write the address as in tag = "ns=2;s={{}}"'
            ) from None

    def read(self, tags: Sequence[str], window: Window) -> Iterator[pl.DataFrame]:
        page = self._settings.table.page or levels.OPCUA_PAGE
        count = max(1, levels.NODE_VALUES // page)
        for first in range(0, len(tags), count):
            yield from self._pages(list(tags[first : first + count]), window, page)

    def _pages(self, tags: list[str], window: Window, page: int) -> Iterator[pl.DataFrame]:
        """Of some nodes at once; each has a continuation point of its own."""
        ua = self._ua
        details = ua.ReadRawModifiedDetails(
            IsReadModified=False, StartTime=window.start, EndTime=window.end, NumValuesPerNode=page, ReturnBounds=False
        )
        points: dict[str, bytes | None] = dict.fromkeys(tags)
        ends: dict[str, Any] = {}
        for _ in range(levels.MOST_PAGES):
            results = self._run(self._ask(details, points))
            following: dict[str, bytes | None] = {}
            for (tag, before), result in zip(points.items(), results, strict=True):
                values = self._values(tag, result)
                if values:
                    yield self._page(tag, values)
                if after := result.ContinuationPoint:
                    # one point may stand for the whole read: it is the page that must not repeat as well
                    last, ends[tag] = (
                        ends.get(tag),
                        (len(values), *(one.SourceTimestamp for one in values[:1] + values[-1:])),
                    )
                    if after == before and ends[tag] == last:
                        raise SourceError(
                            f"{self.server} gives the same page of {tag} again and again (its continuation point "
                            f"repeats): set data.source.page to more than {page}, or take a shorter window"
                        )
                    following[tag] = after
            if not following:
                return
            points = following
        raise SourceError(f"{self.server} has always one more page of {next(iter(points))}: take a shorter window")

    async def _ask(self, details: Any, points: dict[str, bytes | None]) -> Any:
        ua = self._ua
        parameters = ua.HistoryReadParameters(
            HistoryReadDetails=details, TimestampsToReturn=ua.TimestampsToReturn.Both, ReleaseContinuationPoints=False
        )
        for tag, point in points.items():
            parameters.NodesToRead.append(ua.HistoryReadValueId(NodeId=self._id(tag), ContinuationPoint=point))
        return await self._client.uaclient.history_read(parameters)

    def _values(self, tag: str, result: Any) -> list[Any]:
        name = result.StatusCode.name
        if name in _NONE_THERE or result.HistoryData is None:
            return []
        if name in _PASSING:
            raise Lost(name)
        if not result.StatusCode.is_good():
            raise SourceError(
                f"{self.server} gives no history of {tag} ({name}): check that the node keeps one and that this user "
                "may read it"
            )
        return list(getattr(result.HistoryData, "DataValues", None) or [])

    def _page(self, tag: str, values: list[Any]) -> pl.DataFrame:
        import polars as pl

        words = (Quality.GOOD, Quality.UNCERTAIN, Quality.BAD, Quality.BAD)
        stamps = [value.SourceTimestamp or value.ServerTimestamp for value in values]
        # a status that is not sent is good; the severity stands in its two highest bits
        codes = [0 if value.StatusCode is None else value.StatusCode.value >> 30 for value in values]
        numbers = [_number(value.Value) for value in values]
        quality = [str(Quality.BAD if number is None else words[k]) for k, number in zip(codes, numbers, strict=True)]
        utc = [None if stamp is None else stamp.replace(tzinfo=None) for stamp in stamps]
        made = {
            "tag": pl.Series([tag]).new_from_index(0, len(values)),
            "time": pl.Series(utc, dtype=pl.Datetime("us")).dt.replace_time_zone("UTC"),
            "value": pl.Series(numbers, dtype=pl.Float64),
            "quality": pl.Series(quality, dtype=pl.String),
        }
        return pl.DataFrame(made).drop_nulls("time")

    def close(self) -> None:
        with contextlib.suppress(Exception):
            self._runner.run(asyncio.wait_for(self._client.disconnect(), levels.LONGEST_PAUSE))
        self._runner.close()

    def _run(self, what: Coroutine[Any, Any, T]) -> T:
        ua = self._ua
        try:
            return self._runner.run(what)
        except ua.UaStatusCodeError as error:
            name = _name(error)
            if name in _PASSING:
                raise Lost(name) from None
            raise SourceError(f"{self.server} refuses ({name}): {_remedy(name)}") from None
        except (OSError, TimeoutError, asyncio.CancelledError, asyncio.IncompleteReadError, ua.UaError) as error:
            raise Lost(f"{type(error).__name__} {error}".strip()) from None


def _number(value: Any) -> float | None:
    """Of a variant: None where it is no number."""
    given = None if value is None else value.Value
    if isinstance(given, str):
        with contextlib.suppress(ValueError):
            return float(given)
        return None
    return float(given) if isinstance(given, (int, float)) and given == given and abs(given) != float("inf") else None


def _name(error: Any) -> str:
    return type(error).__name__


def _remedy(name: str) -> str:
    """What to do about a status code."""
    if "Identity" in name or "User" in name:
        return "check data.source.user and its password"
    if "Certificate" in name or "Security" in name:
        return "let the server trust data.source.certificate, and check security and policy"
    return "check data.source.url and the server"


def _quiet() -> None:
    """asyncua logs what it raises as well; without a handler of the caller's own that would go to standard error."""
    for name in ("asyncua", "asyncio"):
        logger = logging.getLogger(name)
        if not logger.hasHandlers():
            logger.addHandler(logging.NullHandler())
