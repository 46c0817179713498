"""A project whose record comes from a historian, from the fields of a form. Secrets are named, never written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import tomlkit

from trueplant.errors import ProjectError
from trueplant.project.source_table import NEEDED, OWN


@dataclass(frozen=True)
class Field:
    """One field of the form."""

    key: str
    label: str
    hint: str = ""
    choices: tuple[str, ...] = ()
    only_name: bool = False
    """Does it hold the name of an environment variable?"""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Of historian that have it."""
        return OWN.get(self.key, tuple(NEEDED))

    @property
    def needed(self) -> tuple[str, ...]:
        """Kinds that cannot do without it."""
        return tuple(kind for kind, keys in NEEDED.items() if self.key in keys)


KINDS = {
    "opcua": "OPC UA (history of nodes)",
    "pi": "PI Web API",
    "postgresql": "PostgreSQL or TimescaleDB",
    "sqlite": "SQLite file",
    "parquet": "Parquet files",
}
FIELDS = (
    Field("url", "Address of the server", "opc.tcp://hist:4840 or https://pi.example/piwebapi, without a password"),
    Field("url_env", "Environment variable that holds the address", "HISTORIAN_URL", only_name=True),
    Field("server", "Name of the data archive", "PISRV01"),
    Field("path", "File, folder or pattern", "lake/**/*.parquet"),
    Field(
        "query",
        "Query for tag, time, value and quality",
        "select tag, ts, val from hist where tag = any(:tags) and ts >= :from and ts < :to",
    ),
    Field("security", "Security", choices=("none", "sign", "sign and encrypt")),
    Field("certificate", "Our certificate (file)", "trueplant.der"),
    Field("private_key", "Its key (file)", "trueplant.pem"),
    Field("server_certificate", "Certificate of the server that is trusted (file)", "hist.der"),
    Field("auth", "Kind of login", choices=("kerberos", "basic", "bearer")),
    Field("user", "User", "reader"),
    Field("password_env", "Environment variable that holds the password", "UA_PASSWORD", only_name=True),
    Field("token_env", "Environment variable that holds the token", "PI_TOKEN", only_name=True),
    Field("ca", "Certificate of the authority (file)", "site.pem"),
    Field("tag", "How a tag is called there ({} is its name below)", "ns=2;s={}"),
    Field("quality", "What a quality in numbers means", choices=("opc", "pi", "percent", "words")),
    Field("time_zone", "Zone of stamps that bear none", "Europe/Oslo"),
)
SIGNALS = ("pv", "sp", "op", "mode")


def source_text(given: Mapping[str, Any]) -> str:
    """The project text for the fields of the form. Raises ProjectError for what is missing or misplaced."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Of a historian; its events are read into a snapshot: trueplant fetch THIS_FILE"))
    document.add("time_unit", _text(given, "time_unit", "the unit of time"))
    data = tomlkit.table()
    data.add("from", _moment(given, "from"))
    data.add("to", _moment(given, "to"))
    if zone := str(given.get("zone") or "").strip():
        data.add("time_zone", zone)
    for key, label in (("sample_time", "the time between samples"), ("max_gap", "the longest gap")):
        if value := str(given.get(key) or "").strip():
            data.add(key, _number(value, label))
    data.add("source", _source(given))
    document.add("data", data)
    loops = [loop for loop in given.get("loops", []) if isinstance(loop, Mapping) and any(map(loop.get, SIGNALS))]
    if not loops:
        raise ProjectError("name the tags of at least one loop: its PV and its OP")
    outputs, inputs = tomlkit.aot(), tomlkit.aot()
    for k, loop in enumerate(loops, 1):
        stem = str(loop.get("name") or "").strip() or str(k)
        outputs.append(
            _entry(
                {
                    "name": f"{stem}_pv",
                    "pv": _text(loop, "pv", f"the PV of loop {k}"),
                    "sp": loop.get("sp"),
                    "unit": loop.get("unit"),
                }
            )
        )
        inputs.append(
            _entry({"name": f"{stem}_op", "op": _text(loop, "op", f"the OP of loop {k}"), "mode": loop.get("mode")})
        )
    document.add("output", outputs)
    document.add("input", inputs)
    return tomlkit.dumps(document)


def _source(given: Mapping[str, Any]) -> tomlkit.items.Table:
    kind = _text(given, "kind", "the kind of historian")
    if kind not in KINDS:
        raise ProjectError(f"{kind!r} is no kind of historian: choose one of {', '.join(KINDS)}")
    source = tomlkit.table()
    source.add("kind", kind)
    for field in FIELDS:
        value = str(given.get(field.key) or "").strip()
        if value and kind in field.kinds:
            if field.only_name and not value.isidentifier():
                raise ProjectError(
                    f"{field.label}: give the name of the variable, such as {field.hint}, not what it holds: a secret "
                    "must not stand in a project file"
                )
            source.add(field.key, value)
    return source


def _entry(keys: Mapping[str, Any]) -> tomlkit.items.Table:
    entry = tomlkit.table()
    for key, value in keys.items():
        if value:
            entry.add(key, str(value).strip())
    return entry


def _text(given: Mapping[str, Any], key: str, what: str) -> str:
    value = str(given.get(key) or "").strip()
    if not value:
        raise ProjectError(f"{what} is missing: fill it in")
    return value


def _number(value: str, label: str) -> float:
    try:
        return float(value.replace(",", "."))
    except ValueError:
        raise ProjectError(f"{label}: {value!r} is no number") from None


def _moment(given: Mapping[str, Any], key: str) -> datetime:
    value = _text(given, key, f"the moment {key} which data are read" if key == "from" else "the moment up to which")
    try:
        return datetime.fromisoformat(value)
    except ValueError:
        raise ProjectError(f"{key}: {value!r} is no moment: write it as 2026-10-01T00:00:00+02:00") from None
