"""Historians that compress: from which deviation on is the estimate spoilt, and from which on is it said?

Simulated: Wood-Berry under BLT PI, 4,000 samples of 1 min, both set-points switching at random, AR(1) disturbance.
PV, OP or both then pass through a swinging door whose deviation is a multiple of what the disturbance alone moves the
signal by (standard deviation), and come back as straight lines between the stored samples. Set-points stay whole.
Printed for each deviation: samples stored; the largest bias over gains, time constants and dead times in standard
deviations that the Cramer-Rao bound of the whole record gives; the largest rms error over that bound; coverage of the
95 % intervals; in how many records screening called every signal concerned compressed (and, for "nothing", none); and
in how many it refused the record or left the PVs out. Refused ones are estimated all the same, to show what is refused.

    python benchmarks/bench_compression.py [--runs 30] [--only PV] [--digits 4] [--workers 1]
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from bench_wood_berry import COLOURS, FOPDT, STD, bound

from support.historian import swinging_door
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.identify import identify_matrix, specs_of
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import structure_of
from trueplant.record import Channel, Layout, read_record, screen

SEED = 60_000
DEVIATIONS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
CASES = (("nothing", 0.0), *((which, d) for which in ("PV", "OP", "both") for d in DEVIATIONS))
LAYOUT = Layout(
    (Channel("top", "pv1", sp="sp1"), Channel("bottom", "pv2", sp="sp2")),
    (Channel("reflux", "op1"), Channel("steam", "op2")),
    time_unit="min",
    project_time_unit="min",
)
TRUTH = [[structure_of(WOOD_BERRY[i, j])[1] for j in range(2)] for i in range(2)]
WRONG = ([1.3, 0.7, 1.5], [1.3, 0.7, 1.5])
MODEL = TransferMatrix(tuple(tuple(FOPDT.transfer(TRUTH[i][j] * WRONG[j]) for j in range(2)) for i in range(2)), "min")


def record(seed: int, which: str, deviation: float, digits: int, samples: int = 4000):
    """The whole segment, the columns as the historian gives them back, and the share of samples it stored."""
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 2, 20.0)
    v = coloured(rng, samples, 2, *COLOURS["ar1"], STD)
    whole = simulate(WOOD_BERRY, BLT, r, 1.0, v=v)
    at_rest = simulate(WOOD_BERRY, BLT, 0 * r, 1.0, v=v)
    y, u = whole.y.copy(), whole.u.copy()
    for k in range(2):
        if which in ("PV", "both"):
            y[:, k] = swinging_door(y[:, k], deviation * STD)
        if which in ("OP", "both"):
            u[:, k] = swinging_door(u[:, k], deviation * np.std(at_rest.u[:, k]))
    stored = np.mean(
        [np.mean(got == true) for got, true in ((y, whole.y), (u, whole.u)) if not np.array_equal(got, true)] or [1.0]
    )
    if digits:
        y, u = np.round(y, digits), np.round(u, digits)
    columns = {
        "t": whole.t,
        "sp1": r[:, 0],
        "sp2": r[:, 1],
        "op1": u[:, 0],
        "op2": u[:, 1],
        "pv1": y[:, 0],
        "pv2": y[:, 1],
    }
    return segment_of(whole), columns, stored


def run(job: tuple[int, str, float, int]):
    """Errors, bounds, hits, share stored, and the kinds of signal that screening called compressed."""
    seed, which, deviation, digits = job
    whole, columns, stored = record(seed, which, deviation, digits)
    screened = screen(read_record(columns, LAYOUT), LAYOUT)
    names = {f.signal for f in screened.findings if f.kind == "compressed"}
    wanted = {"nothing": set(), "PV": {"top", "bottom"}, "OP": {"reflux", "steam"}}
    wanted["both"] = wanted["PV"] | wanted["OP"]
    errors, hits = np.full((2, 12), np.nan)
    as_recorded = replace(
        whole,
        u=np.column_stack([columns["op1"], columns["op2"]]),
        y=np.column_stack([columns["pv1"], columns["pv2"]]),
    )
    estimates = identify_matrix([as_recorded], MODEL, specs_of(MODEL), update_interval=1.0)
    bounds = []
    for i in range(2):
        truth = np.concatenate(TRUTH[i])
        bounds.append(bound(whole, i, truth, *COLOURS["ar1"]))
        place = slice(6 * i, 6 * i + 6)
        if i in estimates:
            low, high = estimates[i].intervals[:6].T
            errors[place] = estimates[i].theta[:6] - truth
            hits[place] = (low <= truth) & (truth <= high)
    said = names == wanted[which] if which == "nothing" else wanted[which] <= names
    return errors, np.concatenate(bounds), hits, stored, said, bool(screened.refusal)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--only", choices=["nothing", "PV", "OP", "both"])
    parser.add_argument("--digits", type=int, default=0, help="decimals of the export; 0 keeps all")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    begun = time.perf_counter()
    print(f"{options.runs} simulated records each, seeds {SEED} on")
    print(f"{'':12}{'stored':>8}{'bias/std':>26}{'rms/bound':>26}{'coverage':>26}{'said':>8}{'refused':>9}")
    print(f"{'':20}" + 3 * f"{'gain':>10}{'lag':>8}{'delay':>8}")
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for which, deviation in (case for case in CASES if options.only in (None, case[0])):
            jobs = [(SEED + k, which, deviation, options.digits) for k in range(options.runs)]
            errors, bounds, hits, stored, said, refused = (np.array(x) for x in zip(*pool.map(run, jobs), strict=True))
            sigma = np.sqrt(np.mean(bounds, axis=0))
            bias = np.abs(np.nanmean(errors, axis=0)) / sigma
            rms = np.sqrt(np.nanmean(errors**2, axis=0)) / sigma
            cover = np.nanmean(hits, axis=0)
            cells = "".join(
                f"{x[k::3].max():10.2f}" if k == 0 else f"{x[k::3].max():8.2f}" for x in (bias, rms) for k in range(3)
            )
            cells += "".join(
                f"{cover[k::3].mean():10.3f}" if k == 0 else f"{cover[k::3].mean():8.3f}" for k in range(3)
            )
            print(
                f"{which:8}{deviation:4g}{np.mean(stored):8.3f}{cells}{np.mean(said):8.2f}{np.mean(refused):9.2f}",
                flush=True,
            )
    print(f"{time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
