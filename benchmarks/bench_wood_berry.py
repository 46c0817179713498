"""Wood-Berry under BLT PI: errors against the Cramer-Rao bound of each record, and coverage of the intervals.

Simulated: h = 1 min, dead times off the grid, both set-points switching at random at once, coloured
disturbance whose order the fit has to find. Prints the ratio of rms error to bound and the coverage.

    python benchmarks/bench_wood_berry.py [--runs 1000] [--samples 4000] [--colour ar1|arma] [--plant wood-berry|shell]
                                          [--correlation 0.8]

`--plant shell` is the 3x3 corner y1, y2, y7 of Shell's problem under decentralised PI, sampled every 3.7 min. With a
correlation of the disturbances over the outputs (ar1 alone) all outputs are estimated as the product does it, and the
bound is the joint one, for which the disturbances of the other outputs are known in part.
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

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.joint_bound import joint_bound
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant import plants
from trueplant.identify import Row, Spec, fit_row, identify_matrix, identify_output, pieces_of
from trueplant.loop import Controller, simulate
from trueplant.lti.structure import Structure, structure_of

FOPDT = Structure.parse("fopdt")
SHELL = plants.shell_3x3()
SHELL_H = 3.7
COLOURS = {"ar1": ([1, -0.8], [1]), "arma": ([1, -1.5, 0.6], [1, -0.4])}
STD = 0.3


def plant_of(name: str):
    """Plant, controller sampled at h, and h."""
    if name == "wood-berry":
        return WOOD_BERRY, BLT, 1.0
    entries = {place: replace(entry, sample_time=SHELL_H) for place, entry in SHELL.controller.entries.items()}
    return SHELL.model, Controller(entries, 3, 3), SHELL_H


def run(job: tuple[int, int, str, str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors, bound variances and hits of the 95 % intervals of one record, one a parameter."""
    seed, samples, colour, name, correlation = job
    a, c = COLOURS[colour]
    plant, controller, h = plant_of(name)
    n = plant.shape[0]
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, n, 20.0)
    mixed = np.linalg.cholesky(np.full((n, n), correlation) + (1 - correlation) * np.eye(n))
    simulation = simulate(plant, controller, r, h, v=coloured(rng, samples, n, a, c, STD) @ mixed.T)
    segment = segment_of(simulation)
    truth = [np.concatenate([structure_of(plant[i, j])[1] for j in range(n)]) for i in range(n)]
    specs = [
        [Spec(j, FOPDT, tuple((row * np.tile([1.3, 0.7, 1.5], n))[3 * j : 3 * j + 3])) for j in range(n)]
        for row in truth
    ]
    if correlation:
        places = {(i, spec.column): spec for i, row in enumerate(specs) for spec in row}
        estimates = list(identify_matrix([segment], plant, places).values())
        bounds = joint_bound(segment, truth, a[1], STD**2 * (1 - a[1] ** 2) * (mixed @ mixed.T))
    else:
        estimates = [identify_output([segment], i, row) for i, row in enumerate(specs)]
        bounds = np.concatenate([bound(segment, i, row, a, c) for i, row in enumerate(truth)])
    true = np.concatenate(truth)
    theta = np.concatenate([estimate.theta for estimate in estimates])
    intervals = np.concatenate([estimate.intervals for estimate in estimates])
    return theta - true, bounds, (intervals[:, 0] <= true) & (true <= intervals[:, 1])


def bound(segment, i: int, truth: np.ndarray, a: list[float], c: list[float]) -> np.ndarray:
    """Cramer-Rao variances for this record, the coefficients of the noise unknown but its order known."""
    row = Row(tuple(Spec(j, FOPDT) for j in range(truth.size // 3)), pieces_of([segment], i))
    power = np.sum(impulse(a, c) ** 2)
    innovation = STD**2 / power
    inverse = impulse(c, a)[:60]
    order = inverse.size - 1 if len(c) > 1 else len(a) - 1
    fit = fit_row(row, truth, inverse[1 : order + 1], iterations=0)
    if len(c) == 1:
        return np.diag(fit.covariance) / fit.variance * innovation
    return arma_bound(row, truth, a, c, innovation)


def arma_bound(row: Row, truth: np.ndarray, a: list[float], c: list[float], innovation: float) -> np.ndarray:
    """The same with an ARMA noise: gradients of the prediction error by plant, a and c."""
    from scipy.signal import lfilter

    y, _ = row.measured(0)
    response, gradient = row.response_and_gradient(truth, 0)
    nuisance = row.nuisance(truth, 0)
    v = y - response - nuisance @ np.linalg.lstsq(nuisance, y - response, rcond=None)[0]
    e = lfilter(a, c, v)
    columns = [*lfilter(a, c, gradient, axis=0).T]
    columns += [np.concatenate([np.zeros(k), lfilter([1], c, v)[:-k]]) for k in range(1, len(a))]
    columns += [np.concatenate([np.zeros(k), lfilter([1], c, e)[:-k]]) for k in range(1, len(c))]
    psi = np.column_stack([*columns, *lfilter(a, c, nuisance, axis=0).T])[20:]
    scale = np.linalg.norm(psi, axis=0)
    information = (psi / scale).T @ (psi / scale)
    return (innovation * np.diag(np.linalg.pinv(information)) / scale**2)[: truth.size]


def impulse(num: list[float], den: list[float]) -> np.ndarray:
    """First 2,000 terms of den(q)/num(q): from e to v for (a, c)."""
    from scipy.signal import lfilter

    return lfilter(den, num, np.eye(1, 2000)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=4000)
    parser.add_argument("--colour", choices=sorted(COLOURS), default="ar1")
    parser.add_argument("--plant", choices=["wood-berry", "shell"], default="wood-berry")
    parser.add_argument("--correlation", type=float, default=0.0)
    options = parser.parse_args()
    if options.correlation and options.colour != "ar1":
        parser.error("--correlation needs --colour ar1")
    begun = time.perf_counter()
    jobs = [
        (10_000 + k, options.samples, options.colour, options.plant, options.correlation) for k in range(options.runs)
    ]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        errors, bounds, hits = (np.array(x) for x in zip(*pool.map(run, jobs, chunksize=10), strict=True))
    seconds = time.perf_counter() - begun
    said = f"{options.plant}, disturbance {options.colour}, correlated {options.correlation:g}, seeds 10000 on"
    print(f"{options.runs} simulated runs of {options.samples} samples: {said}")
    n = plant_of(options.plant)[0].shape[0]
    names = [f"{p}{i + 1}{j + 1}" for i in range(n) for j in range(n) for p in ("K", "tau", "theta")]
    print(f"{'':8}{'rms/bound':>10}{'coverage':>10}{'bias/s.e.':>10}")
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.mean(bounds, axis=0))
    bias = np.mean(errors, axis=0) / np.std(errors, axis=0) * np.sqrt(len(errors))
    for k, name in enumerate(names):
        print(f"{name:8}{ratio[k]:10.3f}{np.mean(hits[:, k]):10.3f}{bias[k]:10.2f}")
    print(f"largest ratio {ratio.max():.3f}, coverage {hits.mean(axis=0).min():.3f} to {hits.mean(axis=0).max():.3f}")
    print(f"{seconds:.0f} s, {seconds / options.runs * 1000:.0f} ms a run on two cores")


if __name__ == "__main__":
    main()
