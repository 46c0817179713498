"""The fit of one row of the plant beside scipy and beside sippy_unipi, on the same data in the same run.

Speed: the public TCLab record and a simulated Wood-Berry record, from the same random starts and with the same
autoregressive noise model, against `scipy.optimize.least_squares` with finite differences, once on a model in plain
scipy.signal and once on this project's own sampled response, so that only the optimiser differs.
Accuracy: simulated Wood-Berry records, whose truth is known, against the model classes of sippy_unipi, which are told
the true orders and dead times; and a second TCLab run that took no part in any estimate.

    python benchmarks/bench_fit.py [--starts 5] [--seeds 5] [--samples 1500]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one thread for everyone: on a busy machine more of them measure the others

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import WOOD_BERRY, segment_of, wood_berry
from trueplant import Project
from trueplant.errors import SourceError
from trueplant.identify import Row, Spec, choose_stride, estimate_row, fit_percent, fit_row, pieces_of
from trueplant.identify.noise import whitened_valid
from trueplant.lti import sampled_response
from trueplant.lti.structure import Structure, structure_of
from trueplant.record import Segment
from trueplant.study.data.prepare import prepare

Array = NDArray[np.float64]
Response = Callable[[Array], Array]
Model = tuple[str, dict[str, object]]
EXAMPLES = Path(__file__).parent.parent / "examples"
FOPDT = Structure.parse("fopdt")
EARLIER = 500
"""Samples that a record cut out of operation leaves behind."""
HORIZON = 100
"""Step responses are compared over this many min: 5 to 9 lags of Wood and Berry's elements."""


# The same least squares for scipy -----------------------------------------------------------------------------------


def plain_response(row: Row) -> Response:
    """Sum of first-order lags by cont2discrete and lfilter, each shifted by its dead time between samples."""
    (piece,) = row.pieces
    t = piece.h * np.arange(piece.y.size)

    def response(theta: Array) -> Array:
        total = np.zeros(t.size)
        for spec, part in zip(row.specs, row.slices, strict=True):
            gain, tau, dead_time = theta[part]
            num, den, _ = cont2discrete(([gain], [tau, 1.0]), piece.h)
            total += np.interp(t - dead_time, t, lfilter(num.ravel(), den, piece.inputs[spec.column]), left=0.0)
        return total[:: row.stride]

    return response


def by_scipy(row: Row, response: Response, theta: Array, ar: Array) -> tuple[Array, float]:
    """Least prediction errors by `least_squares`: estimate and sum of squares."""
    y, valid = row.measured(0)
    t = row.pieces[0].h * row.stride * np.arange(y.size)
    use = whitened_valid(ar.size, valid)
    lags = [part.start + 1 for part in row.slices]

    def errors(x: Array) -> Array:
        theta, ar = np.split(x, [row.size])
        columns = [np.ones(t.size)] + ([] if row.rests(0) else [np.exp(-t / theta[k]) for k in lags])
        both = np.column_stack([np.where(valid, y - response(theta), 0.0), *columns])
        filtered = lfilter(np.append(1.0, ar), [1.0], both, axis=0)[ar.size :][use]
        known, free = filtered[:, 0], filtered[:, 1:]
        return known - free @ np.linalg.lstsq(free, known)[0]

    low, high = row.bounds()
    unbounded = np.full(ar.size, np.inf)
    bounds = np.append(low, -unbounded), np.append(high, unbounded)
    found = least_squares(errors, np.append(theta, ar), x_scale="jac", bounds=bounds)
    return found.x[: row.size], 2 * found.cost


def compare_optimisers(name: str, row: Row, time_scale: float, starts: int) -> None:
    """Print times and minima of the three, from the same starts around the estimate."""
    best = estimate_row(row, time_scale)
    sigma = np.sqrt(np.diag(best.covariance))
    rng = np.random.default_rng(1)
    theta = [best.theta * np.exp(rng.uniform(-0.4, 0.4, row.size)) for _ in range(starts)]

    def own(start: Array) -> tuple[Array, float]:
        fit = fit_row(row, start, best.ar)
        return fit.theta, fit.cost

    solvers = {
        "trueplant": own,
        "least_squares, this response": lambda x: by_scipy(row, lambda p: row.response(p, 0), x, best.ar),
        "least_squares, scipy.signal": lambda x: by_scipy(row, plain_response(row), x, best.ar),
    }
    samples = row.measured(0)[0].size
    print(f"{name}: {samples} prediction errors, {row.size} parameters, AR({best.ar.size}), {starts} starts")
    first = None
    for label, solve in solvers.items():
        runs = [timed(partial(solve, x), repeats=3) for x in theta]
        seconds = float(np.median([s for s, _ in runs]))
        first = first or seconds
        excess = [100 * (cost / best.cost - 1) for _, (_, cost) in runs]
        shift = [np.max(np.abs(p - best.theta) / sigma) for _, (p, _) in runs]
        print(
            f"  {label:30} {1000 * seconds:8.1f} ms  x{seconds / first:5.1f}   cost above least: median "
            f"{np.median(excess):8.4f} %, worst {max(excess):8.4f} %   off by {np.median(shift):6.3f} s.e."
        )
    seconds, _ = timed(partial(estimate_row, row, time_scale), repeats=3)
    print(f"  {'trueplant with grid and order':30} {1000 * seconds:8.1f} ms  (no start and no order given)")


