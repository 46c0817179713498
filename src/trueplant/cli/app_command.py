"""The command ``app``: where the folder and its project are found, and what is said on the terminal."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

from trueplant.app import levels
from trueplant.errors import UsageError
from trueplant.files import contents
from trueplant.printable import printable


def app(place: Path, port: int, browser: bool, address: str, proxy_key: Path | None) -> int:
    """Run the local web application until it is told to end."""
    for needed in ("starlette", "uvicorn"):
        try:
            import_module(needed)
        except ModuleNotFoundError:
            raise UsageError(f"{needed} is not installed: pip install 'trueplant[app]'") from None
    from trueplant.app.server import Asked, serve

    if place.is_dir():
        folder, project = place, ""
    elif place.is_file() and place.suffix == ".toml":
        folder, project = place.parent, place.name
    else:
        raise UsageError(f"{place} is neither a folder nor a project file (.toml): name one that is there")
    asked = Asked(folder.resolve(), project, port, browser, _address(address), _key(proxy_key, address))
    return serve(asked, _show)


def _address(text: str) -> str:
    if text and not re.fullmatch(r"https?://[A-Za-z0-9.-]+(:\d+)?/?", text):
        raise UsageError(f"--address {text} is not like https://trueplant.example.com, without a path: correct it")
    return text.rstrip("/").lower()


def _key(file: Path | None, address: str) -> str:
    if file is None:
        return ""
    if not address:
        raise UsageError("--proxy-key goes with --address: it is for an app behind a reverse proxy")
    key = contents(file, UsageError).decode("ascii", "replace").strip()
    if len(key) < levels.PROXY_KEY or not key.isascii() or not key.isprintable():
        raise UsageError(
            f"{file} holds no key of {levels.PROXY_KEY} characters or more: make one with openssl rand -hex 32"
        )
    return key


def _show(line: str) -> None:
    print(printable(line), flush=True)
