"""The alarm: a webhook is told of what is new, once; what is acknowledged alarms no more until its date has passed.

What was told stands in alarms.json. A finding that could not be told of is told of with the next audit, and one that
went away and came again is new.
"""

from __future__ import annotations

import json
import os
import re
import ssl
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from datetime import date
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from trueplant.fleet.rank import Ranked
from trueplant.fleet.row import FAILURES, Finding, Outcome
from trueplant.fleet.site import Acknowledged, Alarm, Site
from trueplant.fleet.store import Store, write_whole
from trueplant.output import as_json
from trueplant.result import ElementVerdict
from trueplant.version import __version__

STATE = "alarms.json"
_LOCAL = re.compile(r"http://(127\.0\.0\.1|localhost|\[::1\])(:\d+)?(/|$)")
_WHOLE = (Finding.VALVE, Finding.END, Finding.CONTROLLER)
"""Findings that are of no single element."""


def acknowledged(site: Site, loops: Sequence[Ranked], today: date) -> dict[str, str]:
    """Until when a loop's findings are acknowledged, by its name; of several the earliest date."""
    found = {}
    for one in loops:
        dates = [entry.until for entry in site.acknowledged if entry.until >= today and _is_of(entry, one)]
        if dates:
            found[one.name] = min(dates).isoformat()
    return found


def _is_of(entry: Acknowledged, loop: Ranked) -> bool:
    return fnmatchcase(loop.name, entry.loop) and any(_fits(entry, *where) for where in _findings(loop).values())


def _fits(entry: Acknowledged, output: str, input_: str) -> bool:
    return entry.output in (None, output) and entry.input in (None, input_)


def _findings(loop: Ranked) -> dict[str, tuple[str, str]]:
    """What may alarm of a loop, by a name that it keeps from audit to audit: output and input of it."""
    if loop.row.outcome in FAILURES:
        return {f"newly failed: {loop.name}": ("", "")}
    others = {f"newly changed: {loop.name}: {finding}": ("", "") for finding in loop.row.findings if finding in _WHOLE}
    return others | {
        f"newly changed: {loop.name}: {one.input} -> {one.output}": (one.output, one.input)
        for one in loop.row.elements
        if one.verdict == ElementVerdict.CHANGED
    }


def sound(site: Site, store: Store, loops: Sequence[Ranked], known: Mapping[str, str], time: str) -> list[str]:
    """Tell the webhook of what it was not told before; what went wrong with that, which never is an error."""
    if site.alarm is None:
        return []
    standing = {name: (one, where) for one in loops for name, where in _findings(one).items()}
    told = {name for name in _told(store.folder / STATE) if name in standing or not _answered(name, loops)}
    new = [
        name
        for name, (one, where) in standing.items()
        if name not in told
        and name.partition(":")[0] in site.alarm.on
        and not any(_covers(entry, one, where, known) for entry in site.acknowledged)
    ]
    notes = []
    if new:
        failed = _send(site, site.alarm, _document(site, new, standing, time))
        if failed:
            notes = [f"the alarm of {len(new)} findings was not sent ({failed}); the next audit tries again"]
        else:
            told.update(new)
    write_whole(store.folder / STATE, as_json({"schema": 1, "told": sorted(told)}).encode("utf-8"))
    return notes


def _covers(entry: Acknowledged, loop: Ranked, where: tuple[str, str], known: Mapping[str, str]) -> bool:
    """`known` has the loops with an acknowledgement whose date has not passed."""
    current = loop.name in known and entry.until.isoformat() >= known[loop.name]
    return current and fnmatchcase(loop.name, entry.loop) and _fits(entry, *where)


def _answered(name: str, loops: Sequence[Ranked]) -> bool:
    """Does this audit say that a finding is gone? With --only most loops are not looked at, and one that was refused or
    failed this time says nothing of its plant."""
    what, _, rest = name.partition(": ")
    if what == "newly failed":
        return any(rest == one.name for one in loops)
    for one in loops:
        if rest.startswith(f"{one.name}: ") and one.row.outcome == Outcome.ANALYSED:
            elements = {f"{one.name}: {e.input} -> {e.output}": e.verdict for e in one.row.elements}
            return elements.get(rest) != ElementVerdict.NOT_IDENTIFIABLE
    return False


def _told(place: Path) -> list[str]:
    try:
        return [str(name) for name in json.loads(place.read_text(encoding="utf-8"))["told"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _document(site: Site, new: Sequence[str], standing: Mapping[str, Any], time: str) -> dict[str, Any]:
    """What the webhook gets; `text` is what chat systems show."""
    entries = []
    for name in new:
        loop, (output, input_) = standing[name]
        entry = {"what": name.partition(":")[0], "loop": loop.name, "text": loop.row.text}
        entries.append(entry | ({"output": output, "input": input_} if output else {}))
    text = f"{site.name}: " + "; ".join(name.replace("->", "→") for name in new)
    return {"schema": 1, "site": site.name, "audit": time, "version": __version__, "text": text, "findings": entries}


def _send(site: Site, alarm: Alarm, document: Mapping[str, Any]) -> str:
    """Why it could not be sent, without the address, which is a secret; empty where it was."""
    address = os.environ.get(alarm.webhook_env, "").strip()
    if not address:
        return f"the environment variable {alarm.webhook_env} is not set"
    if not address.startswith("https://") and not _LOCAL.match(address):
        return f"{alarm.webhook_env} holds no address that begins with https://"
    try:
        ca = None if alarm.ca is None else str(site.folder / alarm.ca)
        context = ssl.create_default_context(cafile=ca) if address.startswith("https://") else None
    except (OSError, ValueError) as error:
        return f"alarm.ca, {alarm.ca}, cannot be read: {getattr(error, 'strerror', None) or type(error).__name__}"
    try:
        body = as_json(document, indent=None).encode("utf-8")
        request = urllib.request.Request(address, body, {"Content-Type": "application/json"}, method="POST")
        handlers = [_NoRedirect(), *([urllib.request.HTTPSHandler(context=context)] if context else [])]
        with urllib.request.build_opener(*handlers).open(request, timeout=alarm.timeout):
            return ""
    except urllib.error.HTTPError as error:
        error.close()
        return f"the webhook answered {error.code}"
    except Exception as error:  # whatever a network may do, the audit is done
        return _why(getattr(error, "reason", error))


def _why(reason: object) -> str:
    """What an operating system says, and no more: other messages may quote any part of the address."""
    if isinstance(reason, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted: {reason.verify_message}"
    if isinstance(reason, TimeoutError):
        return "it did not answer in time"
    said = reason.strerror if isinstance(reason, OSError) else None
    return said or f"its address or its answer cannot be used ({type(reason).__name__})"


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """What is told of a plant goes where it was sent, and nowhere else."""

    def redirect_request(self, *_: Any) -> None:
        return None
