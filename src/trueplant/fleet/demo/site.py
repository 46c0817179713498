"""The demo site on disk: a lake of events, a template and a table for each kind of loop, the site file, the truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.fleet import levels
from trueplant.fleet.demo.simulate import Loop, kept, simulate
from trueplant.fleet.demo.templates import template_of
from trueplant.fleet.demo.truth import KINDS, Fault, Kind, Truth, loops
from trueplant.fleet.store import write_whole

if TYPE_CHECKING:
    import polars as pl

SITE, TRUTH = "site.toml", "truth.csv"
END = datetime(2026, 10, 1, tzinfo=UTC)
START = END - timedelta(days=30)


def write_site(
    folder: Path, per_kind: int = 10, start: datetime = START, say: Callable[[str], None] = lambda what: None
) -> list[Truth]:
    """Simulate the loops from `start` to the end of September 2026 and write all files; the same ones every time."""
    found = loops(per_kind)
    for one in found:
        say(f"simulating {one.name}")
        buffer = io.BytesIO()
        events_of(one, start).write_parquet(buffer, compression="zstd")
        write_whole(folder / "lake" / f"kind={one.kind.name}" / f"{one.name}.parquet", buffer.getvalue())
    for kind in KINDS:
        names = [[one.name] for one in found if one.kind is kind]
        write_whole(folder / f"{kind.name}.csv", _csv(["name"], names))
        write_whole(folder / f"{kind.name}.toml", template_of(kind).encode())
    rows = [[one.name, one.kind.name, one.fault] for one in found]
    write_whole(folder / TRUTH, _csv(["loop", "kind", "fault"], rows))
    write_whole(folder / SITE, _site(start).encode())
    return found


def _csv(header: Sequence[str], rows: Sequence[Sequence[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue().encode()


def _site(start: datetime) -> str:
    parts = ['name = "Demo site"  # simulated; truth.csv says what is wrong with which loop\n']
    parts += [f'[[loops]]\ntemplate = "{kind.name}.toml"\ntable = "{kind.name}.csv"\n' for kind in KINDS]
    parts.append(f'[audit]\nfrom = {start.isoformat()}\nto = {END.isoformat()}\nworkers = 2\ndeadline = "10 min"\n')
    return "\n".join(parts)


def events_of(one: Truth, start: datetime) -> pl.DataFrame:
    """The events of a loop as a historian has them: tag, time, value, quality."""
    import polars as pl

    kind, chance = one.kind, np.random.default_rng(one.seed)
    samples = round((END - start) / timedelta(minutes=kind.sample_time))
    n = len(kind.Kc)
    r = _set_points(one, samples, chance)
    automatic = np.full((samples, n), one.fault != Fault.MANUAL)
    y, u, v = simulate(_loop(one, samples), r, automatic, _disturbance(kind, samples, chance))
    times = np.datetime64(start.replace(tzinfo=None), "us") + (
        np.arange(samples) * round(60e6 * kind.sample_time)
    ).astype("timedelta64[us]")
    frames = []
    for tag, values in _signals(one, r, y, u, v, chance):
        band = levels.DEMO_BAND * kind.noise * kind.move[0] if one.fault == Fault.COMPRESSED and "PV" in tag else 0.0
        keep = kept(values, band)
        quality = np.full(samples, "good", dtype=object)
        if one.fault == Fault.BAD and "PV" in tag:
            quality[_outages(samples, chance)] = "bad"
        part = {"tag": [tag] * int(keep.sum()), "time": times[keep], "value": values[keep], "quality": quality[keep]}
        frames.append(pl.DataFrame(part, schema_overrides={"quality": pl.String}))
    events = pl.concat(frames).with_columns(pl.col("time").dt.replace_time_zone("UTC"))
    return events.sort("tag", "time")


def _signals(
    one: Truth, r: Array, y: Array, u: Array, v: Array, chance: np.random.Generator
) -> Iterator[tuple[str, Array]]:
    """Each tag with its values (N,), rounded as instruments do, around where the loop is run."""
    kind = one.kind
    for j in range(len(kind.Kc)):
        tag = one.name if len(kind.Kc) == 1 else f"{one.name}{'AB'[j]}"
        step = 10.0 ** np.floor(np.log10(kind.noise * kind.move[j] / 4))
        yield f"{tag}.SP", levels.DEMO_LEVEL + np.round(r[:, j], 6)
        yield f"{tag}.PV", levels.DEMO_LEVEL + np.round(y[:, j] / step) * step
        yield f"{tag}.OP", levels.DEMO_LEVEL + u[:, j]
        yield f"{tag}.MODE", np.full(len(r), 0.0 if one.fault == Fault.MANUAL else 1.0)
        if kind.slave:
            flow = v[:, j] + chance.normal(0, levels.DEMO_SLAVE_NOISE, len(v))
            yield f"{tag}.SLAVE.SP", levels.DEMO_LEVEL + u[:, j]
            yield f"{tag}.SLAVE.PV", levels.DEMO_LEVEL + np.round(flow, 3)


def _set_points(one: Truth, samples: int, chance: np.random.Generator) -> Array:
    """(N, n) moves of either direction, about one in a day, around where the loop is run."""
    kind = one.kind
    r = np.zeros((samples, len(kind.move)))
    if one.fault == Fault.STILL:
        return r
    days = samples * kind.sample_time / 1440
    for j, size in enumerate(kind.move):
        number = max(levels.DEMO_MOVES, round(days))
        at = np.sort(chance.choice(np.arange(samples // 50, samples), number, replace=False))
        to = size * chance.uniform(0.5, 1.5, number) * np.where(np.arange(number) % 2 == 0, 1.0, -1.0) / 2
        r[:, j] = np.concatenate([[0.0], to])[np.searchsorted(at, np.arange(samples), side="right")]
    return r


def _disturbance(kind: Kind, samples: int, chance: np.random.Generator) -> Array:
    """(N, n) of PV: a slow wander (first-order autoregressive, some lags long) and the noise of the instrument."""
    from scipy.signal import lfilter

    size = np.array(kind.move)
    length = levels.DEMO_WANDER * max(max(map(max, kind.lag)), kind.dead_time[0][0])
    pole = np.exp(-kind.sample_time / length)
    white = chance.normal(size=(samples, size.size))
    wander = lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], white, axis=0)
    found: Array = size * (kind.wander * wander + kind.noise * chance.normal(size=(samples, size.size)))
    return found


def _loop(one: Truth, samples: int) -> Loop:
    """The loop as it really is."""
    kind = one.kind
    gain = np.repeat(np.array(kind.gain)[None], samples, axis=0)
    lag, Kc, Ti = np.array(kind.lag), np.array(kind.Kc), np.array(kind.Ti)
    if one.fault == Fault.STEP and kind.slave and one.name.endswith("8"):
        lag = lag * levels.DEMO_LAG
    elif one.fault == Fault.STEP:
        gain[:, :, 0] *= levels.DEMO_STEP
    elif one.fault == Fault.DRIFT:
        gain[:, :, 0] *= np.linspace(1.0, levels.DEMO_DRIFT, samples)[:, None]
    elif one.fault == Fault.RETUNED:
        Kc, Ti = Kc * levels.DEMO_RETUNED, Ti / levels.DEMO_RETUNED
    stick = np.zeros(Kc.size)
    if one.fault == Fault.STICKING:
        stick[0] = levels.DEMO_STICK * _travel(kind)
    return Loop(kind.sample_time, gain, lag, np.array(kind.dead_time), Kc, Ti, stick, kind.slave)


def _travel(kind: Kind) -> float:
    """How far OP goes for a usual move; a level's valve comes back, and goes as far as its controller kicks it."""
    return kind.move[0] / abs(kind.gain[0][0]) if kind.lag[0][0] else abs(kind.Kc[0]) * kind.move[0]


def _outages(samples: int, chance: np.random.Generator) -> NDArray[np.intp]:
    """Samples of bad quality: some stretches, each about an hour or two long."""
    starts = chance.choice(samples, max(samples // 2000, 1), replace=False)
    return np.unique(np.concatenate([np.arange(at, min(at + 120, samples)) for at in starts]))
