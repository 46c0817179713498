"""Nobody but who came by the link gets anything from the app, and nothing is changed from another page."""

from __future__ import annotations

import itertools
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.routing import Route

from app.asking import OWN, PORT, Visitor
from trueplant.app import levels
from trueplant.app.gate import PROXY_KEY, Doorkeeper
from trueplant.app.screens import ROUTES
from trueplant.app.server import FRAME

ALL = [(method, route) for route in [*FRAME, *ROUTES] for method in sorted(route.methods or ())]
CHANGING = [(method, route) for method, route in ALL if method not in ("GET", "HEAD")]
FOREIGN = "http://127.0.0.1:9999"

BAD = {
    "no cookie": {"cookie": None},
    "a made-up cookie": {"cookie": f"trueplant-{PORT}=AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"},
    "no Host": {"host": None},
    "a wrong Host": {"host": f"evil.example:{PORT}"},
    "another port in Host": {"host": "127.0.0.1:9999"},
    "Host without a port": {"host": "127.0.0.1"},
    "from another site": {"sec-fetch-site": "cross-site"},
    "from another port of this machine": {"sec-fetch-site": "same-site"},
}
BAD_CHANGE = {
    "no Origin": {"origin": None},
    "Origin null": {"origin": "null"},
    "a wrong Origin": {"origin": "http://evil.example"},
    "another port in Origin": {"origin": FOREIGN},
    "no CSRF token": {"x-csrf-token": None},
    "a made-up CSRF token": {"x-csrf-token": "AAAA"},
    "a CSRF token that is no ASCII": {"x-csrf-token": "\xe9"},
}


def place(route: Route) -> str:
    return re.sub(r"{[^}]*}", "app.css", route.path) + "?project=project.toml"


def name(value: object) -> str:
    return value.path if isinstance(value, Route) else str(value)


@pytest.fixture(scope="module")
def visitor(demo_files: Path) -> Visitor:
    return Visitor.inside(demo_files)


def test_the_screens_have_routes() -> None:
    assert len(ALL) > 10 and len(CHANGING) > 2


@pytest.mark.parametrize("how", BAD)
@pytest.mark.parametrize(("method", "route"), ALL, ids=name)
def test_no_route_answers_who_is_not_in(visitor: Visitor, method: str, route: Route, how: str) -> None:
    answer = visitor.ask(method, place(route), change=BAD[how])
    assert answer.status in (401, 403, 421)


@pytest.mark.parametrize("how", BAD_CHANGE)
@pytest.mark.parametrize(("method", "route"), CHANGING, ids=name)
def test_nothing_is_changed_from_another_page(visitor: Visitor, method: str, route: Route, how: str) -> None:
    answer = visitor.ask(method, place(route), b"{}", BAD_CHANGE[how])
    assert answer.status == 403
    assert "error" in answer.json()


@pytest.mark.parametrize(("method", "route"), ALL, ids=name)
@pytest.mark.parametrize("clock", ["idle", "longest"])
def test_no_route_answers_an_ended_session(demo_files: Path, method: str, route: Route, clock: str) -> None:
    visitor = Visitor.inside(demo_files)
    for session in visitor.keeper.sessions.values():
        if clock == "idle":
            session.seen -= levels.SESSION_IDLE
        else:
            session.began -= levels.SESSION_LONGEST
    answer = visitor.ask(method, place(route))
    assert answer.status == 401
    assert not visitor.keeper.sessions


@pytest.mark.parametrize("method", ["OPTIONS", "TRACE", "PUT", "DELETE", "PATCH", "X"])
def test_other_methods_are_changes(visitor: Visitor, method: str) -> None:
    assert visitor.ask(method, "/", change={"origin": None}).status == 403
    assert visitor.ask(method, "/", change={"x-csrf-token": None}).status == 403
    assert visitor.ask(method, "/").status == 405


def test_the_right_visitor_is_answered(visitor: Visitor) -> None:
    for host in (f"127.0.0.1:{PORT}", f"localhost:{PORT}"):
        assert visitor.ask("GET", "/static/app.css", change={"host": host}).status == 200
    assert visitor.ask("GET", "/favicon.ico").headers["content-type"] == "image/svg+xml"
    assert visitor.ask("GET", "/static/app.css", change={"sec-fetch-site": None}).status == 200