def timed(function: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median wall time, and the last result."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - begin)
    return float(np.median(times)), result


# sippy_unipi --------------------------------------------------------------------------------------------------------


def sippy_models(delays: list[int]) -> dict[str, Model]:
    """Model classes with the orders of two first-order lags and of a first-order noise model."""
    two, free = [[3, 3]], [delays]
    return {
        "ARX, true orders": ("ARX", {"ARX_orders": [[2], two, free]}),
        "ARX, order 10": ("ARX", {"ARX_orders": [[10], [[10, 10]], free]}),
        "ARMAX": ("ARMAX", {"ARMAX_orders": [[2], two, [2], free], "ARMAX_mod": "OPT"}),
        "OE": ("OE", {"OE_orders": [two, [2], free]}),
        "BJ": ("BJ", {"BJ_orders": [two, [1], [1], [2], free]}),
    }


def by_sippy(y: Array, u: Array, model: Model, centering: str = "None") -> list[tuple[Array, Array]]:
    """Numerator and denominator in powers of the backward shift from each input to y."""
    from sippy_unipi import system_identification

    name, orders = model
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = system_identification(y[None].copy(), u.T.copy(), name, centering=centering, **orders)
    pairs = zip(found.NUMERATOR[0], found.DENOMINATOR[0], strict=True)
    return [(np.concatenate([np.zeros(len(den) - len(num)), num]), np.asarray(den)) for num, den in pairs]


def have_sippy() -> bool:
    try:
        import sippy_unipi  # noqa: F401
    except ImportError:
        print("sippy_unipi is not installed, so it is not compared with: pip install sippy_unipi")
        return False
    return True


def step_errors(i: int, steps: list[Array]) -> list[float]:
    """Rms error in per cent of the gain of the step response of each element of row i."""
    errors = []
    for j, got in enumerate(steps):
        true = sampled_response(WOOD_BERRY[i, j], np.ones(HORIZON), 1.0)
        errors.append(100 * float(np.sqrt(np.mean((got - true) ** 2))) / abs(WOOD_BERRY.dc_gain[i, j]))
    return errors


def compare_on_simulated(seeds: int, samples: int, peer: bool, from_rest: bool) -> None:
    """Times, and errors of the step responses of all four elements, over several seeds.

    A record cut out of operation hides its operating point and its past from everyone, and the peer takes the mean
    off; of a record from rest on, the peer is told the operating point exactly, and this project estimates it.
    """
    step = np.ones(HORIZON)
    errors: dict[str, list[float]] = {}
    times: dict[str, list[float]] = {}
    for seed, i in product(range(seeds), range(2)):
        whole = wood_berry(seed, samples if from_rest else samples + EARLIER)
        segment = segment_of(whole)
        if not from_rest:
            late = {name: getattr(segment, name)[EARLIER:] for name in ("t", "r", "u", "y", "d", "free")}
            segment = replace(segment, **late)
        row = wood_berry_row(segment, i)
        seconds, fit = timed(partial(estimate_row, row, 15.0), repeats=3)
        systems = [s.structure.transfer(fit.theta[p]) for s, p in zip(row.specs, row.slices, strict=True)]
        times.setdefault("trueplant", []).append(seconds)
        errors.setdefault("trueplant", []).extend(step_errors(i, [sampled_response(g, step, 1.0) for g in systems]))
        delays = [int(structure_of(WOOD_BERRY[i, j])[1][2]) for j in range(2)]
        for label, model in sippy_models(delays).items() if peer else ():
            centering = "None" if from_rest else "MeanVal"
            seconds, found = timed(partial(by_sippy, segment.y[:, i], segment.u, model, centering), repeats=1)
            times.setdefault(f"sippy {label}", []).append(seconds)
            errors.setdefault(f"sippy {label}", []).extend(
                step_errors(i, [lfilter(num, den, step) for num, den in found])
            )
    which = "from rest on, operating point told to the peer" if from_rest else "cut out of operation"
    print(f"simulated Wood-Berry, {samples} samples {which}, {seeds} seeds, one output at a time")
    own_time, own_error = np.median(times["trueplant"]), np.sqrt(np.mean(np.square(errors["trueplant"])))
    for label, values in errors.items():
        seconds, error = np.median(times[label]), np.sqrt(np.mean(np.square(values)))
        print(
            f"  {label:24} {1000 * seconds:8.0f} ms  x{seconds / own_time:6.1f}   step response: rms error "
            f"{error:7.2f} % of the gain (x{error / own_error:6.1f}), median {np.median(values):6.2f} %"
        )


def wood_berry_row(segment: Segment, i: int) -> Row:
    """One row of Wood and Berry's column, started far off the truth."""
    truth = [structure_of(WOOD_BERRY[i, j])[1] for j in range(2)]
    specs = tuple(Spec(j, FOPDT, tuple(p * [1.3, 0.7, 1.5])) for j, p in enumerate(truth))
    return Row(specs, pieces_of([segment], i))


# The Temperature Control Lab ----------------------------------------------------------------------------------------


def tclab(number: int) -> tuple[list[Row], float]:
    """Both rows of the plant over one run, and the time scale of its model."""
    study = prepare(Project.load(EXAMPLES / f"tclab_pid_short_0{number}.toml"))
    specs = [[spec for (row, _), spec in sorted(study.specs.items()) if row == i] for i in range(2)]
    held = max(float(np.max(s.update_interval)) for s in study.screened)
    stride = choose_stride(study.segments, list(study.specs.values()), held)
    taus = [s.initial[1] for row in specs for s in row if s.initial is not None]
    return [Row(tuple(specs[i]), pieces_of(study.segments, i), stride) for i in range(2)], float(np.median(taus))


def deviations(row: Row) -> tuple[Array, Array, Array]:
    """Output and inputs at the strided samples for a peer: gaps filled, inputs averaged; and where y was measured."""
    (piece,) = row.pieces
    y, valid = row.measured(0)
    at = np.arange(y.size)
    filled = np.interp(at, at[valid], y[valid])
    edges = np.arange(0, piece.y.size, row.stride)
    counts = np.diff(np.append(edges, piece.y.size))
    u = np.add.reduceat(piece.inputs[[s.column for s in row.specs]], edges, axis=1) / counts
    return filled - np.median(filled[:5]), u.T, valid


def compare_on_second_run(rows: list[Row], others: list[Row], time_scale: float, peer: bool) -> None:
    """Simulated fit to the other run of the same moves, an offset apart."""
    print("TCLab, estimated on run 01, simulated on run 02")
    for i, (row, other) in enumerate(zip(rows, others, strict=True)):
        seconds, fit = timed(partial(estimate_row, row, time_scale), repeats=3)
        own = seconds
        _, _, valid = deviations(other)
        y, _ = other.measured(0)

        def score(simulated: Array, y: Array = y, valid: Array = valid) -> float:
            return fit_percent(y[valid], simulated[valid] + np.mean((y - simulated)[valid]))

        percent = score(other.response(fit.theta, 0))
        print(f"  PV {i + 1}: {'trueplant':24} {1000 * seconds:8.0f} ms  x{1:6.1f}   fit {percent:6.2f} %")
        if not peer:
            continue
        known, u, _ = deviations(row)
        _, u_other, _ = deviations(other)
        sample = row.pieces[0].h * row.stride
        delays = [int(fit.theta[part][2] / sample) for part in row.slices]
        for label, model in sippy_models(delays).items():
            seconds, found = timed(partial(by_sippy, known, u, model), repeats=1)
            simulated = sum(lfilter(num, den, u_other[:, j]) for j, (num, den) in enumerate(found))
            percent = score(simulated)
            label = f"sippy {label}"
            print(f"        {label:24} {1000 * seconds:8.0f} ms  x{seconds / own:6.1f}   fit {percent:6.2f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--samples", type=int, default=1500)
    options = parser.parse_args()
    peer = have_sippy()
    if peer:  # imports what is imported
        by_sippy(np.arange(50.0), np.eye(50, 2), sippy_models([1, 3])["ARX, true orders"])
    estimate_row(wood_berry_row(segment_of(wood_berry(99, 300)), 0), 15.0)  # compiles what is compiled
    segment = segment_of(wood_berry(0))
    for i in range(2):
        compare_optimisers(f"simulated Wood-Berry, output {i + 1}", wood_berry_row(segment, i), 15.0, options.starts)
    try:
        (rows, time_scale), (others, _) = tclab(1), tclab(2)
    except SourceError as error:
        print(f"the TCLab record is not to be had, so it is left out: {error}")
        rows, others = [], []
    for i, row in enumerate(rows):
        compare_optimisers(f"TCLab run 01, PV {i + 1}", row, time_scale, options.starts)
    if rows:
        compare_on_second_run(rows, others, time_scale, peer)
    for from_rest in (False, True):
        compare_on_simulated(options.seeds, options.samples, peer, from_rest)


if __name__ == "__main__":
    main()
