"""Mode columns: which of the words and numbers of control systems mean that the controller writes OP."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import BoolArray
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.numbers import counted
from trueplant.record.table import Table
from trueplant.record.types import Finding, Kind


def _words(*lines: str) -> frozenset[str]:
    return frozenset(word for line in lines for word in line.split())


AUTOMATIC = _words(
    "a au aut auto automatic automatik automatisch automatique automatico ac bauto normal 1 true on ein",
    "c cas cascade caskade kaskade bcas prd rcas remcas remotecascade rout remout remoteoutput",
    "rsp remotesp remotesetpoint rem remote p prog program comp computer sup supervisory spc ddc",
)
"""Automatic, cascade, and whatever else leaves the loop closed; only letters and digits, in lower case."""
MANUAL = _words(
    "m ma man manual manuell manuel manuale hand handbetrieb bman dman 0 false off aus",
    "im iman initman initializationmanual inman lo localoverride override trk track tracking tr",
    "oos outofservice os shed stop stopped",
)
"""Somebody or something else writes OP."""


@dataclass(frozen=True, eq=False)
class Modes:
    """A mode column on the rows of a record."""

    automatic: BoolArray
    """(N,); where a cell is empty the last mode goes on, and before the first one it is automatic."""
    finding: Finding
    """Which values there are, how often, and what they were taken for."""


def read_modes(table: Table, rows: np.ndarray, column: str, declared: Sequence[object] | None) -> Modes:
    """The modes of a column; `declared` values are the automatic ones, None: those that are known.

    Raises DataError for a column that is empty or holds no modes.
    """
    import polars as pl

    cells = table.column(column).gather(rows).cast(pl.String).str.strip_chars()
    cells = pl.select(pl.when(cells.str.to_lowercase().is_in(["", "nan"])).then(None).otherwise(cells)).to_series()
    counts = dict(cells.drop_nulls().value_counts(sort=True, name="n").rows())
    what = f"{table.source}: mode column {column!r}"
    if not counts:
        raise DataError(f"{what} is empty; leave it out")
    if len(counts) > levels.MOST_MODES:
        shown = ", ".join(list(counts)[: levels.SHOWN_WORDS])
        raise DataError(f"{what} holds {len(counts)} different values ({shown}, ...), so no modes; name another column")
    meant = {cell: _meaning(cell, declared) for cell in counts}
    state = cells.replace_strict(list(meant), [said is True for said in meant.values()], return_dtype=pl.Boolean)
    automatic = np.asarray(state.fill_null(strategy="forward").fill_null(True).to_numpy(), dtype=bool)
    return Modes(automatic, Finding(Kind.MODE, column, _sentence(column, counts, meant, declared), samples=rows.size))


def _meaning(cell: str, declared: Sequence[object] | None) -> bool | None:
    """Automatic or not; None if nobody knows."""
    return is_automatic(cell) if declared is None else any(same_mode(cell, one) for one in declared)


def is_automatic(cell: str) -> bool | None:
    """Whether a value of a mode column means automatic in the usual control systems; None if nobody knows."""
    bare = _bare(cell)
    return True if bare in AUTOMATIC else False if bare in MANUAL else None


def _bare(cell: str) -> str:
    """Letters and digits in lower case; of a number what is left without decimals that are zero."""
    if (number := _number(cell)) is not None:
        return f"{number:.15g}"
    return re.sub(r"[^a-z0-9]", "", cell.casefold())


def same_mode(cell: str, one: object) -> bool:
    """Is a value of a mode column the one that a project names?"""
    number = _number(cell)
    if number is not None and not isinstance(one, bool) and _number(str(one)) is not None:
        return number == _number(str(one))
    return cell.casefold() == str(one).strip().casefold()


def _number(cell: str) -> float | None:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None


def _sentence(
    column: str, counts: Mapping[str, int], meant: Mapping[str, bool | None], declared: Sequence[object] | None
) -> str:
    def listed(wanted: bool | None) -> str:
        return ", ".join(f"{_shown(cell)} ({counts[cell]})" for cell, said in meant.items() if said is wanted)

    parts = [f"automatic {listed(True)}" if True in meant.values() else "nothing is automatic"]
    if False in meant.values():
        parts.append(f"not automatic {listed(False)}")
    text = f"{column}: {'; '.join(parts)}."
    if None in meant.values():
        cells = [cell for cell, said in meant.items() if said is None]
        known = [cell for cell, said in meant.items() if said]
        unknown = sum(counts[cell] for cell in cells)
        text += f" What {listed(None)} means is not known: {counted(unknown, 'row')} counted as not automatic. "
        if len(cells) == 1:
            text += f"If it is, say automatic_values = [{', '.join(map(toml_of, [*known, *cells]))}]."
        else:
            beside = f", beside {', '.join(map(toml_of, known))}" if known else ""
            text += f"Name those of them that are automatic in automatic_values{beside}."
    elif True not in meant.values():
        text += (
            " If one of these is, name it in automatic_values."
            if declared is None
            else (" automatic_values names none of them: correct it.")
        )
    return text


def _shown(cell: str) -> str:
    number = _number(cell)
    return cell if number is None else f"{number:.15g}"


def toml_of(cell: str) -> str:
    """A value of a mode column as a project file names it."""
    return _shown(cell) if _number(cell) is not None else f'"{cell}"'
