"""The screens, one module each: its pages at /<screen>, what its script asks for at /api/<screen>/<verb>."""

from __future__ import annotations

from starlette.routing import Route

from trueplant.app.screens import run, start, tags, verdict, whatif

ROUTES: list[Route] = [*run.ROUTES, *start.ROUTES, *tags.ROUTES, *verdict.ROUTES, *whatif.ROUTES]
