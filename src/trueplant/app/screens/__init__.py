"""The screens, one module each: its pages at /<screen>, what its script asks for at /api/<screen>/<verb>."""

from __future__ import annotations

from starlette.routing import Route

from trueplant.app.screens import audit, compare, model, out, plan, run, start, tags, track, trends, verdict, whatif

ROUTES: list[Route] = [
    *audit.ROUTES,
    *compare.ROUTES,
    *model.ROUTES,
    *out.ROUTES,
    *plan.ROUTES,
    *run.ROUTES,
    *start.ROUTES,
    *tags.ROUTES,
    *track.ROUTES,
    *trends.ROUTES,
    *verdict.ROUTES,
    *whatif.ROUTES,
]