def test_a_token_works_once(demo_files: Path) -> None:
    visitor = Visitor.outside(demo_files)
    link = visitor.keeper.link().removeprefix(OWN)
    assert visitor.ask("HEAD", link).status == 401
    assert visitor.ask("GET", link[:-1]).status == 401
    assert visitor.ask("GET", link.replace("/?", "/static/app.css?")).status == 401
    first = visitor.ask("GET", link)
    assert first.status == 200
    assert re.fullmatch(
        rf"trueplant-{PORT}=[\w-]{{43}}; Path=/; HttpOnly; SameSite=Strict", first.headers["set-cookie"]
    )
    assert "url=/&quot;" not in first.text and "token" not in first.text
    assert visitor.ask("GET", link).status == 401
    assert visitor.ask("GET", "/?token=").status == 401


def test_a_newer_link_ends_the_older(demo_files: Path) -> None:
    visitor = Visitor.outside(demo_files)
    old, new = visitor.keeper.link().removeprefix(OWN), visitor.keeper.link().removeprefix(OWN)
    assert visitor.ask("GET", old).status == 401
    assert visitor.ask("GET", new).status == 200


def test_the_link_leads_on_to_its_project(demo_files: Path) -> None:
    visitor = Visitor.outside(demo_files)
    link = visitor.keeper.link().removeprefix(OWN) + "&project=a%20%22b%22.toml"
    assert 'content="0;url=/?project=a+%22b%22.toml"' in visitor.ask("GET", link).text


def test_who_is_out_can_have_a_new_link_on_the_terminal_alone(demo_files: Path) -> None:
    said: list[str] = []
    visitor = Visitor.outside(demo_files, say_link=said.append)
    page = visitor.ask("GET", "/start")
    assert page.status == 401 and "trueplant app" in page.text
    answer = visitor.ask("POST", "/new-link")
    assert answer.status == 200 and len(said) == 1
    assert said[0].split("=")[1] not in answer.text
    assert visitor.ask("POST", "/new-link").status == 200 and len(said) == 1, "nobody floods the terminal"
    assert visitor.ask("GET", said[0].removeprefix(OWN)).status == 200


def test_another_page_has_no_link_shown(demo_files: Path) -> None:
    said: list[str] = []
    visitor = Visitor.outside(demo_files, say_link=said.append)
    for change in ({"origin": FOREIGN}, {"origin": None}, {"sec-fetch-site": "cross-site"}, {"host": "evil.example"}):
        assert visitor.ask("POST", "/new-link", change=change).status in (403, 421)
    assert not said


def test_sessions_do_not_pile_up() -> None:
    keeper = Doorkeeper(PORT)
    keys = [keeper.enter(keeper.link().split("=")[1]) for _ in range(levels.SESSIONS + 3)]
    assert len(keeper.sessions) == levels.SESSIONS
    assert keys[0] not in keeper.sessions and keys[-1] in keeper.sessions


# -- behind a reverse proxy ------------------------------------------------------------------------------------------

PROXY = "https://plant.example.com"
KEY = "0123456789abcdef0123456789abcdef"


def test_a_proxy_vouches_by_its_key(demo_files: Path) -> None:
    visitor = Visitor.outside(demo_files, address=PROXY, proxy_key=KEY)
    through = {"host": "plant.example.com", PROXY_KEY: KEY}
    first = visitor.ask("GET", "//evil.example/start?project=a.toml", change=through)
    assert first.status == 200 and 'url=/evil.example/start?project=a.toml"' in first.text
    assert first.headers["set-cookie"].endswith("; Secure")
    visitor.cookie = first.headers["set-cookie"].split(";")[0]
    visitor.csrf = next(iter(visitor.keeper.sessions.values())).csrf
    assert visitor.ask("GET", "/static/app.css", change=through).status == 200
    changing = through | {"origin": PROXY}
    assert visitor.ask("POST", "/api/project/undo?project=project.toml", b"{}", changing).status == 409
    for bad in ({"origin": "https://evil.example"}, {"x-csrf-token": None}):
        assert visitor.ask("POST", "/api/project/undo?project=project.toml", b"{}", changing | bad).status == 403


@pytest.mark.parametrize("key", ["", "0" * 32, None])
def test_no_other_key_opens(demo_files: Path, key: str | None) -> None:
    visitor = Visitor.outside(demo_files, address=PROXY, proxy_key=KEY)
    assert visitor.ask("GET", "/start", change={PROXY_KEY: key}).status == 401
    assert Visitor.outside(demo_files).ask("GET", "/start", change={PROXY_KEY: key or ""}).status == 401


