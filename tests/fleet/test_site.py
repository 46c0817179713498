"""A site file is read whole or refused with one message that says where and what to do."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from trueplant.errors import ProjectError
from trueplant.fleet import Site
from trueplant.fleet.jobs import window_of
from trueplant.fleet.site import Audit, seconds_of

LOOPS = '[[loops]]\nprojects = "*.toml"\n'


def load(folder: Path, text: str) -> Site:
    (folder / "site.toml").write_text(text, encoding="utf-8")
    return Site.load(folder / "site.toml")


def test_every_key_is_read(tmp_path: Path) -> None:
    site = load(
        tmp_path,
        """
name = "Refinery 2"
[[loops]]
projects = "units/*/*.toml"
[[loops]]
template = "pid.toml"
table = "loops.csv"
[audit]
workers = 4
deadline = "10 min"
window = "30 d"
[alarm]
on = ["newly changed"]
webhook_env = "TRUEPLANT_WEBHOOK"
[[acknowledged]]
loop = "FC101"
until = 2026-12-24
why = "exchanger is cleaned at the turnaround"
[cluster]
address = "tls://host:8786"
ca = "ca.pem"
certificate = "me.pem"
key = "me.key"
""",
    )
    assert site.name == "Refinery 2" and len(site.loops) == 2
    assert site.audit.finds and seconds_of(site.audit.deadline) == 600
    assert site.alarm is not None and site.alarm.on == ("newly changed",)
    assert site.acknowledged[0].until.isoformat() == "2026-12-24"
    assert site.folder == tmp_path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LOOPS, ["name", "is missing", "the site file"]),
        ('name = "x"\n', ["loops", "is missing"]),
        ('name = "x"\nloop = 1\n' + LOOPS, ["line 2", "is not a key of the site file", '"loops"']),
        ('name = "x"\n[[loops]]\ntemplate = "a.toml"\n', ["template and table go together"]),
        ('name = "x"\n' + LOOPS + 'table = "a.csv"\n', ["template and table"]),
        ('name = "x"\n' + LOOPS + '[audit]\ndeadline = "soon"\n', ["line 5", "audit.deadline", '"10 min"']),
        ('name = "x"\n' + LOOPS + "[audit]\nfrom = 2026-01-01T00:00:00Z\n", ["from and to go together"]),
        ('name = "x"\n' + LOOPS + "[audit]\nfrom = 2026-01-01T00:00:00\nto = 2026-01-02T00:00:00\n", ["offset"]),
        ('name = "x"\n' + LOOPS + '[cluster]\naddress = "tcp://host:8786"\n', ["tls://", "not on this machine"]),
        ('name = "x"\n' + LOOPS + '[cluster]\naddress = "tls://host:8786"\n', ["is needed with a tls:// address"]),
        ('name = "x"\n' + LOOPS + '[alarm]\nwebhook = "https://x/s3cret"\n', ["webhook_env"]),
        ("name = ", ["is not valid TOML"]),
    ],
)
def test_mistakes_are_one_message(tmp_path: Path, text: str, words: list[str]) -> None:
    with pytest.raises(ProjectError) as error:
        load(tmp_path, text)
    said = str(error.value)
    assert "site.toml" in said and all(word in said for word in words), said
    assert "s3cret" not in said and "\n" not in said


def test_a_missing_site_file(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match=r"does not exist; correct the path"):
        Site.load(tmp_path / "no.toml")


def test_a_window_is_the_same_all_day() -> None:
    morning, evening = (datetime(2026, 10, 5, hour, 17, tzinfo=UTC) for hour in (3, 22))
    long = Audit(window="30 d")
    assert window_of(long, morning) == window_of(long, evening)
    assert window_of(long, morning) == (datetime(2026, 9, 5, tzinfo=UTC), datetime(2026, 10, 5, tzinfo=UTC))
    short = window_of(Audit(window="8 h"), morning)
    assert short == (datetime(2026, 10, 4, 19, tzinfo=UTC), datetime(2026, 10, 5, 3, tzinfo=UTC))
    assert window_of(Audit()) is None
