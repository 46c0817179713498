"""The app as one ASGI application, and the server that runs it on this machine alone."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from trueplant.app import levels
from trueplant.app.folder import Folder
from trueplant.app.gate import Doorkeeper, Gate
from trueplant.app.jobs import Jobs
from trueplant.app.pages import failure, ok, project_of, url
from trueplant.app.process import end_all
from trueplant.app.screens import ROUTES
from trueplant.app.vendor import VENDOR, check_vendored, vendored
from trueplant.errors import TrueplantError, UsageError

INTERRUPTED = 130
KINDS = {".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8", ".svg": "image/svg+xml"}


def create_app(folder: Folder, keeper: Doorkeeper, warm: bool = True) -> Starlette:
    """All pages of a folder behind their gate."""
    jobs = Jobs(warm)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        warming = asyncio.create_task(_warm_later(jobs))
        try:
            yield
        finally:
            warming.cancel()
            await run_in_threadpool(jobs.close)

    routes = [*FRAME, *ROUTES]
    handlers: dict[Any, Any] = {TrueplantError: failure, HTTPException: failure}
    app = Starlette(
        routes=routes,
        middleware=[Middleware(Gate, keeper=keeper)],
        exception_handlers=handlers,
        lifespan=lifespan,
    )
    app.router.redirect_slashes = False
    app.state.folder, app.state.jobs, app.state.keeper = folder, jobs, keeper
    app.state.screens = {route.path.strip("/") for route in ROUTES}
    return app


async def _warm_later(jobs: Jobs) -> None:
    await asyncio.sleep(levels.WARM_AFTER)
    await run_in_threadpool(jobs.warm)


# -- what is no screen ---------------------------------------------------------------------------------------------


async def _first(request: Request) -> Response:
    return RedirectResponse(url(request, "start"), 303)


async def _static(request: Request) -> Response:
    name = request.path_params["name"]
    if name == "palette.css":
        content: bytes | None = await run_in_threadpool(_palette)
    else:
        content = await run_in_threadpool(_own, name)
    if content is None:
        raise HTTPException(404, "There is no such file.")
    return _unchanging(request, content, KINDS[Path(name).suffix])


async def _vendor(request: Request) -> Response:
    name = request.path_params["name"]
    if name not in VENDOR or Path(name).suffix not in KINDS:
        raise HTTPException(404, "There is no such file.")
    return _unchanging(request, await run_in_threadpool(vendored(name).read_bytes), KINDS[Path(name).suffix])


async def _favicon(request: Request) -> Response:
    return _unchanging(request, _own("icon.svg") or b"", KINDS[".svg"])


async def _undo(request: Request) -> Response:
    project = project_of(request)
    version = await run_in_threadpool(project.undo)
    return ok({"version": version, "can_undo": project.can_undo, "can_redo": project.can_redo})


async def _redo(request: Request) -> Response:
    project = project_of(request)
    version = await run_in_threadpool(project.redo)
    return ok({"version": version, "can_undo": project.can_undo, "can_redo": project.can_redo})


FRAME = [
    Route("/", _first),
    Route("/static/{name}", _static),
    Route("/vendor/{name}", _vendor),
    Route("/favicon.ico", _favicon),
    Route("/api/project/undo", _undo, methods=["POST"]),
    Route("/api/project/redo", _redo, methods=["POST"]),
]


def _own(name: str) -> bytes | None:
    room = files("trueplant.app").joinpath("static")
    known = {entry.name for entry in room.iterdir()}
    return room.joinpath(name).read_bytes() if name in known and Path(name).suffix in KINDS else None


@cache
def _palette() -> bytes:
    """The colours of the report, light and dark."""
    from trueplant.report.style import DARK, LIGHT

    def colours(palette: dict[str, str]) -> str:
        return ";".join(f"--{role.replace('_', '-')}:{colour}" for role, colour in palette.items())

    return f":root{{{colours(LIGHT)}}}@media(prefers-color-scheme:dark){{:root{{{colours(DARK)}}}}}\n".encode()


def _unchanging(request: Request, content: bytes, kind: str) -> Response:
    """A file that is the same for everybody: the browser may keep it, and asks whether it is still that."""
    tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    headers = {"etag": tag, "cache-control": "no-cache"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    return Response(content, media_type=kind, headers=headers)


# -- the server ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Asked:
    """How the app is to be run."""

    folder: Path
    project: str = ""
    """To be opened first, relative to the folder."""
    port: int = levels.PORT
    """0: any that is free."""
    browser: bool = True
    address: str = ""
    """Under which a reverse proxy shows it."""
    proxy_key: str = ""
    """By which the proxy says that it has checked who comes."""


def serve(asked: Asked, show: Callable[[str], None]) -> int:
    """Run the app until it is told to end; the exit status. `show` puts a line on the terminal.

    Raises UsageError where the port is taken, or what the pages draw with is not installed.
    """
    import uvicorn

    check_vendored()
    listening = listen(asked.port)
    port = listening.getsockname()[1]

    def show_link(link: str) -> None:
        show(f"open {link}")

    keeper = Doorkeeper(port, show_link, asked.address, asked.proxy_key)
    app = create_app(Folder(asked.folder), keeper)
    link = keeper.link()
    if asked.project:
        from urllib.parse import quote

        link += f"&project={quote(asked.project)}"
    ended: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        ended.append(number)

    config = uvicorn.Config(
        app,
        log_config=None,
        log_level="critical",
        access_log=False,
        lifespan="on",
        ws="none",
        proxy_headers=False,
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=levels.ENDS_WITHIN,
    )

    class Server(uvicorn.Server):
        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            app.state.jobs.leave()  # streams of open pages end, which would be waited for
            super().handle_exit(sig, frame)

    server = Server(config)
    # the server raises the signal that ended it once more when it has ended, which would kill this process
    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        show(f"trueplant app of {asked.folder}: open")
        show(f"  {link}")
        show("in a browser on this machine; the link works once. End with Ctrl-C.")
        if asked.browser and _has_screen():
            threading.Thread(target=webbrowser.open, args=(link,), daemon=True).start()
        server.run(sockets=[listening])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        listening.close()
        end_all()
    return INTERRUPTED if signal.SIGINT in ended else 0


def _has_screen() -> bool:
    """Without one, a browser of text would take the terminal."""
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def listen(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if sys.platform != "win32":  # there it would let two apps share one port
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((levels.HOST, port))
        listening.listen()  # at once: whoever opens the link while the app starts is kept waiting, not turned away
    except (OSError, OverflowError) as error:
        listening.close()
        reason = getattr(error, "strerror", None) or error
        raise UsageError(
            f"port {port} on this machine cannot be had ({reason}): end the other trueplant app, or choose another "
            "with --port (0: any that is free)"
        ) from None
    return listening
