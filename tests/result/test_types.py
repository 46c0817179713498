"""What a result holds is typed: no `Any` in what users of trueplant.result see, `to_dict` excepted."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator

import trueplant.result as results


def signatures() -> Iterator[tuple[str, str]]:
    """Every public name of the room with each of its annotations as text."""
    for info in pkgutil.iter_modules(results.__path__, "trueplant.result."):
        module = importlib.import_module(info.name)
        for name, value in vars(module).items():
            if name.startswith("_") or getattr(value, "__module__", None) != info.name:
                continue
            if inspect.isfunction(value):
                yield from ((f"{info.name}.{name}", str(text)) for text in value.__annotations__.values())
            elif inspect.isclass(value):
                own = [(name, inspect.get_annotations(value))]
                for key, member in vars(value).items():
                    function = member.fget if isinstance(member, property) else member
                    if inspect.isfunction(function) and not key.startswith("__"):
                        own.append((f"{name}.{key}", function.__annotations__))
                for place, annotations in own:
                    yield from ((f"{info.name}.{place}", str(text)) for text in annotations.values())


def test_no_any_but_in_to_dict():
    found = list(signatures())
    assert len(found) > 300
    assert {place for place, text in found if "Any" in text} == {
        "trueplant.result.check.Check.to_dict",
        "trueplant.result.comparison.Comparison.to_dict",
        "trueplant.result.result.Result.to_dict",
        "trueplant.result.track.Track.to_dict",
    }
