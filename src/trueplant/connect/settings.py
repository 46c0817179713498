"""What a project says of its historian, with the secrets that it names; they never leave this object in a message."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qsl, quote, quote_plus, unquote, urlsplit, urlunsplit

from trueplant.connect import levels
from trueplant.errors import ProjectError, UsageError
from trueplant.files import contents
from trueplant.project.source_table import Historian

HIDDEN = "***"


@dataclass(eq=False)
class Settings:
    """The table `[data.source]`, the folder its paths start from, and the zone of stamps that bear none."""

    table: Historian
    folder: Path
    time_zone: str | None = None
    _secrets: set[str] = field(default_factory=set, init=False, repr=False)

    def path(self, key: str) -> Path:
        """The file that a key names."""
        return self.folder / str(getattr(self.table, key))

    def password(self) -> str | None:
        """Of `user`; None where none is named. Raises ProjectError."""
        return self._secret("password_env", "password_file")

    def token(self) -> str | None:
        """Of bearer authentication. Raises ProjectError."""
        return self._secret("token_env", "token_file")

    def address(self) -> str:
        """The URL, with user and password where it can bear them. Raises ProjectError."""
        url = self.table.url or self._secret("url_env", "url_file") or ""
        parts = urlsplit(url)
        for secret in (parts.password, *(value for key, value in parse_qsl(parts.query) if key == "password")):
            self._keep(secret)
        password = self.password()
        if password is None or parts.password is not None:
            return url
        host = parts.netloc.rpartition("@")[2]
        user = quote(self.table.user or "", safe="")
        return urlunsplit(parts._replace(netloc=f"{user}:{quote(password, safe='')}@{host}"))

    def clean(self, text: object) -> str:
        """The first line of a foreign message, without any secret."""
        whole = str(text)
        for secret in sorted(self._secrets, key=len, reverse=True):
            whole = whole.replace(secret, HIDDEN)
        line = next((line.strip() for line in whole.splitlines() if line.strip()), "no reason given")
        return line if len(line) <= levels.SHOWN else f"{line[: levels.SHOWN]}..."

    def hide(self, text: str) -> None:
        """Count as a secret what was made of one."""
        self._secrets.add(text)

    def _secret(self, variable: str, file: str) -> str | None:
        name = getattr(self.table, variable)
        if name is not None:
            value = os.environ.get(name)
            if not value:
                raise ProjectError(
                    f"data.source.{variable}: the environment variable {name} is not set: set it and try again"
                )
            return self._keep(value)
        if getattr(self.table, file) is None:
            return None
        return self._keep(contents(self.path(file), ProjectError).decode("utf-8", "replace").strip())

    def _keep(self, secret: str | None) -> str | None:
        if secret:
            self._secrets |= {
                secret,
                quote(secret, safe=""),
                quote(secret),
                quote_plus(secret),
                unquote(secret),
                repr(secret)[1:-1],
            }
        return secret


def missing_extra(kind: str, package: str, extra: str = "") -> UsageError:
    """What to say of a source whose package is not installed."""
    wanted = f"'trueplant[{extra}]'" if extra else package
    return UsageError(f"a source of kind {kind} needs {package}, which is not installed: pip install {wanted}")


def host_of(url: str) -> str:
    """Scheme, host and port of a URL: nothing in it is secret."""
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"
