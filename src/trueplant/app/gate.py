"""Who gets in, and what a page may do: the middleware through which every request goes.

A link with a token that works once, printed on the terminal, opens a session. Every request after that needs the
session's cookie and the right Host; one that changes something also the right Origin and the session's CSRF token.
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from trueplant.app import levels
from trueplant.app.refusals import Answer, link_said, refused, welcome
from trueplant.details import write_details

CSRF = "x-csrf-token"
SAFE = ("GET", "HEAD")
NEW_LINK = "/new-link"
ELSEWHERE = "This request came from another page than the app's own."
PROXY_KEY = "x-trueplant-key"


@dataclass
class Session:
    """One browser that was let in."""

    csrf: str = field(default_factory=lambda: secrets.token_urlsafe(levels.TOKEN_BYTES))
    began: float = field(default_factory=time.monotonic)
    seen: float = field(default_factory=time.monotonic)

    def stands(self, now: float) -> bool:
        return now - self.seen < levels.SESSION_IDLE and now - self.began < levels.SESSION_LONGEST


class Doorkeeper:
    """The start token and the sessions. `say_link` shows a new link where only who started the app sees it."""

    def __init__(
        self, port: int, say_link: Callable[[str], None] = lambda link: None, address: str = "", proxy_key: str = ""
    ) -> None:
        own = [f"{levels.HOST}:{port}", f"localhost:{port}"]
        self.origins = {f"http://{host}" for host in own}
        self.hosts = set(own)
        self.secure = address.startswith("https://")
        if address:
            self.origins.add(address)
            self.hosts.add(urlsplit(address).netloc)
        self.start = address or f"http://{levels.HOST}:{port}"
        self.cookie = f"trueplant-{port}"  # cookies know no ports: two apps would take each other's
        self.sessions: dict[str, Session] = {}
        self.say_link = say_link
        self._proxy_key = proxy_key
        self._token: str | None = None
        self._said = -levels.LINK_EVERY

    def link(self) -> str:
        """A new link, which works once; an earlier one that was not used no longer does."""
        self._token = secrets.token_urlsafe(levels.TOKEN_BYTES)
        return f"{self.start}/?token={self._token}"

    def say_new_link(self) -> bool:
        """Show a new link on the terminal; False where one was shown just now."""
        now = time.monotonic()
        if now - self._said < levels.LINK_EVERY:
            return False
        self._said = now
        self.say_link(self.link())
        return True

    def enter(self, token: str) -> str | None:
        """The key of a new session for the right token, which is used up by that."""
        if self._token is None or not hmac.compare_digest(token.encode(), self._token.encode()):
            return None
        self._token = None
        return self._opened()

    def vouched(self, headers: Headers) -> str | None:
        """The key of a new session for whom the reverse proxy sends, which has checked who that is."""
        key = headers.get(PROXY_KEY, "")
        if not self._proxy_key or not hmac.compare_digest(key.encode(), self._proxy_key.encode()):
            return None
        return self._opened()

    def _opened(self) -> str:
        while len(self.sessions) >= levels.SESSIONS:
            del self.sessions[min(self.sessions, key=lambda key: self.sessions[key].seen)]
        key = secrets.token_urlsafe(levels.TOKEN_BYTES)
        self.sessions[key] = Session()
        return key

    def session(self, headers: Headers) -> Session | None:
        """That of a request's cookie, unless it has ended."""
        key = _cookies(headers).get(self.cookie, "")
        session, now = self.sessions.get(key), time.monotonic()
        if session is None:
            return None
        if not session.stands(now):
            del self.sessions[key]
            return None
        session.seen = now
        return session

    def set_cookie(self, key: str) -> str:
        secure = "; Secure" if self.secure else ""
        return f"{self.cookie}={key}; Path=/; HttpOnly; SameSite=Strict{secure}"


