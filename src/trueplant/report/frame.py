"""What every page has: its figures and plotly, packed, the script that unpacks and draws them, style and both palettes.

What a page runs is named by its hash in the page's policy: the script of the page, and plotly as it is once unpacked. A
page without figures has no script.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.report import levels

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


_DOUBLES = re.compile(r'"dtype":\s*"f8",\s*"bdata":\s*"([^"]*)"')
"""Arrays as plotly writes them into JSON."""


def _as_singles(found: re.Match[str]) -> str:
    """The same array in half of the room, where no eye could see the difference."""
    values = np.frombuffer(base64.b64decode(found[1].replace("\\u002f", "/")), dtype="<f8")
    seen = values[np.isfinite(values)]
    span = float(np.ptp(seen)) if seen.size else 0.0
    lost = float(np.spacing(np.float32(np.max(np.abs(seen), initial=0.0))))
    if lost > levels.UNSEEN * span:
        return found[0]
    packed_values = base64.b64encode(values.astype("<f4").tobytes()).decode()
    return f'"dtype":"f4","bdata":"{packed_values}"'


class Book:
    """Collects the figures in the order in which they appear."""

    def __init__(self) -> None:
        self.drawn: list[Drawn] = []

    def add(self, figure: go.Figure, title: str, caption: str) -> Drawn:
        name = f"figure-{len(self.drawn) + 1}"
        text = _DOUBLES.sub(_as_singles, figure.to_json(engine="json", validate=False))
        self.drawn.append(Drawn(name, title, caption, int(figure.layout.height), text))
        return self.drawn[-1]

    def json(self) -> str:
        """All figures and both palettes."""
        import json

        from trueplant.report.style import DARK, LIGHT

        book = ",".join(f'"{d.id}":{d.json}' for d in self.drawn)
        return f'{{"palettes":{json.dumps({"light": LIGHT, "dark": DARK})},"figures":{{{book}}}}}'


def frame(book: Book) -> dict[str, Any]:
    """What a template needs to be a page that opens offline: packed, script, script_hashes, style, light, dark."""
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    from trueplant.report.style import DARK, LIGHT

    room = files("trueplant.report")
    plotly, script = get_plotlyjs(), room.joinpath("report.js").read_text(encoding="utf-8")
    drawn = bool(book.drawn)
    return {
        "packed": {"book": packed(book.json()), "plotly": packed(plotly)} if drawn else {},
        "script": Markup(script) if drawn else "",
        "script_hashes": " ".join(f"'sha256-{_digest(s)}'" for s in (plotly, script)) if drawn else "'none'",
        "style": Markup(room.joinpath("report.css").read_text(encoding="utf-8")),
        "light": Markup(_variables(LIGHT)),
        "dark": Markup(_variables(DARK)),
    }


HARMLESS = str.maketrans("<>&`", ",./:")
"""Letters of base 85 that HTML would read, and others in their place, which base 85 does not have."""


def packed(text: str) -> str:
    """Text as gzip in base 85; the same text gives the same letters."""
    return base64.b85encode(gzip.compress(text.encode(), 9, mtime=0)).decode().translate(HARMLESS)


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _variables(palette: Mapping[str, str]) -> str:
    return "".join(f"--{role.replace('_', '-')}:{color};" for role, color in palette.items())
