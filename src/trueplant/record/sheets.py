"""The cells of a sheet as the library gives them; those of old workbooks by way of a process of their own.

Damage to an .xls file, which cannot be measured beforehand, can end the process that reads it, or keep it busy.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from typing import TYPE_CHECKING, TypeAlias

from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.types import Finding, Kind

if TYPE_CHECKING:
    import polars as pl

    Sheet: TypeAlias = tuple[pl.DataFrame, str, tuple[Finding, ...]]


def loaded(data: bytes, name: str, sheet: str | None) -> Sheet:
    """The cells of a sheet (None: the first) as text, its name, and what there is to say of the choice.

    Raises DataError for a sheet that is not there.
    """
    import fastexcel
    import polars as pl

    book = fastexcel.read_excel(data)
    names = list(book.sheet_names)
    if sheet is not None and sheet not in names:
        raise DataError(f"{name} has no sheet {sheet!r}; it has: {', '.join(names)}")
    chosen = sheet if sheet is not None else names[0]
    notes: tuple[Finding, ...] = ()
    if sheet is None and len(names) > 1:
        message = f"{name}: sheet {chosen!r} was read, the first of {len(names)}; name another one in `sheet`."
        notes = (Finding(Kind.SHEET, name, message),)
    frame = book.load_sheet(chosen, header_row=None, skip_rows=0, dtypes="string").to_polars()
    # as text, numbers come rounded to nine decimals
    exact = book.load_sheet(chosen, header_row=None, skip_rows=0, dtypes="float").to_polars()
    return pl.DataFrame([_exact(frame[c], exact[c]) for c in frame.columns]), chosen, notes


def loaded_apart(data: bytes, name: str, sheet: str | None) -> Sheet:
    """The same from another process. Raises ValueError where that ends without an answer or takes too long."""
    command = [sys.executable, "-P", "-c", f"from {__name__} import answer; answer()"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run(
            command,
            input=pickle.dumps((data, name, sheet)),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=levels.MOST_SECONDS_APART,
            env=environment,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it cannot be read in {levels.MOST_SECONDS_APART} s") from None
    if done.returncode != 0:
        raise ValueError("the library fails on it")
    found: Sheet | Exception = pickle.loads(done.stdout)
    if isinstance(found, Exception):
        raise found
    return found


def answer() -> None:
    """What the other process does: the workbook comes on standard input, sheet or error go to standard output."""
    with contextlib.suppress(ImportError, OSError, ValueError):  # not everywhere, or limited already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (levels.MOST_MEMORY_APART, levels.MOST_MEMORY_APART))
    asked = pickle.load(sys.stdin.buffer)
    try:
        found: Sheet | Exception = loaded(*asked)
    except DataError as error:
        found = error
    except Exception as error:
        found = ValueError(str(error))
    sys.stdout.buffer.write(pickle.dumps(found))


def _exact(text: pl.Series, value: pl.Series) -> pl.Series:
    """Cells as text, those that are numbers in full precision."""
    import polars as pl

    if value.dtype != pl.Float64:
        return text
    number = text.cast(pl.Float64, strict=False).is_not_null() & value.is_not_null()
    return value.cast(pl.String).zip_with(number, text).alias(text.name)