class Gate:
    """ASGI middleware: lets through what may pass, and puts the security headers on every answer."""

    def __init__(self, app: ASGIApp, keeper: Doorkeeper) -> None:
        self.app, self.keeper = app, keeper

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        nonce = secrets.token_urlsafe(16)
        state = scope.setdefault("state", {})
        state["nonce"] = nonce
        safely = _with_headers(send, nonce)
        headers = Headers(scope=scope)
        answer = self._answer(scope, headers, state)
        if answer is not None:
            await answer.response(nonce, scope["path"])(scope, receive, safely)
            return
        begun = False

        async def noting(message: Message) -> None:
            nonlocal begun
            begun = True
            await safely(message)

        try:
            await self.app(scope, _limited(receive, headers, _most(scope["path"])), noting)
        except Exception:
            answer = refused(500, f"The app made a mistake; the details were written to {write_details()}.")
            if not begun:
                await answer.response(nonce, scope["path"])(scope, receive, safely)

    def _answer(self, scope: Scope, headers: Headers, state: dict[str, object]) -> Answer | None:
        """What is answered in place of the app; None lets the request through."""
        keeper, method, path = self.keeper, scope["method"], scope["path"]
        if headers.get("host", "") not in keeper.hosts or len(headers.getlist("host")) != 1:
            return refused(421, f"This address is not that of the app, which is {keeper.start}.")
        if method not in SAFE and not self._is_own(headers):
            return refused(403, ELSEWHERE)
        if path == NEW_LINK and method == "POST":
            return link_said(keeper.say_new_link())
        token = _token(scope) if path == "/" and method == "GET" else None
        if token is not None and (key := keeper.enter(token)) is not None:
            return welcome(keeper.set_cookie(key), _ahead(scope))
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return refused(403, f"{ELSEWHERE} Type its address into the address bar: {keeper.start}")
        session = keeper.session(headers)
        if session is None and method == "GET" and (key := keeper.vouched(headers)) is not None:
            return welcome(keeper.set_cookie(key), _ahead(scope))
        if session is None:
            return refused(401, "You are not logged in, or not any more.", new_link=True)
        if method not in SAFE and not hmac.compare_digest(headers.get(CSRF, "").encode(), session.csrf.encode()):
            return refused(403, "This page is of an earlier session: load it again.")
        state["csrf"] = session.csrf
        try:
            length = int(headers.get("content-length", "0"))
        except ValueError:
            return refused(400, "The length of this request is no number.")
        if length > (most := _most(path)):
            return refused(413, f"This is more than the {most // 2**20} MB that are taken here.")
        return None

    def _is_own(self, headers: Headers) -> bool:
        return headers.get("origin", "") in self.keeper.origins and (
            headers.get("sec-fetch-site", "same-origin") == "same-origin"
        )


def _cookies(headers: Headers) -> Mapping[str, str]:
    try:
        jar = SimpleCookie(headers.get("cookie", ""))
    except CookieError:
        return {}
    return {name: morsel.value for name, morsel in jar.items()}


def _ahead(scope: Scope) -> str:
    """The same address without the token."""
    asked = parse_qs(scope["query_string"].decode("latin-1"))
    rest = urlencode({name: values[0] for name, values in asked.items() if name != "token"})
    path = "/" + scope["path"].lstrip("/")  # two slashes would lead to another machine
    return quote(path) + (f"?{rest}" if rest else "")


def _token(scope: Scope) -> str | None:
    found = parse_qs(scope["query_string"].decode("latin-1")).get("token")
    return found[0] if found else None


def _most(path: str) -> int:
    return levels.UPLOAD if path in levels.UPLOADS else levels.BODY


def _limited(receive: Receive, headers: Headers, most: int) -> Receive:
    """The body as it comes, until it is too long; its length need not have been said."""
    taken = 0

    async def limited() -> Message:
        nonlocal taken
        message = await receive()
        if message["type"] == "http.request":
            taken += len(message.get("body", b""))
            if taken > most:
                raise HTTPException(413, f"This is more than the {most // 2**20} MB that are taken here.")
        return message

    return limited


def policy(nonce: str) -> str:
    """What a page may load and run: its own files, and scripts and styles that bear this nonce."""
    return (
        "default-src 'none'; "
        f"script-src 'self' 'nonce-{nonce}'; style-src 'self' 'nonce-{nonce}'; img-src 'self' data: blob:; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    )


def _with_headers(send: Send, nonce: str) -> Send:
    async def safely(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.setdefault("content-security-policy", policy(nonce))
            headers.setdefault("cache-control", "no-store")
            headers["x-content-type-options"] = "nosniff"
            headers["referrer-policy"] = "no-referrer"
            headers["x-frame-options"] = "DENY"
            headers["cross-origin-opener-policy"] = "same-origin"
            headers["cross-origin-resource-policy"] = "same-origin"
            headers["permissions-policy"] = "camera=(), geolocation=(), microphone=()"
        await send(message)

    return safely
