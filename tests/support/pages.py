"""Reports taken apart: their elements, and the data they carry."""

from __future__ import annotations

import base64
import gzip
import json
import re
from html.parser import HTMLParser

from trueplant.report.frame import HARMLESS

VOID = {"meta", "br", "wbr", "hr", "img", "input", "link", "path", "circle", "rect"}


class Page(HTMLParser):
    """Elements with attributes and text; complains of tags that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None], list[str]]] = []
        self.within: list[int] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs), []))
        if tag not in VOID:
            self.open.append(tag)
            self.within.append(len(self.elements) - 1)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs), []))

    def handle_endtag(self, tag: str) -> None:
        assert self.open[-1:] == [tag], f"</{tag}> closes {self.open[-3:]}"
        if tag in ("td", "th"):
            self.handle_data(" ")
        self.open.pop()
        self.within.pop()

    def handle_data(self, data: str) -> None:
        for k in self.within:
            self.elements[k][2].append(data)

    def all(self, tag: str) -> list[tuple[dict[str, str | None], str]]:
        return [(a, " ".join("".join(text).split())) for t, a, text in self.elements if t == tag]

    def by_id(self, name: str) -> str:
        return next(" ".join("".join(text).split()) for _, a, text in self.elements if a.get("id") == name)


PACKED = re.compile(r'<script type="application/gzip" id="(\w+)">([^<]*)</script>')


def unpacked(page: str) -> dict[str, str]:
    """What a page unpacks: plotly and the book of figures; nothing for a page without figures."""
    letters = {put: given for given, put in HARMLESS.items()}
    return {
        name: gzip.decompress(base64.b85decode(text.translate(letters))).decode() for name, text in PACKED.findall(page)
    }


def without_plotly(page: str) -> str:
    """The page with its figures' JSON as it is unpacked."""
    found = unpacked(page)
    return PACKED.sub(lambda one: found["book"].replace("<", "\\u003c") if one[1] == "book" else "", page)


def book(page: str) -> dict[str, dict]:
    return json.loads(unpacked(page)["book"])
