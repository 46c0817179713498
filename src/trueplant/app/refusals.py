"""What the gate itself answers: a short page, or JSON where a script asked."""

from __future__ import annotations

import html
from dataclasses import dataclass

from starlette.responses import HTMLResponse, JSONResponse, Response

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">{head}
<title>trueplant</title><link rel="icon" href="data:,"><style nonce="{nonce}">
:root {{ color-scheme: light dark }}
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 40rem; margin: 3rem auto; padding: 0 1rem }}
button {{ font: inherit; padding: .4rem 1rem }}
</style></head><body><main><h1>trueplant</h1>{body}</main></body></html>
"""
_AGAIN = """<p>To get in again, open the link that stands on the terminal in which <code>trueplant app</code> runs. It
works once; if it was used already, have a new one shown there:</p>
<p><button id="again" type="button">Show a new link on the terminal</button></p><p id="said" role="status"></p>
<script nonce="{nonce}">
document.getElementById("again").addEventListener("click", async () => {{
  const answer = await fetch("/new-link", {{ method: "POST" }});
  document.getElementById("said").textContent = (await answer.json()).said || "That did not work.";
}});
</script>"""


@dataclass(frozen=True)
class Answer:
    """One message of the gate."""

    status: int
    message: str
    new_link: bool = False
    """Whether the page offers one."""
    cookie: str = ""
    ahead: str = ""
    """An address on the app to which the browser goes on by itself."""

    def response(self, nonce: str, path: str) -> Response:
        """JSON for addresses that scripts ask."""
        headers = {"set-cookie": self.cookie} if self.cookie else None
        if path.startswith("/api/") or path == "/new-link":
            return JSONResponse({"error" if self.status >= 400 else "said": self.message}, self.status)
        # not a redirect: that would still count as coming from where the link was clicked, and get no cookie
        onward = f'<meta http-equiv="refresh" content="0;url={html.escape(self.ahead)}">'
        head = onward if self.ahead else ""
        body = f"<p>{html.escape(self.message)}</p>" + (_AGAIN.format(nonce=nonce) if self.new_link else "")
        return HTMLResponse(_PAGE.format(head=head, body=body, nonce=nonce), self.status, headers)


def refused(status: int, message: str, new_link: bool = False) -> Answer:
    """What is wrong, and how to get in where that is it."""
    return Answer(status, message, new_link)


def welcome(cookie: str, ahead: str) -> Answer:
    """The cookie of a new session, and on to what was asked for."""
    return Answer(200, "Welcome.", cookie=cookie, ahead=ahead)


def link_said(shown: bool) -> Answer:
    """Whether a new link was shown."""
    if shown:
        return Answer(200, "A new link stands on the terminal now.")
    return Answer(200, "A link was shown there a moment ago: open that one, or try again in ten seconds.")
