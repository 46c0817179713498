"""The site file: which loops a site has, how they are audited, and who is told."""

from __future__ import annotations

import os
import re
import tomllib
from datetime import date, datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, ValidationError, model_validator

from trueplant.calendar import unit_seconds
from trueplant.errors import ProjectError
from trueplant.files import contents
from trueplant.project.fields import Name, Positive, Table, problem
from trueplant.project.messages import message
from trueplant.project.not_toml import not_toml

_LENGTH = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(ms|s|min|h|d)\s*")
_LOCAL = re.compile(r"[a-z]+://(127\.0\.0\.1|localhost|\[::1\])(:\d+)?/?")


def seconds_of(text: str) -> float:
    """Of a length of time such as ``10 min``. Raises ValueError."""
    found = _LENGTH.fullmatch(text)
    if found is None or float(found[1]) <= 0:
        raise ValueError(text)
    return float(found[1]) * unit_seconds(found[2])


def _length(text: str) -> str:
    try:
        seconds_of(text)
    except ValueError:
        raise problem(f'must be a length of time with its unit, as in "30 d" or "10 min", not "{text}"') from None
    return text


Length = Annotated[str, AfterValidator(_length)]
"""A length of time with its unit: ms, s, min, h or d."""
On = Literal["newly changed", "newly failed"]
Ons = Annotated[tuple[On, ...], BeforeValidator(lambda given: tuple(given) if isinstance(given, list) else given)]


class Loops(Table):
    """Some of the loops: a pattern of project files, or a template and the table that fills it."""

    projects: Name | None = None
    template: Name | None = None
    table: Name | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.template is None) != (self.table is None):
            missing = "table" if self.table is None else "template"
            raise problem("template and table go together: name both files", missing)
        if (self.projects is None) == (self.template is None):
            raise problem('must name its loops: projects = "units/*/*.toml", or template and table')
        return self


class Audit(Table):
    """How the loops are audited."""

    workers: int | None = Field(default=None, ge=0)
    """None: as many as there are cores; 0: one loop after the other in this process."""
    deadline: Length = "10 min"
    window: Length | None = None
    start: datetime | None = Field(default=None, alias="from")
    end: datetime | None = Field(default=None, alias="to")
    find: bool | None = None
    """Are stretches with usable moves looked for? None: where a window is given."""

    @property
    def windowed(self) -> bool:
        return self.window is not None or self.start is not None

    @property
    def finds(self) -> bool:
        return self.windowed if self.find is None else self.find

    @model_validator(mode="after")
    def _one_window(self) -> Self:
        if (self.start is None) != (self.end is None):
            raise problem("from and to go together: set both or none", "to" if self.end is None else "from")
        if self.window is not None and self.start is not None:
            raise problem("says the same as from and to in another way: keep one of them", "window")
        for key, at in (("from", self.start), ("to", self.end)):
            if at is not None and at.tzinfo is None:
                raise problem("needs its offset, as in 2026-10-01T00:00:00+02:00", key)
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise problem(f"must come after from ({self.start})", "to")
        return self


class Cluster(Table):
    """A cluster of Dask that is there already; beyond this machine it is spoken to over TLS alone."""

    address: Name
    ca: Name | None = None
    certificate: Name | None = None
    key: Name | None = None

    @model_validator(mode="after")
    def _protected(self) -> Self:
        if self.address.startswith("tls://"):
            for name in ("ca", "certificate", "key"):
                if getattr(self, name) is None:
                    raise problem("is needed with a tls:// address: name its file", name)
        elif not _LOCAL.fullmatch(self.address):
            raise problem(f'must begin with tls://, since "{self.address}" is not on this machine', "address")
        return self


class Alarm(Table):
    """Who is told of what is new."""

    on: Ons = ("newly changed", "newly failed")
    webhook_env: Name
    ca: Name | None = None
    timeout: Positive = 10.0

    @model_validator(mode="before")
    @classmethod
    def _no_secrets(cls, given: object) -> object:
        """The address of a webhook lets anyone write there."""
        if isinstance(given, dict) and "webhook" in given:
            text = "a webhook's address must not stand in a file: put it into an environment variable and name that"
            raise problem(f'{text} with webhook_env = "NAME"', "webhook")
        return given


class Acknowledged(Table):
    """A finding that is known: it stays in the tables, and alarms no more until after the date."""

    loop: Name
    """A name, or a pattern such as ``FC*``."""
    output: Name | None = None
    input: Name | None = None
    until: date
    why: str = ""


class Site(Table):
    """A site file, checked; see docs/audits.md for every key. Read by `Site.load`."""

    name: Name
    loops: list[Loops] = Field(min_length=1)
    audit: Audit = Audit()
    cluster: Cluster | None = None
    alarm: Alarm | None = None
    acknowledged: list[Acknowledged] = Field(default_factory=list)

    _folder: Path = PrivateAttr(default=Path())
    _source: str = PrivateAttr(default="site")

    @property
    def folder(self) -> Path:
        """Relative paths start here."""
        return self._folder

    @property
    def source(self) -> str:
        """The file that it was read from."""
        return self._source

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a site file. Raises ProjectError (file, line, key, what to do)."""
        file = Path(path)
        content = contents(file, ProjectError, "correct the path; docs/audits.md shows a site file")
        try:
            text = content.decode("utf-8-sig")
            site = cls(**tomllib.loads(text))
        except UnicodeDecodeError:
            raise ProjectError(f"{file}: is not UTF-8 text: save the site file as UTF-8") from None
        except tomllib.TOMLDecodeError as error:
            raise ProjectError(not_toml(error, str(file), text)) from None
        except ValidationError as error:
            raise ProjectError(message(error, cls, str(file), text, "the site file")) from None
        site._folder, site._source = file.parent, str(file)
        return site
