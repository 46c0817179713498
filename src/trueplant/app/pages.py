"""What handlers answer with: pages made from templates, JSON, and one message for what went wrong."""

from __future__ import annotations

import contextlib
import json
from collections.abc import AsyncIterator, Mapping
from functools import cache
from typing import Any
from urllib.parse import urlencode

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse

from trueplant.app.folder import Conflict, Folder, Outside, ProjectFile
from trueplant.errors import TrueplantError
from trueplant.version import __version__

SCREENS = {
    "start": "Start",
    "tags": "Tags",
    "trends": "Trends",
    "model": "Model",
    "run": "Run",
    "verdict": "Verdict",
    "whatif": "What if",
    "plan": "Plan",
    "out": "Out",
}
"""In the order of the work: what the address has, and what the navigation shows."""


def folder_of(request: Request) -> Folder:
    """The folder that the app was opened on."""
    folder: Folder = request.app.state.folder
    return folder


def project_of(request: Request) -> ProjectFile:
    """That of ``?project=``. Raises HTTPException: 400 where none is named, 404 where there is none."""
    name = request.query_params.get("project", "")
    if not name:
        raise HTTPException(400, "No project is chosen: open one on the page Start.")
    try:
        return folder_of(request).project(name)
    except Outside as error:
        raise HTTPException(404, f"{error}.") from None


def url(request: Request, screen: str, **query: Any) -> str:
    """The address of a screen, of the same project unless another is named."""
    project = query.pop("project", request.query_params.get("project", ""))
    asked = {"project": project, **query} if project else query
    return f"/{screen}?{urlencode(asked)}" if asked else f"/{screen}"


def page(request: Request, template: str, *, screen: str, status: int = 200, **context: Any) -> HTMLResponse:
    """A page of the frame: `screen` is the key of `SCREENS` that is shown as current."""
    return HTMLResponse(_environment().get_template(template).render(_frame(request, screen) | context), status)


def ok(data: Mapping[str, Any]) -> JSONResponse:
    """JSON; numbers that are not finite are null."""
    return _Json(data)


def said(message: str, status: int = 400) -> JSONResponse:
    """What went wrong, in one message."""
    return _Json({"error": message}, status)


def sandboxed(content: str | bytes) -> Response:
    """A page that is not the app's own, such as a report: it runs what its own policy allows, cut off from the app."""
    policy = (
        "sandbox allow-scripts allow-downloads allow-modals allow-popups; form-action 'none'; frame-ancestors 'none'"
    )
    return HTMLResponse(content, headers={"content-security-policy": policy})


def streamed(source: AsyncIterator[Mapping[str, Any]]) -> StreamingResponse:
    """A stream for an EventSource, which `stream` of app.js reads."""

    async def lines() -> AsyncIterator[bytes]:
        async for data in source:
            yield b"data: " + bytes(_Json(data).body) + b"\n\n"

    return StreamingResponse(lines(), media_type="text/event-stream", headers={"x-accel-buffering": "no"})


async def body(request: Request) -> dict[str, Any]:
    """The JSON object of a request. Raises HTTPException(400) for anything else."""
    try:
        data = json.loads(await request.body())
    except (ValueError, RecursionError):
        raise HTTPException(400, "The request is no JSON.") from None
    if not isinstance(data, dict):
        raise HTTPException(400, "The request is no JSON object.")
    return data


def failure(request: Request, error: Exception) -> Response:
    """An error as its one message: JSON for what scripts ask, else a page."""
    status, message = _status(error), _message(request, error)
    if request.url.path.startswith("/api/"):
        return said(message, status)
    return page(request, "message.html.j2", screen="", status=status, message=message)


def _status(error: Exception) -> int:
    if isinstance(error, HTTPException):
        return error.status_code
    if isinstance(error, Outside):
        return 404
    if isinstance(error, Conflict):
        return 409
    return 422 if isinstance(error, TrueplantError) else 500


def _message(request: Request, error: Exception) -> str:
    if isinstance(error, HTTPException):
        return "There is no such page." if error.detail == "Not Found" else str(error.detail)
    return folder_of(request).plain(str(error))


def _frame(request: Request, screen: str) -> dict[str, Any]:
    """What the frame of every page needs."""
    name = request.query_params.get("project", "")
    project, version = None, ""
    with contextlib.suppress(TrueplantError):  # the message is the handler's
        project = folder_of(request).project(name) if name else None
        version = project.version if project else ""
    ready = request.app.state.screens
    return {
        "nonce": request.state.nonce,
        "csrf": getattr(request.state, "csrf", ""),
        "version": __version__,
        "screen": screen,
        "folder": folder_of(request).root.name,
        "project": project.name if project else "",
        "project_version": version,
        "can_undo": bool(project and project.can_undo),
        "can_redo": bool(project and project.can_redo),
        "nav": [(key, label, url(request, key) if key in ready else None) for key, label in SCREENS.items()],
        "url": lambda screen, **query: url(request, screen, **query),
    }


class _Json(JSONResponse):
    def render(self, content: Any) -> bytes:
        return _dumped(content).encode("utf-8", "replace")


def _dumped(content: Any) -> str:
    try:
        return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except ValueError:
        return json.dumps(_finite(content), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if value - value == 0 else None
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    return [_finite(entry) for entry in value] if isinstance(value, (list, tuple)) else value


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("trueplant.app"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_function"] = _dumped
    environment.policies["json.dumps_kwargs"] = {}
    return environment
