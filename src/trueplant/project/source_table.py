"""The table ``[data.source]``: the historian that the record comes from."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field, model_validator

from trueplant.project.fields import Name, Positive, Table, problem

Kind = Literal["opcua", "pi", "postgresql", "sqlite", "parquet"]

NEEDED: dict[str, tuple[str, ...]] = {
    "opcua": ("url",),
    "pi": ("url", "server"),
    "postgresql": ("query",),
    "sqlite": ("path", "query"),
    "parquet": ("path",),
}
"""The keys that a kind of source cannot do without."""
OWN: dict[str, tuple[str, ...]] = {
    "security": ("opcua",),
    "policy": ("opcua",),
    "certificate": ("opcua",),
    "private_key": ("opcua",),
    "server_certificate": ("opcua",),
    "server": ("pi",),
    "auth": ("pi",),
    "token_env": ("pi",),
    "token_file": ("pi",),
    "ca": ("pi",),
    "url": ("opcua", "pi", "postgresql"),
    "url_env": ("postgresql",),
    "url_file": ("postgresql",),
    "user": ("opcua", "pi", "postgresql"),
    "password_env": ("opcua", "pi", "postgresql"),
    "password_file": ("opcua", "pi", "postgresql"),
    "path": ("sqlite", "parquet"),
    "query": ("postgresql", "sqlite"),
    "hive": ("parquet",),
    "columns": ("parquet",),
    "quality": ("postgresql", "sqlite", "parquet"),
    "time_zone": ("postgresql", "sqlite", "parquet"),
    "page": ("opcua", "pi"),
}
"""The kinds that have a key; one that is not listed belongs to all."""
PATHS = (
    *("snapshot", "path", "certificate", "private_key", "server_certificate", "ca"),
    *("password_file", "token_file", "url_file"),
)
"""Keys whose values are paths."""
_LITERAL = re.compile(r"(password|passwd|pwd|secret|token|api_?key|credentials?)", re.IGNORECASE)
_WITH_PASSWORD = re.compile(r"^[a-z][a-z0-9+.-]*://[^/@]*:[^/@]*@|[?&;\s](password|pwd)=", re.IGNORECASE)


class Historian(Table):
    """Where the events are read from, and how. A secret is named by its environment variable or its file."""

    kind: Kind
    url: Name | None = None
    url_env: Name | None = None
    url_file: Name | None = None
    path: Name | None = None
    query: Name | None = None
    server: Name | None = None
    tag: Name = "{}"
    columns: Annotated[list[Name], Field(min_length=3, max_length=4)] | None = None
    hive: bool = False
    quality: Literal["opc", "pi", "percent", "words"] | None = None
    time_zone: Name | None = None
    security: Literal["none", "sign", "sign and encrypt"] | None = None
    policy: Literal["Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"] = "Basic256Sha256"
    certificate: Name | None = None
    private_key: Name | None = None
    server_certificate: Name | None = None
    auth: Literal["kerberos", "basic", "bearer"] | None = None
    user: Name | None = None
    password_env: Name | None = None
    password_file: Name | None = None
    token_env: Name | None = None
    token_file: Name | None = None
    ca: Name | None = None
    page: Annotated[int, Field(ge=2, le=150_000)] | None = None
    timeout: Positive = 60.0
    snapshot: Name | None = None

    @model_validator(mode="before")
    @classmethod
    def _no_secrets(cls, given: object) -> object:
        """A project file is mailed and versioned: what opens a historian must not stand in it."""
        for key, value in given.items() if isinstance(given, dict) else ():
            if key not in cls.model_fields and _LITERAL.search(str(key)):
                text = (
                    "a secret must not stand in a project file: put it into an environment variable or a file, and name"
                    ' that with password_env = "NAME" or password_file = "FILE" (token_env, token_file)'
                )
                raise problem(text, key)
            if key == "url" and isinstance(value, str) and _WITH_PASSWORD.search(value):
                text = "holds a password: leave it out, and name user and password_env (or password_file) instead"
                raise problem(text, key)
        return given

    @model_validator(mode="after")
    def _of_its_kind(self) -> Historian:
        for key in self.model_fields_set:
            if self.kind not in OWN.get(key, (self.kind,)):
                raise problem(f'has no meaning with kind = "{self.kind}": leave it out', key)
        for key in NEEDED[self.kind]:
            if getattr(self, key) is None:
                raise problem(f'is needed with kind = "{self.kind}"', key)
        if "{}" not in self.tag:
            raise problem('must hold {} where the name of the column goes, as in "ns=2;s={}"', "tag")
        self._one_of("password_env", "password_file")
        self._one_of("token_env", "token_file")
        if (self.password_env or self.password_file) and self.user is None:
            raise problem("is needed with a password", "user")
        {"opcua": self._check_opcua, "pi": self._check_pi, "postgresql": self._check_url}.get(self.kind, bool)()
        return self

    def _one_of(self, *keys: str) -> None:
        said = [key for key in keys if getattr(self, key) is not None]
        if len(said) > 1:
            raise problem(f"says the same as {said[0]} in another way: keep one of them", said[1])

    def _check_url(self) -> None:
        if self.url is None and self.url_env is None and self.url_file is None:
            raise problem('is needed with kind = "postgresql": name the variable that holds the address', "url_env")
        self._one_of("url", "url_env", "url_file")

    def _check_opcua(self) -> None:
        if self.security in (None, "none"):
            for key in ("certificate", "private_key", "server_certificate", "policy"):
                if key in self.model_fields_set:
                    raise problem('needs security = "sign" or "sign and encrypt"', key)
            if self.user is not None:
                raise problem('is needed with a user, so that the password is not read on its way: "sign and encrypt"',
                              "security")  # fmt: skip
            return
        for key in ("certificate", "private_key"):
            if getattr(self, key) is None:
                raise problem(f'is needed with security = "{self.security}"', key)

    def _check_pi(self) -> None:
        if not (self.url or "").lower().startswith("https://"):
            raise problem("must begin with https://", "url")
        auth = self.auth or "kerberos"
        if auth == "basic" and not (self.password_env or self.password_file):
            raise problem('is needed with auth = "basic"', "password_env")
        if auth == "bearer" and not (self.token_env or self.token_file):
            raise problem('is needed with auth = "bearer"', "token_env")
        for key, needs in (("user", "basic"), ("token_env", "bearer"), ("token_file", "bearer")):
            if getattr(self, key) is not None and auth != needs:
                raise problem(f'needs auth = "{needs}"', key)
