"""The screens, one module each: its pages at /<screen>, what its script asks for at /api/<screen>/<verb>."""

from __future__ import annotations

from starlette.routing import Route

from trueplant.app.screens import run, start, tags, trends, verdict, whatif

ROUTES: list[Route] = [*run.ROUTES, *start.ROUTES, *tags.ROUTES, *trends.ROUTES, *verdict.ROUTES, *whatif.ROUTES]