# -- what a page may do ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/static/app.js", "/nowhere", "/vendor/uPlot.min.css", "/api/nowhere"])
@pytest.mark.parametrize("inside", [True, False])
def test_every_answer_has_the_headers(demo_files: Path, path: str, inside: bool) -> None:
    visitor = Visitor.inside(demo_files) if inside else Visitor.outside(demo_files)
    headers = visitor.ask("GET", path).headers
    policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'" and policy["frame-ancestors"] == "'none'"
    assert not re.search("unsafe|https?:|\\*", headers["content-security-policy"])
    assert headers["x-content-type-options"] == "nosniff" and headers["referrer-policy"] == "no-referrer"
    assert headers["x-frame-options"] == "DENY" and headers["cross-origin-resource-policy"] == "same-origin"
    assert headers["cache-control"] == (
        "no-cache" if inside and path.startswith(("/static", "/vendor")) else "no-store"
    )


def test_nonces_differ(visitor: Visitor) -> None:
    nonces = {
        re.search("'nonce-([^']+)'", visitor.ask("GET", "/").headers["content-security-policy"]) for _ in range(5)
    }
    assert len({found[1] for found in nonces if found}) == 5


def test_a_kept_file_is_asked_for_again(visitor: Visitor) -> None:
    first = visitor.ask("GET", "/static/app.js")
    again = visitor.ask("GET", "/static/app.js", change={"if-none-match": first.headers["etag"]})
    assert again.status == 304 and again.content == b""


# -- bodies ----------------------------------------------------------------------------------------------------------


def test_a_long_body_is_refused_by_its_length(visitor: Visitor) -> None:
    answer = visitor.ask("POST", "/api/project/undo", b"{}", {"content-length": str(levels.BODY + 1)})
    assert answer.status == 413 and "4 MB" in answer.json()["error"]
    assert visitor.ask("POST", "/api/project/undo", b"{}", {"content-length": "many"}).status == 400


def test_a_long_body_is_refused_while_it_comes(demo_files: Path) -> None:
    visitor = Visitor.inside(demo_files)
    taken = 0

    def endless() -> Iterator[bytes]:
        nonlocal taken
        for _ in itertools.count():
            taken += 2**16
            yield b"x" * 2**16

    async def reads(request: object) -> object:
        return await request.body()  # type: ignore[attr-defined]

    visitor.app.router.routes.append(Route("/api/test", reads, methods=["POST"]))
    answer = visitor.ask("POST", "/api/test", endless())
    assert answer.status == 413 and "error" in answer.json()
    assert taken < levels.BODY + 2**18


# -- files -----------------------------------------------------------------------------------------------------------

ESCAPES = [
    "../secret.toml",
    "/etc/passwd",
    "a/../../secret.toml",
    "linked.toml",
    "below/secret.toml",
    "\0.toml",
    "..",
    "",
]


@pytest.mark.parametrize("named", ESCAPES)
def test_no_path_leads_out(tmp_path: Path, named: str) -> None:
    (tmp_path / "secret.toml").write_text("[data]\nfiles = ['secret']\n")
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "linked.toml").symlink_to(tmp_path / "secret.toml")
    (inside / "below").symlink_to(tmp_path)
    visitor = Visitor.inside(inside)
    from urllib.parse import quote

    for path in ("/api/project/undo", "/api/project/redo"):
        answer = visitor.post(f"{path}?project={quote(named)}", {})
        assert answer.status in (400, 404) and "secret'" not in answer.text
    for kind in ("static", "vendor"):
        assert visitor.ask("GET", f"/{kind}/{quote(named, safe='')}").status in (404, 400)


@pytest.mark.parametrize(
    "named", ["..%2f..%2fgate.py", "../gate.py", "icon.svg/", "vendor.json", "plotly-basic.LICENSE"]
)
def test_only_own_files_are_static(visitor: Visitor, named: str) -> None:
    for kind in ("static", "vendor"):
        assert visitor.ask("GET", f"/{kind}/{named}").status == 404


def test_it_listens_on_this_machine_alone() -> None:
    from trueplant.app.server import listen

    listening = listen(0)
    try:
        assert listening.getsockname()[0] == "127.0.0.1"
    finally:
        listening.close()


def test_a_taken_port_is_one_message() -> None:
    from trueplant.app.server import listen
    from trueplant.errors import UsageError

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=f"port {port} .*--port"):
            listen(port)


def test_a_mistake_of_the_app_is_one_message(demo_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    visitor = Visitor.inside(demo_files)

    async def broken(request: object) -> object:
        raise ZeroDivisionError("secret")

    visitor.app.router.routes.append(Route("/api/test", broken))
    answer = visitor.ask("GET", "/api/test")
    assert answer.status == 500 and "secret" not in answer.text
    details = Path(re.search(r"written to (\S+\.txt)", answer.json()["error"])[1])  # type: ignore[index]
    assert "ZeroDivisionError: secret" in details.read_text()
