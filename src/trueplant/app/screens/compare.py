"""Two saved results beside each other: what differs, and whether beyond chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.command_lines import command
from trueplant.app.downloads import download
from trueplant.app.folder import Folder, Outside
from trueplant.app.fragments import fragment
from trueplant.app.pages import folder_of, page, url
from trueplant.app.saved import listed, read_saved
from trueplant.output import as_json
from trueplant.report.numbers import percentage
from trueplant.result import Result
from trueplant.result.comparison import ComparedElement, ComparedLoop, ComparedParameter, Comparison
from trueplant.result.numbers import number, value_with_interval


@dataclass(frozen=True)
class Row:
    """One parameter as text."""

    name: str
    unit: str
    first: str
    second: str
    difference: str
    error: str
    p: str
    differs: bool


async def compare(request: Request) -> Response:
    """The page: two to choose, and what differs between them."""
    folder = folder_of(request)
    names = _asked(request)
    results = await run_in_threadpool(listed, folder)
    context: dict[str, Any] = {"results": results, "first": names[0], "second": names[1], "body": None, "line": ""}
    if all(names):
        found = await run_in_threadpool(_compared, folder, names)
        context["body"] = fragment(
            "compare_body.html.j2",
            found=found,
            names=names,
            elements=[(e, [_row(p) for p in e.parameters], _verdicts(e)) for e in found.elements],
            settings=[(loop, _values(loop, 0), _values(loop, 1)) for loop in found.controllers],
            confidence=100 * found.confidence,
            save=url(request, "compare/file", first=names[0], second=names[1]),
        )
        context["line"] = command("compare", *names)
    return page(request, "compare.html.j2", screen="out", **context)


async def file(request: Request) -> Response:
    """compare.json."""
    names = _asked(request)
    found = await run_in_threadpool(_compared, folder_of(request), names)
    return download(as_json(found.to_dict()), "compare.json")


def _asked(request: Request) -> tuple[str, str]:
    return request.query_params.get("first", ""), request.query_params.get("second", "")


def _compared(folder: Folder, names: tuple[str, str]) -> Comparison:
    from trueplant.detect.beside import compare_results

    first, second = (_read(folder, name) for name in names)
    return compare_results(first, second)


def _read(folder: Folder, name: str) -> Result:
    result = read_saved(folder.path(name))
    if result is None:
        raise Outside(f"there is no saved result in {name}")
    return result


def _row(one: ComparedParameter) -> Row:
    texts = []
    for value, ci in ((one.first, one.first_ci), (one.second, one.second_ci)):
        texts.append("not known" if value is None else number(value) if ci is None else value_with_interval(value, ci))
    difference = one.reason
    if one.difference is not None:
        share = f" ({percentage(100 * one.difference / abs(one.first))})" if one.first else ""
        difference = f"{number(one.difference)}{share}"
    return Row(
        name=one.name.replace("_", " "),
        unit=one.unit,
        first=texts[0],
        second=texts[1],
        difference=difference,
        error="" if one.std_error is None else number(one.std_error, 2),
        p="" if one.p_adjusted is None else f"{one.p_adjusted:.2g}",
        differs=bool(one.differs),
    )


def _verdicts(element: ComparedElement) -> str:
    """What both say of it, and whether the models were not the same."""
    first, second = element.verdicts
    said = str(first) if first == second else f"{first}, then {second}"
    if element.models[0] != element.models[1]:
        said += f"; the model was {element.models[0]}, then {element.models[1]}"
    return said


def _values(loop: ComparedLoop, which: int) -> str:
    values = (loop.first, loop.second)[which]
    shown = ((key, f"{value:.4g}" if isinstance(value, float) else str(value)) for key, value in values.items())
    return " ".join(f"{key} {value}" for key, value in shown if value != "None") or "none recommended"


ROUTES = [Route("/compare", compare), Route("/compare/file", file)]
