"""The command ``report``: the page of a saved result drawn again, without the data."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from trueplant.claims import claim
from trueplant.cli.layout import say_lines
from trueplant.output import (
    BESIDE,
    CURVES,
    REPORT,
    RESULT,
    SHIFT,
    page_unchanged,
    read_results,
    results_folder,
    write_files,
    write_page,
)
from trueplant.result import Result, Status
from trueplant.version import __version__


def report(saved: Path, out: Path | None, shift: bool, force: bool) -> int:
    """Draw report.html again, or the sheet for the shift, there or elsewhere; say what is not as the run drew it."""
    result = read_results(saved)
    from trueplant.report import render
    from trueplant.report.shift import render_shift

    folder = results_folder(saved)
    name, text = (SHIFT, render_shift(result)) if shift else (REPORT, render(result))
    same = page_unchanged(folder, name, text)
    if out is None or out.resolve() == (folder / name).resolve():
        place = write_page(folder, name, text, force)
    else:
        place = write_elsewhere(folder, out, text, force)
    told = ["the same page as before"] if same else [] if shift else differences(result)
    say_lines(place, *told)
    return 0


def write_elsewhere(folder: Path, place: Path, text: str, force: bool) -> Path:
    """Write a page that is none of the result's own files. Raises OutputError."""
    claim([place], [folder / name for name in (*BESIDE, RESULT)], force)
    return write_files(place.parent, {place.name: text})[place.name]


def differences(result: Result) -> Iterator[str]:
    """What a page drawn from the files lacks beside one that was drawn from the data."""
    drawn_by = result.provenance.version
    if drawn_by != __version__:
        yield f"drawn by trueplant {__version__}; the analysis is of {drawn_by}, whose page may have looked otherwise"
    if result.curves is None:
        if result.status != Status.REFUSED:
            yield f"{CURVES} is not there: the page has no figures; run the analysis again for them"
        return
    for trend in result.curves.trends:
        if trend.thinned_from:
            yield (
                f"{trend.name}: {CURVES} keeps {trend.t.size} of {trend.thinned_from} samples, the extremes, and the "
                "trends are drawn from those; the errors (rms) are left out of the captions"
            )
