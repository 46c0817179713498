"""A site's audit: every loop of it, worst first, each with the way into its verdict and its project."""

from __future__ import annotations

from collections import Counter
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.audited import LoopLine, audit_loops, audits
from trueplant.app.command_lines import command
from trueplant.app.downloads import as_csv, download
from trueplant.app.fragments import fragment
from trueplant.app.pages import folder_of, page, url


async def audit(request: Request) -> Response:
    """The page: the audits of the folder, and the loops of the one that is chosen, else of the newest."""
    folder = folder_of(request)
    known = await run_in_threadpool(audits, folder)
    name = request.query_params.get("audit", "") or (known[0].name if known else "")
    context: dict[str, Any] = {"audits": known, "name": name, "body": None, "line": command("audit", "SITE.toml")}
    if name:
        said, loops = await run_in_threadpool(audit_loops, folder, name)
        context["body"] = fragment(
            "audit_body.html.j2",
            headline=said,
            tally=Counter((one.kind, one.badge) for one in loops).most_common(),
            loops=[(one, *_links(request, one)) for one in loops],
            save=url(request, "audit/file", audit=name),
        )
    return page(request, "audit.html.j2", screen="out", **context)


async def file(request: Request) -> Response:
    """The ranking for a sheet."""
    _, loops = await run_in_threadpool(audit_loops, folder_of(request), request.query_params.get("audit", ""))
    headings = ("rank", "loop", "verdict", "importance", "grade", "since", "action", "what is known")
    rows = [(k, x.name, x.kind, x.matters, x.grade, x.since, x.action, x.text) for k, x in enumerate(loops, 1)]
    return download(as_csv(headings, rows), "audit.csv")


def _links(request: Request, loop: LoopLine) -> tuple[str, str]:
    """To its verdict and to its project; empty where there is none in the folder."""
    verdict = ""
    if loop.result:
        named = {"project": loop.project} if loop.project else {"project": ""}
        verdict = url(request, "verdict", **named, result=loop.result)
    return verdict, url(request, "trends", project=loop.project) if loop.project else ""


ROUTES = [Route("/audit", audit), Route("/audit/file", file)]
