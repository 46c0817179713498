"""Parts of pages that the report's own tables and macros make: what the app shows is what the report says."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jinja2
    from markupsafe import Markup


def fragment(template: str, **context: Any) -> Markup:
    """HTML text of a template that may import the report's macros."""
    from markupsafe import Markup

    from trueplant.report.levels import MOST_ROWS

    return Markup(_environment().get_template(template).render(most_rows=MOST_ROWS, **context))


@cache
def _environment() -> jinja2.Environment:
    from trueplant.report.page import environment
    from trueplant.result.numbers import spoken

    made = environment("trueplant.report", "trueplant.app.templates")
    made.filters |= {"arrows": lambda text: str(text).replace("->", "→"), "spoken": spoken}
    return made
