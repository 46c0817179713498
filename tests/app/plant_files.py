"""Data files as plants export them: German CSV, UTF-16 of a PI system, XLSX, Parquet."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import xlsxwriter

from trueplant.arrays import Array

STEP = 30
"""Seconds between samples."""
START = datetime(2024, 3, 4, 20)


def loop(n: int = 1500, seed: int = 5) -> tuple[Array, Array, Array]:
    """SP, PV and OP (n,) of a flow under a PI controller whose set-point is moved every hundred samples."""
    rng = np.random.default_rng(seed)
    sp = np.repeat(60 + rng.choice([0.0, 3.0, -3.0, 5.0], n // 100 + 1), 100)[:n]
    pv, op = np.empty(n), np.empty(n)
    flow, load, integral = 60.0, 0.0, 50.0
    for k in range(n):
        load = 0.9 * load + 0.1 * rng.normal()
        pv[k] = flow + load + 0.05 * rng.normal()
        integral += 0.05 * (sp[k] - pv[k])
        op[k] = np.clip(integral + 0.8 * (sp[k] - pv[k]), 0, 100)
        flow += (60 - flow + 1.2 * (op[k] - 50)) / 12
    return sp, pv, op


def moments(n: int) -> list[datetime]:
    return [START + timedelta(seconds=STEP * k) for k in range(n)]


def german_csv(place: Path, n: int = 1500) -> Path:
    """Two lines above the header, a row of units, decimal commas, cp1252; a spike, a hole, a frozen stretch, modes."""
    sp, pv, op = loop(n)
    pv[200:220] = np.nan
    pv[500:502] = 95.0
    pv[900:1100] = pv[900]
    lines = [
        "Werk Süd;Export;;;;",
        "Zeitstempel;FIC101.PV;FIC101.SP;FIC101.OP;FIC101.MODE;FI300.PV",
        ";m³/h;m³/h;%;;t/h",
    ]
    for k, moment in enumerate(moments(n)):
        numbers = ["" if np.isnan(x) else f"{x:.3f}".replace(".", ",") for x in (pv[k], sp[k], op[k])]
        mode = "MAN" if 600 <= k < 650 else "BCASX" if 700 <= k < 720 else "AUTO"
        lines.append(";".join([f"{moment:%d.%m.%Y %H:%M:%S}", *numbers, mode, f"{5 + k % 7},5"]))
    place.write_bytes("\r\n".join(lines).encode("cp1252"))
    return place


def pi_export(place: Path, n: int = 400) -> Path:
    """A long export in UTF-16 with a byte order mark and tabs: tag, time, value, quality."""
    sp, pv, op = loop(n)
    lines = ["Tag\tTimestamp\tValue\tStatus"]
    for k, moment in enumerate(moments(n)):
        for tag, x in (("FIC101.PV", pv[k]), ("FIC101.SP", sp[k]), ("FIC101.OP", op[k])):
            lines.append(f"{tag}\t{moment:%Y-%m-%dT%H:%M:%SZ}\t{x:.4f}\tGood")
    place.write_bytes("\r\n".join(lines).encode("utf-16"))
    return place


def workbook(place: Path, n: int = 400) -> Path:
    """XLSX with real dates, on the second of two sheets."""
    sp, pv, op = loop(n)
    with xlsxwriter.Workbook(place) as book:
        book.add_worksheet("Notes").write(0, 0, "made by the historian")
        sheet = book.add_worksheet("Data")
        sheet.write_row(0, 0, ["Time", "TIC7.PV", "TIC7.SP", "TIC7.OP"])
        date = book.add_format({"num_format": "yyyy-mm-dd hh:mm:ss"})
        for k, moment in enumerate(moments(n), 1):
            sheet.write_datetime(k, 0, moment, date)
            sheet.write_row(k, 1, [pv[k - 1], sp[k - 1], op[k - 1]])
    return place


def parquet(place: Path, n: int = 1500) -> Path:
    """Two loops with stamps in UTC."""
    columns = {"time": [moment.replace(tzinfo=UTC) for moment in moments(n)]}
    frame = pl.DataFrame(columns)
    for number, seed in ((101, 5), (102, 6)):
        names = (f"FIC{number}.SP", f"FIC{number}.PV", f"FIC{number}.OP")
        frame = frame.with_columns(pl.Series(name, x) for name, x in zip(names, loop(n, seed), strict=True))
    frame.write_parquet(place)
    return place
