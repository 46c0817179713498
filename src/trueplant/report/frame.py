"""What every page has: its figures as JSON, the scripts that draw them with their hashes, style and both palettes."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import plotly.graph_objects as go


@dataclass(frozen=True)
class Drawn:
    """A figure as the template needs it: where it goes, what it shows, and plotly's JSON."""

    id: str
    title: str
    caption: str
    height: int
    json: str


class Book:
    """Collects the figures in the order in which they appear."""

    def __init__(self) -> None:
        self.drawn: list[Drawn] = []

    def add(self, figure: go.Figure, title: str, caption: str) -> Drawn:
        name = f"figure-{len(self.drawn) + 1}"
        text = figure.to_json(engine="json", validate=False)
        self.drawn.append(Drawn(name, title, caption, int(figure.layout.height), text))
        return self.drawn[-1]

    def json(self) -> str:
        """All figures and both palettes, safe inside a script element."""
        import json

        from trueplant.report.style import DARK, LIGHT

        book = ",".join(f'"{d.id}":{d.json}' for d in self.drawn)
        text = f'{{"palettes":{json.dumps({"light": LIGHT, "dark": DARK})},"figures":{{{book}}}}}'
        return text.replace("<", "\\u003c")


def frame(book: Book) -> dict[str, Any]:
    """What a template needs to be a page that opens offline: book, scripts, script_hashes, style, light, dark."""
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    from trueplant.report.style import DARK, LIGHT

    room = files("trueplant.report")
    scripts = [get_plotlyjs(), room.joinpath("report.js").read_text(encoding="utf-8")]
    return {
        "book": Markup(book.json()),
        "scripts": [Markup(s) for s in scripts],
        "script_hashes": " ".join(f"'sha256-{_digest(s)}'" for s in scripts),
        "style": Markup(room.joinpath("report.css").read_text(encoding="utf-8")),
        "light": Markup(_variables(LIGHT)),
        "dark": Markup(_variables(DARK)),
    }


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _variables(palette: Mapping[str, str]) -> str:
    return "".join(f"--{role.replace('_', '-')}:{color};" for role, color in palette.items())
