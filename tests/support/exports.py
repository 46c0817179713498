"""Exports as historians, control systems and people write them, made from one simulated record of three loops.

The plant, in minutes: a flow that moves a temperature, that temperature, and a level that integrates, under PI every
30 s. A feed is recorded that moves nothing. Modes say CAS and MAN for a while, and statuses that a few samples are bad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl

from support.simulated import coloured, random_switching
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix

N, H = 1800, 0.5
START = datetime(2024, 3, 4, 6)
LOOPS = ("FIC101", "TIC205", "LIC12")
UNITS = {"FIC101": "m3/h", "TIC205": "degC", "LIC12": "%"}
KINDS = {"FIC101": "flow", "TIC205": "temperature", "LIC12": "level"}
PLANT = TransferMatrix.of(
    [
        ["1.4 exp(-0.7 s)/(3 s + 1)", "0", "0"],
        ["-0.5 exp(-2.4 s)/(12 s + 1)", "1.1 exp(-3.3 s)/(14 s + 1)", "0"],
        ["0", "0", "0.06 exp(-2.2 s)/s"],
    ],
    "min",
)
FOUND = {
    ("FIC101", "FIC101"): "fopdt",
    ("TIC205", "FIC101"): "fopdt",
    ("TIC205", "TIC205"): "fopdt",
    ("LIC12", "LIC12"): "integrator",
}
"""(output, input): structure, of what the plant has."""
LAW = Controller.diagonal(
    [
        PID(Kc=0.9, Ti=3.0, sample_time=H),
        PID(Kc=1.6, Ti=14.0, sample_time=H),
        PID(Kc=2.0, Ti=30.0, sample_time=H),
    ]
)
OPERATING = {"SP": (40.0, 120.0, 55.0), "OP": (35.0, 48.0, 52.0)}


@dataclass(frozen=True, eq=False)
class Signals:
    """The record: by loop and signal, with modes and statuses as words."""

    values: dict[tuple[str, str], np.ndarray]
    feed: np.ndarray
    modes: dict[str, list[str]]
    status: dict[str, list[str]]
    """Of each PV."""
    moments: list[datetime]


def signals(seed: int = 0) -> Signals:
    rng = np.random.default_rng([12, seed])
    r = (random_switching(rng, N, 3, 70.0) - 1) * np.array([3.0, 4.0, 5.0])
    v = coloured(rng, N, 3, [1, -0.8], [1], 0.1)
    feed = np.cumsum(rng.standard_normal(N)) * 0.02
    done = simulate(PLANT, LAW, r, H, v=v)
    values = {}
    for k, loop in enumerate(LOOPS):
        values[loop, "SP"] = np.round(done.r[:, k] + OPERATING["SP"][k], 2)
        values[loop, "PV"] = np.round(done.y[:, k] + OPERATING["SP"][k], 3)
        values[loop, "OP"] = np.round(done.u[:, k] + OPERATING["OP"][k], 3)
    modes = {loop: ["AUTO"] * N for loop in LOOPS}
    modes["FIC101"][400:700] = ["CAS"] * 300
    modes["LIC12"][1500:1560] = ["MAN"] * 60
    status = {loop: ["Good"] * N for loop in LOOPS}
    for k in (200, 201, 900, 1300):
        status["TIC205"][k] = "Bad"
    return Signals(
        values, np.round(80 + feed, 3), modes, status, [START + timedelta(seconds=60 * H * k) for k in range(N)]
    )


@dataclass(frozen=True)
class Export:
    """One shape: what writes it, and what `init` is to find in it."""

    file: str
    write: Callable[[Path, Signals], None]
    column: Callable[[str, str], str]
    """The column or tag of a signal (PV, SP, OP, MODE, STATUS) of a loop."""
    loops: tuple[str, ...] = LOOPS
    units: bool = False
    kinds: bool = True
    modes: bool = False
    status: bool = False
    feed: str = ""
    """Column that is offered as a disturbance."""
    time_unit: str = "min"
    bad: bool = False
    """Are bad samples marked in another way than by a status column?"""


def wide(
    all_signals: Signals,
    column: Callable[[str, str], str],
    time: str,
    stamps: list[str],
    *,
    loops: tuple[str, ...] = LOOPS,
    feed: str = "",
    modes: bool = False,
    status: bool = False,
) -> dict[str, list[str]]:
    """Cells as text, by column, in the order of an export."""
    cells: dict[str, list[str]] = {time: stamps}
    for loop in loops:
        for signal in ("PV", "SP", "OP"):
            cells[column(loop, signal)] = [repr(float(x)) for x in all_signals.values[loop, signal]]
            if status and signal == "PV":
                cells[column(loop, "STATUS")] = all_signals.status[loop]
        if modes:
            cells[column(loop, "MODE")] = all_signals.modes[loop]
    if feed:
        cells[feed] = [repr(float(x)) for x in all_signals.feed]
    return cells


def lines(cells: dict[str, list[str]], separator: str) -> str:
    rows = zip(*cells.values(), strict=True)
    return "\n".join([separator.join(cells), *(separator.join(row) for row in rows)]) + "\n"


def iso(all_signals: Signals) -> list[str]:
    return [moment.isoformat(" ") for moment in all_signals.moments]


def dotted(loop: str, signal: str) -> str:
    return f"{loop}.{signal}"


def plain(path: Path, all_signals: Signals) -> None:
    path.write_text(lines(wide(all_signals, dotted, "Timestamp", iso(all_signals), feed="FI300.PV", modes=True), ","))


def german_name(loop: str, signal: str) -> str:
    words = {"PV": "Istwert", "SP": "Sollwert", "OP": "Stellgröße", "MODE": "Betriebsart", "STATUS": "Istwert Status"}
    return f"{loop} {words[signal]}"


def german(path: Path, all_signals: Signals) -> None:
    stamps = [f"{moment:%d.%m.%Y %H:%M:%S}" for moment in all_signals.moments]
    cells = wide(all_signals, german_name, "Zeitstempel", stamps, feed="Zulauf Menge", modes=True, status=True)
    words = {"AUTO": "Automatik", "CAS": "Kaskade", "MAN": "Hand", "Good": "gut", "Bad": "schlecht"}
    cells = {name: [words.get(cell, cell) for cell in own] for name, own in cells.items()}
    cells = {
        name: [cell.replace(".", ",") if name != "Zeitstempel" else cell for cell in own] for name, own in cells.items()
    }
    path.write_bytes(lines(cells, ";").encode("cp1252"))


def underscored(loop: str, signal: str) -> str:
    return f"{loop}_{ {'SP': 'SPT', 'OP': 'OUT', 'STATUS': 'PV_Q'}.get(signal, signal) }"


def american(path: Path, all_signals: Signals) -> None:
    """OPC codes for statuses."""
    stamps = [f"{moment:%m/%d/%Y %I:%M:%S %p}" for moment in all_signals.moments]
    cells = wide(all_signals, underscored, "Date/Time", stamps, status=True)
    codes = {"Good": "192", "Bad": "0"}
    path.write_text(lines({name: [codes.get(cell, cell) for cell in own] for name, own in cells.items()}, ","))


def excel(path: Path, all_signals: Signals) -> None:
    """A banner, names, a row of units, then values."""
    cells = wide(all_signals, dotted, "Time", iso(all_signals))
    unit = {
        dotted(loop, signal): UNITS[loop] if signal != "OP" else "%" for loop in LOOPS for signal in ("PV", "SP", "OP")
    }
    rows = [["Plant 7, unit 3, exported by shift A"], list(cells), [unit.get(name, "") for name in cells]]
    rows += [list(row) for row in zip(*cells.values(), strict=True)]
    width = len(cells)
    frame = pl.DataFrame(
        [[row[k] if k < len(row) else "" for row in rows] for k in range(width)], schema=[f"c{k}" for k in range(width)]
    )
    frame.write_excel(path, include_header=False)


def pi_name(loop: str, signal: str) -> str:
    return rf"\\pi01\{loop}.{signal}"


def datalink(path: Path, all_signals: Signals) -> None:
    """The time has no name, and what is bad is a message."""
    stamps = [f"{moment:%d-%b-%y %H:%M:%S}" for moment in all_signals.moments]
    cells = wide(all_signals, pi_name, "", stamps)
    for loop in LOOPS:
        name, states = pi_name(loop, "PV"), all_signals.status[loop]
        cells[name] = [
            cell if state == "Good" else "Bad Input" for cell, state in zip(cells[name], states, strict=True)
        ]
    path.write_text(lines(cells, "\t"), encoding="utf-16")


def long(path: Path, all_signals: Signals) -> None:
    """A row a tag, time and value; a bad one has a word for its value."""
    rows = ["Tag,Time,Value,Status"]
    for loop in LOOPS:
        for signal in ("PV", "SP", "OP", "MODE"):
            own = all_signals.modes[loop] if signal == "MODE" else all_signals.values[loop, signal]
            state = all_signals.status[loop] if signal == "PV" else ["Good"] * N
            stamps = iso(all_signals)
            rows += [
                f"{loop}.{signal},{stamp},{'I/O Timeout' if bad != 'Good' else value},{bad}"
                for stamp, value, bad in zip(stamps, own, state, strict=True)
            ]
    path.write_text("\n".join(rows) + "\n")


def experion_name(loop: str, signal: str) -> str:
    return f"{loop}.DACA.PV" if signal == "PV" else f"{loop}.PIDA.{signal}"


def experion(path: Path, all_signals: Signals) -> None:
    stamps = [f"{moment:%d/%m/%Y %H:%M:%S}" for moment in all_signals.moments]
    path.write_text(lines(wide(all_signals, experion_name, "Date", stamps, modes=True), ","))


def deltav_name(loop: str, signal: str) -> str:
    ends = {"PV": "PV.CV", "SP": "SP.CV", "OP": "OUT.CV", "MODE": "MODE.ACTUAL", "STATUS": "PV.ST"}
    return f"AREA_A/{loop}/PID1/{ends[signal]}"


def deltav(path: Path, all_signals: Signals) -> None:
    cells = wide(all_signals, deltav_name, "Time", iso(all_signals), modes=True, status=True)
    bad = {name for name in cells if name.endswith("PV.ST")}
    cells = {
        name: ["GoodNonCascade" if c == "Good" else c for c in own] if name in bad else own
        for name, own in cells.items()
    }
    path.write_text(lines(cells, ","))


def worded(loop: str, signal: str) -> str:
    return {"PV": "temperature", "SP": "temperature setpoint", "OP": "output"}[signal]


def counted(path: Path, all_signals: Signals) -> None:
    """One loop in words, seconds that count."""
    stamps = [f"{60 * H * k:g}" for k in range(N)]
    path.write_text(lines(wide(all_signals, worded, "time [s]", stamps, loops=("TIC205",), feed="feed rate"), ","))


def spaced(loop: str, signal: str) -> str:
    return f"{loop} {signal}"


def parquet(path: Path, all_signals: Signals) -> None:
    cells = {spaced(*key): values for key, values in all_signals.values.items()}
    pl.DataFrame({"ts": all_signals.moments} | cells).write_parquet(path)


EXPORTS = {
    "plain": Export("plain.csv", plain, dotted, modes=True, feed="FI300.PV"),
    "german": Export("werk.csv", german, german_name, modes=True, status=True, feed="Zulauf Menge"),
    "american": Export("us.csv", american, underscored, status=True),
    "excel": Export("book.xlsx", excel, dotted, units=True),
    "PI DataLink": Export("datalink.txt", datalink, pi_name, bad=True),
    "long": Export("long.csv", long, dotted, modes=True, bad=True),
    "Experion": Export("experion.csv", experion, experion_name, modes=True),
    "DeltaV": Export("deltav.csv", deltav, deltav_name, modes=True, status=True),
    "counted": Export("counted.csv", counted, worded, loops=("TIC205",), feed="feed rate"),
    "parquet": Export("lake.parquet", parquet, spaced),
}
